"""The CAR sampler against its joint density, exact integrals, and the laws of order."""

import itertools

import numpy as np
import pytest
from scipy.special import ndtr

from tests.naive.car_model.sampler import Scene, greedy_classes, integrate, naive_sample, random_scene
from tilepipe_kernels.car_model.chain import Variances
from tilepipe_kernels.car_model.convergence import effective_sample_size
from tilepipe_kernels.car_model.exact import measure, perturb_and_map
from tilepipe_kernels.car_model.model import CarModel, Priors
from tilepipe_kernels.car_model.pixel_grid import sample_grid
from tilepipe_kernels.car_model.sampler import expect, sample, sample_variances
from tilepipe_kernels.car_model.states import Gibbs
from tilepipe_kernels.car_model.sweeps import normal_tail, probability_of_same
from tilepipe_kernels.core.random import normals
from tilepipe_kernels.core.sums import BLOCK
from tilepipe_kernels.regions.colouring import colour_graph, order_by_colour

TOLERANCE = 0.5


def grid_scene(rows: int, columns: int, seed: int) -> Scene:
    number = np.arange(rows * columns).reshape(rows, columns)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    edges = edges[np.lexsort(edges.T[::-1])]
    rng = np.random.default_rng(seed)
    n = rows * columns
    return Scene(edges, np.ones(len(edges)), np.ones(n), rng.normal(5, 1, n), np.zeros(n))


def grid_model(rows: int, columns: int, seed: int = 0) -> CarModel:
    scene = grid_scene(rows, columns, seed)
    return CarModel(scene.edges, None, scene.count, scene.mean, scene.spread + 0.1)


