"""The CAR sampler on the device: the chains, moments and edge probabilities of the host, bit for bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.naive.car_model.sampler import Scene, greedy_classes, naive_sample, random_scene
from tilepipe_kernels.car_model.exact import perturb_and_map
from tilepipe_kernels.car_model.model import CarModel, Posterior
from tilepipe_kernels.car_model.pixel_grid import ROW_LANES, sample_grid
from tilepipe_kernels.car_model.sampler import expect, sample, sample_variances
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.core.sums import LANES
from tilepipe_kernels.regions.colouring import colour_graph, order_by_colour, rows_in_order
from tilepipe_kernels.regions.components import count_components

LENGTHS = {"burn_in": 1, "draws": 3, "seed": 4}


def uploaded(scene: Scene, weighted: bool = True) -> CarModel:
    arrays = (scene.edges.astype(np.int32), scene.weights, scene.count, scene.mean, scene.spread)
    edges, weights, *data = map(to_device, arrays)
    return CarModel(edges, weights if weighted else None, *data)


def assert_same(found: Posterior, expected: Posterior) -> None:
    for name in ("smoothness", "noise", "log_density", "mean", "sd", "same"):
        ours, hosts = getattr(found, name), getattr(expected, name)
        if hosts is not None:
            assert on_device(ours) == (name in ("mean", "sd", "same"))
            np.testing.assert_array_equal(to_host(ours), hosts, err_msg=name)


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("counting", [True, False])
def test_posterior_is_that_of_the_host(weighted: bool, counting: bool) -> None:
    scene = random_scene(3, nodes=14, extra=18, components=2)
    scene.count[5] = scene.spread[5] = 0
    host = CarModel(scene.edges, scene.weights if weighted else None, scene.count, scene.mean, scene.spread)
    ids = np.arange(14) * 7 + 2**33
    options = {**LENGTHS, "tolerance": 0.5, "counting": counting, "thinning": 2}
    expected = sample(host, site_ids=ids, edges=scene.edges[::-2], **options)
    device = uploaded(scene, weighted)
    found = sample(device, site_ids=to_device(ids), edges=to_device(scene.edges[::-2]), **options)
    assert_same(found, expected)
    traces = sample_variances(device, site_ids=to_device(ids), **LENGTHS, thinning=2)
    np.testing.assert_array_equal(traces.smoothness, expected.smoothness)


def test_every_conditional_is_that_of_the_joint_density() -> None:
    scene = random_scene(1, nodes=7)
    v, s2, x = naive_sample(scene, sweeps=3, seed=9, ids=np.arange(7))
    found = sample(uploaded(scene), burn_in=0, draws=3, tolerance=1, seed=9)
    np.testing.assert_allclose(found.smoothness, v, rtol=1e-6)
    np.testing.assert_allclose(found.noise, s2, rtol=1e-6)
    np.testing.assert_allclose(to_host(found.mean), x.mean(axis=0), rtol=1e-8)


@pytest.mark.parametrize("tolerance", [0.5, 0.0])
def test_expectation_is_that_of_the_host(tolerance: float) -> None:
    scene = random_scene(9, nodes=10)
    for smoothness in (0.2, 3.0):
        expected = expect(scene.model(), smoothness, 0.3, tolerance=tolerance)
        found = expect(uploaded(scene), smoothness, 0.3, tolerance=tolerance)
        for ours, hosts in zip(found, expected, strict=True):
            assert on_device(ours)
            np.testing.assert_array_equal(to_host(ours), hosts)


def test_lanes_of_many_rows_are_summed_as_on_the_host() -> None:
    nodes = 2 * LANES + 20
    edges = np.stack([np.arange(nodes // 2), np.arange(nodes // 2) + nodes // 2], axis=1)
    data = np.ones(nodes), np.random.default_rng(2).normal(9, 1, nodes), np.ones(nodes)
    scene = Scene(edges, np.ones(len(edges)), *data)
    options = {"burn_in": 0, "draws": 2, "seed": 1}
    found, expected = sample_variances(uploaded(scene), **options), sample_variances(scene.model(), **options)
    np.testing.assert_array_equal(found.log_density, expected.log_density)


@pytest.mark.parametrize("shape", [(3, 5), (1, 2 * ROW_LANES + 9)])
def test_grid_is_that_of_the_host(shape: tuple[int, int]) -> None:
    heights = np.random.default_rng(1).normal(5, 1, shape)
    heights[:, 2] = heights[-1, 0] = np.nan
    assert_same(sample_grid(to_device(heights), **LENGTHS), sample_grid(heights, **LENGTHS))


def test_colours_rows_and_components_are_those_of_the_host() -> None:
    scene = random_scene(5, nodes=12, extra=15, components=3)
    model, edges = scene.model(), to_device(scene.edges.astype(np.int32))
    colours = colour_graph(edges, 12)
    assert on_device(colours)
    order, bounds = order_by_colour(colours)
    classes = [to_host(order)[a:b].tolist() for a, b in itertools.pairwise(bounds)]
    assert classes == greedy_classes(scene)
    rows = rows_in_order(edges, to_device(model.weights), order)
    expected = rows_in_order(model.edges, model.weights, to_host(order))
    for ours, hosts in zip(rows, expected, strict=True):
        np.testing.assert_array_equal(to_host(ours), hosts)
    marked = np.arange(12) % 3 == 1
    assert count_components(edges, to_device(marked)) == count_components(model.edges, marked) == (3, 2)


def test_too_many_colours_are_refused() -> None:
    edges = np.stack(np.triu_indices(65, 1), axis=1).astype(np.int32)
    with pytest.raises(ValueError, match="64 colours"):
        colour_graph(to_device(edges), 65)


def test_bad_input_is_refused() -> None:
    scene = random_scene(2)
    for edges in (scene.edges[::-1], scene.edges[:, ::-1], scene.edges + 1):
        with pytest.raises(ValueError, match="sorted, each once"):
            uploaded(Scene(edges, scene.weights, scene.count, scene.mean, scene.spread))
    with pytest.raises(ValueError, match="no data"):
        uploaded(Scene(scene.edges, scene.weights, 0 * scene.count, scene.mean, scene.spread))
    with pytest.raises(TypeError, match="mixed"):
        CarModel(scene.edges, None, to_device(scene.count), to_device(scene.mean), to_device(scene.spread))
    with pytest.raises(ValueError, match="on the host"):
        sample(uploaded(scene), **LENGTHS, tolerance=1, method="exact")
    with pytest.raises(ValueError, match="on the host"):
        perturb_and_map(uploaded(scene), 1.0, 1.0)
