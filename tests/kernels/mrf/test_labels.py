"""Optimisers of labels: against plain Python, against exact minima, and independent of tiles."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.mrf.labels import Problem
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_energy import energy
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.hcf import site_rank
from tilepipe_kernels.mrf.labels import messages as label_messages
from tilepipe_kernels.mrf.labels.energy import label_energy
from tilepipe_kernels.mrf.labels.hcf import parallel_rounds
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.messages import message_labels
from tilepipe_kernels.mrf.labels.minimise import halo, minimise
from tilepipe_kernels.mrf.labels.problem import Labels, labelling
from tilepipe_kernels.mrf.search import Method, Search

SHORT = Annealing(6, hot=2.0, cold=0.1, seed=3)


def costs(
    seed: int, shape: tuple[int, int], labels: int, kinds: int, missing: float, weighted: bool
) -> dict[str, NDArray[Any]]:
    """Costs that are small multiples of 1/8, so that sums are exact in any order and ties abound."""
    random = np.random.default_rng(seed)
    unary = random.integers(0, 16, (*shape, labels)) / 4
    unary[random.random(shape) < missing] = np.nan
    tables = random.integers(0, 6, (kinds, labels, labels)) / 4
    tables = tables + tables.transpose(0, 2, 1)
    down, right = random.integers(0, kinds, (2, *shape))
    problem = {"unary": unary, "pairwise": tables, "down": down, "right": right}
    if weighted:
        problem["down_weight"], problem["right_weight"] = random.integers(0, 5, (2, *shape)) / 2
    return problem


def naive_of(problem: dict[str, NDArray[Any]], origin: tuple[int, int]) -> Problem:
    return Problem(origin=origin, **{"tables" if name == "pairwise" else name: v for name, v in problem.items()})


PROBLEMS = st.builds(
    costs,
    st.integers(0, 9999),
    st.tuples(st.integers(1, 8), st.integers(1, 9)),
    st.integers(2, 6),
    st.sampled_from([1, 1, 3]),
    st.sampled_from([0.0, 0.2]),
    st.booleans(),
)
ORIGINS = st.tuples(st.integers(0, 70000), st.integers(0, 70000))


def scene(seed: int, size: int, levels: int, noise: float) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Rectangles of random levels, and the same with noise."""
    random = np.random.default_rng(seed)
    truth = np.zeros((size, size), np.uint8)
    for _ in range(30):
        i, j = random.integers(0, size, 2)
        height, width = random.integers(4, size // 2, 2)
        truth[i : i + height, j : j + width] = random.integers(levels)
    return truth, (truth + random.normal(0, noise, truth.shape)).astype(np.float32)


@settings(max_examples=40, deadline=None)
@given(PROBLEMS, ORIGINS, st.sampled_from([2, 40]))
def test_parallel_is_its_definition(problem: dict[str, Any], origin: tuple[int, int], cap: int) -> None:
    naive = naive_of(problem, origin)
    found = minimise(**problem, origin=origin, search=Search(rounds=cap))
    expected, rounds, unresolved = naive.parallel(cap)
    np.testing.assert_array_equal(found.labels, naive.as_array(expected))
    assert (found.rounds, found.unresolved) == (rounds, unresolved)


@settings(max_examples=30, deadline=None)
@given(PROBLEMS, ORIGINS)
def test_serial_and_icm_are_their_definitions(problem: dict[str, Any], origin: tuple[int, int]) -> None:
    naive = naive_of(problem, origin)
    serial = minimise(**problem, origin=origin, search=Search("serial"))
    np.testing.assert_array_equal(serial.labels, naive.as_array(naive.serial()))
    icm = minimise(**problem, origin=origin, search=Search("icm", 30))
    np.testing.assert_array_equal(icm.labels, naive.as_array(naive.icm(30)))
    assert icm.unresolved == serial.unresolved == 0
    assert label_energy(icm.labels, **problem) == naive.energy(icm.labels)


@settings(max_examples=40, deadline=None)
@given(PROBLEMS, ORIGINS, st.integers(0, 4), st.integers(0, 2))
@example(costs(9, (5, 9), 2, 3, 0.2, weighted=False), (0, 0), 1, 2)  # blocks beside each other without a pair
def test_messages_are_their_definition(
    problem: dict[str, Any], origin: tuple[int, int], rounds: int, scales: int
) -> None:
    made = labelling(**problem, origin=origin)
    labels = message_labels(made, rounds, scales).reshape(-1, made.stride)[1:-1, 1:-1]
    for site, belief in naive_of(problem, origin).messages(rounds, scales).items():
        # on one grid sums are exact, and the lowest of equals is due
        if scales == 0:
            assert labels[site] == int(np.argmin(belief))
        else:
            assert belief[labels[site]] <= min(belief) + 1e-4


def test_weights_are_as_good_as_tables() -> None:
    problem = costs(0, (30, 40), 5, 1, 0.1, weighted=True)
    table, halves = problem["pairwise"], np.arange(5) / 2
    tables = halves[:, None, None] * table[0]
    kinds = {name: (2 * problem[f"{name}_weight"]).astype(int) for name in ("down", "right")}
    plain = {name: problem[name] for name in ("unary", "pairwise")}
    for method in get_args(Method):
        options: dict[str, Any] = {"search": Search(method, annealing=SHORT)}
        weighted = minimise(**problem, **options).labels
        np.testing.assert_array_equal(weighted, minimise(problem["unary"], tables, **kinds, **options).labels)
        assert (weighted != minimise(**plain, **options).labels).any()
        ones = np.ones((30, 40))
        unit = minimise(**plain, down_weight=ones, **options).labels
        np.testing.assert_array_equal(unit, minimise(**plain, **options).labels)


def test_rows_and_lists_of_a_round_are_the_same_bits() -> None:
    _, y = scene(3, 90, 4, 0.6)
    y[20:25, 30:50] = np.nan
    for levels in (2, 3, 4):
        model = EdgeModel(levels, beta=0.7)
        unary = (y[..., None] - np.arange(levels)) ** 2 / 0.18
        dense = labelling(unary, model.pairwise())
        # A second table that no pair takes keeps the rows from being used.
        listed = labelling(unary, np.stack([model.pairwise()] * 2))
        first, second = (np.full(dense.exists.size, levels, np.uint8) for _ in range(2))
        assert parallel_rounds(dense, first, 30)[0] == parallel_rounds(listed, second, 30)[0] > 5
        np.testing.assert_array_equal(first, second)


@settings(max_examples=24, deadline=None)
@given(
    st.sampled_from([method for method in get_args(Method) if method != "serial"]),
    st.integers(0, 99), st.integers(2, 6), st.integers(0, 40), st.integers(0, 40), st.integers(0, 2), st.booleans(),
)  # fmt: skip
def test_tiles_do_not_show(
    method: Method, seed: int, levels: int, top: int, left: int, scales: int, weighted: bool
) -> None:
    # Strong coupling of rounded noise: changes travel as far as rounds let them.
    random = np.random.default_rng(seed)
    y = np.round(random.uniform(0, levels - 1, (90, 90)), 1)
    y[random.random(y.shape) < 0.02] = np.nan
    unary = (y[..., None] - np.arange(levels)) ** 2 / 8
    table = EdgeModel(levels, "quadratic").pairwise()
    weights = random.uniform(0, 2, (2, 90, 90))
    search = Search(method, 3, Annealing(1), messages=3, scales=scales)

    def solved(part: tuple[slice, slice], core: tuple[slice, slice]) -> Labels:
        given = {name: w[part] for name, w in zip(("down_weight", "right_weight"), weights, strict=True) if weighted}
        origin = 1000 + part[0].start, 70000 + part[1].start
        return minimise(unary[part], table, **given, search=search, origin=origin, core=core)

    reach = halo(search)
    place = (slice(top, top + 45), slice(left, left + 45))
    whole = solved((slice(0, 90), slice(0, 90)), place)
    rows, columns = (slice(max(part.start - reach, 0), part.stop + reach) for part in place)
    core = slice(top - rows.start, top + 45 - rows.start), slice(left - columns.start, left + 45 - columns.start)
    tile = solved((rows, columns), core)
    np.testing.assert_array_equal(tile.labels[core], whole.labels[place])
    assert tile.unresolved == whole.unresolved


def exact_minimum(y: NDArray[np.float32], model: EdgeModel) -> float:
    maxflow = pytest.importorskip("maxflow")
    table = model.pairwise().astype(float)
    graph = maxflow.GraphFloat()
    nodes = graph.add_grid_nodes(y.shape)
    graph.add_grid_edges(nodes, table[0, 1] - table[0, 0])
    graph.add_grid_tedges(nodes, (y - 1.0) ** 2 / (2 * model.sigma**2), y.astype(float) ** 2 / (2 * model.sigma**2))
    graph.maxflow()
    return energy(y, graph.get_grid_segments(nodes).astype(np.uint8), None, None, model)


@pytest.mark.parametrize("potential", ["quadratic", "reciprocal"])
@pytest.mark.parametrize("noise", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("seed", [0, 1])
def test_two_labels_come_within_a_hundredth_of_the_exact_minimum(potential: Any, noise: float, seed: int) -> None:
    _, y = scene(seed, 150, 2, noise)
    model = EdgeModel(2, potential)
    least = exact_minimum(y, model)
    parallel, serial, messages = (
        energy(y, intensity_field(y, model, search=Search(method)).labels, None, None, model)
        for method in ("parallel", "serial", "messages")
    )
    assert least - 1e-6 <= parallel <= least + 0.01 * abs(least)
    assert least - 1e-6 <= serial <= least + 0.01 * abs(least)
    assert least - 1e-6 <= messages <= least + 0.001 * abs(least)


@pytest.mark.parametrize("potential", ["quadratic", "reciprocal"])
@pytest.mark.parametrize("levels", [2, 4, 16, 64])
def test_no_optimiser_ends_above_its_start(potential: Any, levels: int) -> None:
    _, y = scene(5, 60, levels, 0.7)
    model = EdgeModel(levels, potential, beta=0.6, sigma=0.7)
    start = energy(y, np.clip(np.round(y), 0, levels - 1).astype(int), None, None, model)
    for method in get_args(Method):
        found = intensity_field(y, model, search=Search(method, annealing=SHORT))
        assert energy(y, found.labels, None, None, model) < start
        assert found.unresolved <= 2 and found.labels.max() < levels


def test_messages_go_below_the_truth_where_icm_and_hcf_cannot() -> None:
    truth, y = scene(2, 128, 16, 1.0)
    label = np.arange(16)
    unary = (y[..., None] - label) ** 2 / 2
    table = 0.7 * np.minimum(np.abs(label[:, None] - label), 2)

    def cost(x: NDArray[np.uint8]) -> float:
        pairs = table[x[1:], x[:-1]].sum() + table[x[:, 1:], x[:, :-1]].sum()
        return float(np.take_along_axis(unary, x[..., None].astype(int), 2).sum() + pairs)

    results: dict[str, float] = {
        method: cost(minimise(unary, table, search=Search(method)).labels) for method in ("parallel", "icm", "messages")
    }
    assert results["messages"] < cost(truth) < results["parallel"] < results["icm"]


def test_bands_of_messages_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    _, y = scene(6, 70, 5, 0.8)
    for scales in (0, 1):
        options: dict[str, Any] = {"search": Search("messages", messages=3, scales=scales), "origin": (7, 8)}
        with monkeypatch.context() as patch:
            whole = intensity_field(y, EdgeModel(5), **options).labels
            patch.setattr(label_messages, "_BAND_BYTES", 1)
            np.testing.assert_array_equal(intensity_field(y, EdgeModel(5), **options).labels, whole)


def test_lines_spare_the_contrast() -> None:
    _, y = scene(7, 40, 3, 0.5)
    model = EdgeModel(3, "reciprocal", alpha=0.8)
    random = np.random.default_rng(0)
    h, v = random.choice(np.array([0, 1, 255], np.uint8), (2, *y.shape))
    label = np.arange(3)
    unary = (y[..., None] - label) ** 2 / (2 * model.sigma**2)
    tables = np.stack([model.pairwise(), model.pairwise() + 0.8 * (label[:, None] - label) ** 2])
    naive = Problem(unary, tables, (h == 0).astype(int), (v == 0).astype(int))
    found = intensity_field(y, model, horizontal=h, vertical=v).labels
    free = intensity_field(y, model).labels
    assert (found != free).any()
    expected = naive.energy(found) - naive.energy(free)
    lines = [energy(y, x, h, v, model) for x in (found, free)]
    assert lines[0] - lines[1] == pytest.approx(expected, abs=1e-3)
    assert lines[0] < lines[1]


def test_ties_take_few_rounds() -> None:
    for levels, grey in ((2, 0.5), (4, 1.5), (8, 3.0)):
        found = intensity_field(np.full((200, 200), grey), EdgeModel(levels))
        assert found.unresolved == 0 and found.rounds <= 16
        assert len(np.unique(found.labels)) <= 2
    # Without data cost or coupling nothing is ever better, but every pixel takes a label.
    assert (minimise(np.zeros((5, 6, 3)), np.zeros((3, 3))).labels == 0).all()


def test_ranks_are_all_different() -> None:
    ranks = np.array([[site_rank(i, j) for j in range(65500, 65600)] for i in range(100)])
    assert len(np.unique(ranks)) == ranks.size and ranks.max() > 2**31


def test_nodata_parts_what_it_stands_between() -> None:
    _, y = scene(1, 40, 4, 0.5)
    y[:, 20] = np.nan
    model = EdgeModel(4)
    for method in get_args(Method):
        options: dict[str, Any] = {"search": Search(method, annealing=SHORT)}
        whole = intensity_field(y, model, **options).labels
        assert (whole[:, 20] == 255).all()
        np.testing.assert_array_equal(
            whole[:, 21:], intensity_field(y[:, 21:], model, origin=(0, 21), **options).labels
        )
    assert (intensity_field(np.full((3, 4), np.nan), model).labels == 255).all()


def test_descent_from_a_start() -> None:
    truth, y = scene(4, 50, 4, 0.4)
    model = EdgeModel(4)
    found = intensity_field(y, model, start=truth)
    assert found.unresolved == 0
    assert energy(y, found.labels, None, None, model) < energy(y, truth, None, None, model)
    for method in ("parallel", "serial"):
        again = intensity_field(y, model, start=found.labels, search=Search(method))  # type: ignore[arg-type]
        assert again.rounds == 0
        np.testing.assert_array_equal(again.labels, found.labels)


def test_bad_input_is_refused() -> None:
    unary, table = np.zeros((4, 5, 3)), np.zeros((3, 3))
    model = EdgeModel()
    for call, match in (
        (lambda: minimise(unary[0], table), "unary"),
        (lambda: minimise(unary[..., :1], table), "unary"),
        (lambda: minimise(unary + np.inf, table), "finite"),
        (lambda: minimise(unary, table[:2]), "3 x 3"),
        (lambda: minimise(unary, np.triu(np.ones((3, 3)))), "symmetric"),
        (lambda: minimise(unary, table, down=np.ones((4, 5))), "down"),
        (lambda: minimise(unary, table, down_weight=-np.ones((4, 5))), "down_weight must be finite and not neg"),
        (lambda: minimise(unary, table, right_weight=np.full((4, 5), np.nan)), "right_weight must be finite"),
        (lambda: minimise(unary, table, right_weight=np.ones((4, 4))), "right_weight must be a real"),
        (lambda: Search(scales=-1), "scales"),
        (lambda: label_energy(np.full((4, 5), 256), unary, table), "labels must be from 0 to 2"),
        (lambda: Search("swap"), "method"),  # type: ignore[arg-type]
        (lambda: Search(rounds=0), "rounds"),
        (lambda: Search(messages=0), "messages"),
        (lambda: minimise(unary, table, start=np.full((4, 5), 3)), "start"),
        (lambda: minimise(unary, table, start=np.zeros((4, 4))), "start"),
        (lambda: intensity_field(unary, model), "observed"),
        (lambda: intensity_field(np.full((3, 3), np.inf), model), "finite"),
        (lambda: intensity_field(unary[0], model, horizontal=np.zeros((1, 1), int)), "horizontal"),
        (lambda: halo(Search("serial")), "serial"),
        (lambda: Annealing(0), "sweep"),
        (lambda: Annealing(cold=2.0), "temperatures"),
    ):
        with pytest.raises(ValueError, match=match):
            call()


def test_annealing_starts_at_the_cost_of_a_pair() -> None:
    """With costs of about 20 the default schedule is nearly a quench."""
    random = np.random.default_rng(0)
    level = np.add.outer(np.arange(48) // 24, np.arange(48) // 24)
    unary = 10 * (level + random.normal(0, 1, level.shape))[:, :, None] - 10 * np.arange(4)
    unary, pairwise = unary**2 / 10, 20 * (1 - np.eye(4))
    quench, slow = (
        label_energy(minimise(unary, pairwise, search=Search("annealing", annealing=schedule)).labels, unary, pairwise)
        for schedule in (Annealing(), Annealing(hot=20, cold=1))
    )
    assert slow < 0.9 * quench