def assert_equal(a, b):
    for name in ("smoothness", "noise", "log_density", "mean", "sd", "same"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize(("seed", "components"), [(0, 1), (1, 1), (2, 2), (3, 3)])
def test_every_conditional_is_that_of_the_joint_density(seed, components):
    scene = random_scene(seed, nodes=9, components=components)
    ids = np.arange(9) * 7 + 2**33
    v, s2, x = naive_sample(scene, sweeps=12, seed=seed + 5, ids=ids)
    result = sample(scene.model(), burn_in=0, draws=12, tolerance=1, seed=seed + 5, site_ids=ids)
    assert np.allclose(result.smoothness, v, rtol=1e-6) and np.allclose(result.noise, s2, rtol=1e-6)
    assert np.allclose(result.mean, x.mean(axis=0), rtol=1e-8)
    assert np.allclose(result.sd, x.std(axis=0, ddof=1), rtol=1e-5)
    densities = [scene.log_joint(*row) for row in zip(x, 1 / v, 1 / s2, strict=True)]
    assert np.allclose(result.log_density, densities)


@pytest.mark.parametrize("method", ["gibbs", "exact"])
@pytest.mark.parametrize("counting", [False, True])
def test_posterior_is_that_of_exact_integration(method, counting):
    scene = random_scene(11)
    mean, sd, log_v, log_s2, same = integrate(scene, TOLERANCE)
    draws = 4000
    result = sample(
        scene.model(), burn_in=500, draws=draws, thinning=2, tolerance=TOLERANCE, seed=3, method=method,
        counting=counting,
    )  # fmt: skip
    for trace, expected in ((np.log(result.smoothness), log_v), (np.log(result.noise), log_s2)):
        assert abs(trace.mean() - expected) < 4 * trace.std() / np.sqrt(effective_sample_size(trace))
    # Heights mix faster than the slower variance.
    size = effective_sample_size(result.smoothness)
    assert (np.abs(result.mean - mean) < 4 * sd / np.sqrt(size)).all()
    assert (np.abs(result.sd / sd - 1) < 6 / np.sqrt(2 * size)).all()
    assert (np.abs(result.same - same) < 4 * np.sqrt(same * (1 - same) / size) + 1e-3).all()


def test_probabilities_have_less_noise_than_counts():
    scene = random_scene(11)
    same = integrate(scene, TOLERANCE)[-1]
    error = {
        counting: np.mean([
            (sample(scene.model(), burn_in=50, draws=100, tolerance=TOLERANCE, seed=s, counting=counting).same - same)
            ** 2
            for s in range(20)
        ])
        for counting in (False, True)
    }  # fmt: skip
    assert error[False] < 0.7 * error[True]


def test_edge_probability_is_that_of_the_bivariate_normal():
    scene = random_scene(4, nodes=5)
    x, smooth, fit = np.random.default_rng(0).normal(20, 1, 5), 0.7, 2.0
    matrix, side = scene.precision(smooth, fit), fit * scene.count * scene.mean
    total = np.diag(matrix)
    for (i, j), w in zip(scene.edges, scene.weights, strict=True):
        pair, rest = [i, j], [k for k in range(5) if k not in (i, j)]
        covariance = np.linalg.inv(matrix[np.ix_(pair, pair)])
        centre = covariance @ (side[pair] - matrix[np.ix_(pair, rest)] @ x[rest])
        d, sd = centre[0] - centre[1], np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
        pull = side - matrix @ x + total * x
        b, r = w * smooth, total - w * smooth
        found = probability_of_same(b, r[i], pull[i] - b * x[j], r[j], pull[j] - b * x[i], 0.8)
        assert found == pytest.approx(ndtr((0.8 - d) / sd) - ndtr((-0.8 - d) / sd), abs=2e-7)


@pytest.mark.parametrize("count", [1, 0])
def test_expectation_is_that_of_the_normal_density(count):
    scene = random_scene(9, nodes=8)
    scene.count[3], scene.spread[3] = count, 0
    model, smooth, fit = scene.model(), 0.7, 2.0
    covariance = np.linalg.inv(scene.precision(smooth, fit))
    centre = covariance @ (scene.count * scene.mean * fit)
    mean, same = expect(model, 1 / smooth, 1 / fit, tolerance=TOLERANCE)
    assert np.allclose(mean, centre, atol=0.02 * TOLERANCE)
    matrix = np.linalg.inv(covariance)
    for (i, j), found in zip(scene.edges, same, strict=True):
        d = centre[i] - centre[j]
        pair = np.linalg.inv(matrix[np.ix_([i, j], [i, j])])
        sd = np.sqrt(pair[0, 0] + pair[1, 1] - 2 * pair[0, 1])
        assert found == pytest.approx(ndtr((TOLERANCE - d) / sd) - ndtr((-TOLERANCE - d) / sd), abs=0.01)


def test_variances_alone_are_those_of_the_whole_sample():
    model, options = grid_model(70, 60), {"burn_in": 2, "draws": 4, "seed": 9}
    whole = sample(model, **options, tolerance=TOLERANCE)
    for workers in (1, 2):
        traces = sample_variances(model, **options, workers=workers)
        for name in ("smoothness", "noise", "log_density"):
            np.testing.assert_array_equal(getattr(traces, name), getattr(whole, name))
    mean, same = expect(model, 1.0, 0.3, tolerance=TOLERANCE)
    again = expect(model, 1.0, 0.3, tolerance=TOLERANCE, workers=3)
    np.testing.assert_array_equal(mean, again[0])
    np.testing.assert_array_equal(same, again[1])


def test_normal_tail_is_accurate():
    x = np.linspace(0, 40, 4001)
    assert np.allclose([normal_tail(value) for value in x], ndtr(-x), rtol=0, atol=8e-8)


def test_perturb_and_map_has_the_right_mean_and_covariance():
    scene = random_scene(7, components=2)
    covariance = np.linalg.inv(scene.precision(1 / 0.8, 1 / 0.3))
    centre = covariance @ (scene.count * scene.mean / 0.3)
    model = scene.model()
    draws = np.array([perturb_and_map(model, 0.8, 0.3, seed=1, sweep=s, solver_tolerance=1e-9) for s in range(4000)])
    sd = np.sqrt(np.diag(covariance))
    assert (np.abs(draws.mean(axis=0) - centre) < 4 * sd / np.sqrt(4000)).all()
    assert (np.abs(np.cov(draws.T) - covariance) < 5 * np.outer(sd, sd) * np.sqrt(2 / 4000)).all()


@pytest.mark.parametrize("method", ["gibbs", "exact"])
def test_threads_do_not_matter(method):
    model = grid_model(120, 90)
    assert np.bincount(colour_graph(model.edges, len(model.count))).max() > 2 * BLOCK
    one, two, three = (
        sample(model, burn_in=2, draws=4, tolerance=TOLERANCE, method=method, workers=workers) for workers in (1, 2, 3)
    )
    assert_equal(one, two)
    assert_equal(one, three)


def test_ids_decide_the_numbers():
    model = grid_model(6, 5)
    lengths = {"burn_in": 1, "draws": 3, "tolerance": TOLERANCE}
    base = sample(model, **lengths)
    assert_equal(base, sample(model, **lengths, site_ids=np.arange(30)))
    other = sample(model, **lengths, site_ids=np.arange(30) * 3)
    assert not np.isclose(base.mean[1:], other.mean[1:]).any()


@pytest.mark.parametrize("method", ["gibbs", "exact"])
def test_a_component_numbered_within_another_graph_draws_the_same(method):
    # Given the variances, a component depends on nothing else, whatever its nodes' numbers are.
    scene = random_scene(8, nodes=10, components=2)
    part = np.arange(0, 10, 2)
    inside = (scene.edges % 2 == 0).all(axis=1)
    alone = Scene(scene.edges[inside] // 2, scene.weights[inside], *(a[part] for a in (scene.count, scene.mean)),
                  spread=scene.spread[part])  # fmt: skip
    if method == "exact":
        whole = perturb_and_map(scene.model(), 0.5, 0.2, site_ids=np.arange(10) + 4, solver_tolerance=1e-12)
        single = perturb_and_map(alone.model(), 0.5, 0.2, site_ids=part + 4, solver_tolerance=1e-12)
        assert np.allclose(whole[part], single, rtol=1e-12)
        return
    results = []
    for these, ids in ((scene, np.arange(10) + 4), (alone, part + 4)):
        chain = Gibbs(these.model(), ids, np.uint64(1), 1, None)
        variances = Variances(Priors(), 4, 10, 0, True, np.uint64(1), 0.5, 0.2)
        for sweep in range(3):
            roughness, misfit = chain.draw(variances, sweep)
            assert np.allclose((roughness, misfit), measure(chain.graph, chain.heights()))
        results.append(chain.heights())
    np.testing.assert_array_equal(results[0][part], results[1])


def test_grid_is_the_graph_of_its_pixels():
    scene, model = grid_scene(7, 6, 3), grid_model(7, 6, 3)
    options = {"burn_in": 2, "draws": 6, "thinning": 2, "seed": 4}
    pixels = scene.mean.reshape(7, 6)
    grid = sample_grid(pixels, **options, spread=float(model.spread.sum()))
    graph = sample(model, **options, tolerance=TOLERANCE)
    for name in ("smoothness", "noise", "log_density", "mean", "sd"):
        assert np.allclose(getattr(grid, name).ravel(), getattr(graph, name), rtol=1e-9), name
    for workers in (2, 5):
        again = sample_grid(pixels, **options, spread=float(model.spread.sum()), workers=workers)
        np.testing.assert_array_equal(again.mean, grid.mean)
        np.testing.assert_array_equal(again.noise, grid.noise)


def test_missing_pixels_are_no_nodes():
    pixels = np.random.default_rng(1).normal(0, 1, (5, 7))
    pixels[:, 3] = np.nan
    pixels[2, 0] = np.nan
    options = {"burn_in": 1, "draws": 4, "seed": 4, "fixed_variance": 0.3}
    result = sample_grid(pixels, **options)
    valid = ~np.isnan(pixels)
    assert (np.isnan(result.mean) == ~valid).all() and (np.isnan(result.sd) == ~valid).all()
    assert (result.noise == 0.3).all()
    # The checkerboard is no greedy colouring around holes: compare with a sampler that takes its classes.
    x, smooth = np.where(valid, pixels, 0), 1 / np.var(pixels[valid])
    sites = np.flatnonzero(valid.ravel())
    for colour in (0, 1):
        for site in sites[(sites // 7 + sites % 7) % 2 == colour]:
            i, j = divmod(site, 7)
            near = [(a, b) for a, b in ((i - 1, j), (i, j - 1), (i, j + 1), (i + 1, j)) if 0 <= a < 5 and 0 <= b < 7]
            near = [place for place in near if valid[place]]
            q = 1 / 0.3 + smooth * len(near)
            z = normals([site], seed=4)[0]
            x[i, j] = (pixels[i, j] / 0.3 + smooth * sum(x[place] for place in near)) / q + z / np.sqrt(q)
    first = sample_grid(pixels, **{**options, "burn_in": 0, "draws": 2})
    second = 2 * first.mean - x
    assert np.allclose(np.abs(second - x)[valid] / np.sqrt(2), first.sd[valid], rtol=1e-9)


def test_colours_are_greedy_in_node_order():
    scene = random_scene(5, nodes=12, extra=15)
    model = scene.model()
    order, bounds = order_by_colour(colour_graph(model.edges, len(model.count)))
    assert [order[a:b].tolist() for a, b in itertools.pairwise(bounds)] == greedy_classes(scene)


def test_edges_can_be_chosen():
    model = random_scene(2).model()
    whole = sample(model, burn_in=0, draws=3, tolerance=1)
    some = model.edges[[3, 0, 2], ::-1]
    np.testing.assert_array_equal(
        sample(model, burn_in=0, draws=3, tolerance=1, edges=some).same, whole.same[[3, 0, 2]]
    )
    with pytest.raises(ValueError, match="edges must be pairs"):
        sample(model, burn_in=0, draws=3, tolerance=1, edges=np.array([[0, 0]]))


def test_nodes_without_data_follow_their_neighbours():
    scene = random_scene(3)
    scene.count[2] = scene.spread[2] = 0
    mean, sd, _, _, same = integrate(scene, TOLERANCE)
    result = sample(scene.model(), burn_in=200, draws=3000, tolerance=TOLERANCE, method="exact")
    assert np.allclose(result.mean, mean, atol=0.1 * sd.max()) and np.allclose(result.same, same, atol=0.03)


def test_bad_input_is_refused():
    edges, weights, data = np.array([[0, 1]]), np.ones(1), (np.ones(2), np.zeros(2), np.zeros(2))
    faults = {
        "the lower first": (np.array([[1, 0]]), weights, *data),
        "node numbers": (np.array([[0, 2]]), weights, *data),
        "pairs": (np.array([[0, 1, 2]]), weights, *data),
        "sorted, each once": (np.array([[0, 1], [0, 1]]), None, *data),
        "weights must be positive": (edges, 0 * weights, *data),
        "weights must have": (edges, np.ones(2), *data),
        "no data": (edges, weights, np.zeros(2), np.zeros(2), np.zeros(2)),
        "finite": (edges, weights, np.ones(2), np.full(2, np.nan), np.zeros(2)),
        "one value": (edges, weights, np.ones(3), np.zeros(2), np.zeros(2)),
    }
    for message, arrays in faults.items():
        with pytest.raises(ValueError, match=message):
            CarModel(*arrays)
    model = CarModel(edges, weights, *data)
    good = {"burn_in": 0, "draws": 2, "tolerance": 1.0}
    for bad in ({"draws": 1}, {"tolerance": -1}, {"workers": 0}, {"seed": -1}, {"fixed_variance": 0}, {"method": "x"},
                {"site_ids": np.array([4, 4])}):  # fmt: skip
        with pytest.raises(ValueError, match=r"must|need"):
            sample(model, **{**good, **bad})
    for bad_grid in (np.full((2, 2), np.nan), np.ones(3), np.array([[np.inf]])):
        with pytest.raises(ValueError, match="heights must"):
            sample_grid(bad_grid, burn_in=0, draws=2)
    with pytest.raises(ValueError, match="positive"):
        Priors(noise_rate=0)
