"""Line elements and coupled fields: against the total energy, brute force, and sub-blocks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.naive.mrf import lines as naive
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_energy import energy, energy_terms
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.lines.energies import find_stabilities, wishes
from tilepipe_kernels.mrf.lines.framed import framed_sites
from tilepipe_kernels.mrf.lines.hcf import parallel_rounds
from tilepipe_kernels.mrf.lines.minimise import CoupledFields, LineField, coupled_fields, halo, line_field
from tilepipe_kernels.mrf.lines.sites import H, V, X, neighbourhoods
from tilepipe_kernels.mrf.search import Method, Search

Field = NDArray[np.uint8]
TERMS = ("alpha", "gamma", "xi", "zeta")
WEIGHTS = {"alpha": 0.75, "gamma": 0.375, "xi": 0.625, "zeta": 1.25, "beta": 1.5, "sigma": 0.5}
"""Sums of these are exact and seldom tie."""


def scene(rows: int, columns: int, levels: int, seed: int, missing: float = 0.05) -> tuple[NDArray[np.float32], Field]:
    """Blocks and streets with noise: grey values with nodata, and labels."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, levels, (rows // 4 + 2, columns // 3 + 2))
    x = np.kron(coarse, np.ones((4, 3), int))[1 : rows + 1, 1 : columns + 1]
    x = np.where(random.random(x.shape) < 0.1, random.integers(0, levels, x.shape), x)
    # eighths, so that sums of squares are exact in float32
    y = (x + np.round(random.normal(0, 0.5, x.shape) * 8) / 8).astype(np.float32)
    hole = random.random(x.shape) < missing
    y[hole] = np.nan
    return y, np.where(hole, 255, x).astype(np.uint8)


def smooth_scene(size: int, levels: int) -> tuple[NDArray[np.float32], Field]:
    """Round regions of equal area, with noise; and their labels."""
    random = np.random.default_rng(3)
    field = gaussian_filter(random.normal(size=(size, size)), 3)
    x = np.digitize(field, np.quantile(field, np.arange(1, levels) / levels)).astype(np.uint8)
    return (x + random.normal(0, 0.4, x.shape)).astype(np.float32), x


def model_of(levels: int = 3, only: str | None = None, potential: str = "quadratic") -> EdgeModel:
    weights = dict(WEIGHTS)
    if only is not None:
        weights |= {name: 0.0 for name in TERMS if name not in (only, "alpha")}
    return EdgeModel(levels, potential, **weights)  # type: ignore[arg-type]


def line_energy(x: Field, field: LineField, model: EdgeModel) -> float:
    y = np.where(x == 255, np.nan, x.astype(np.float32))
    return energy_terms(y, x, field.horizontal, field.vertical, model.levels).lines(model)


def naive_state(y: NDArray[np.float32], x: Field | None) -> naive.State:
    blank = [np.full(y.shape, 255, np.uint8) for _ in range(3)]
    return naive.State(y, blank if x is None else [x.copy(), *blank[1:]])


# ------------------------------------------------------------------------------------------------- against brute force


@pytest.mark.parametrize("only", [None, *TERMS])
@pytest.mark.parametrize("potential", ["quadratic", "reciprocal"])
def test_stabilities_are_differences_of_the_total_energy(only: str | None, potential: str) -> None:
    y, x = scene(6, 7, 3, seed=11, missing=0.1)
    model = model_of(only=only, potential=potential)
    random = np.random.default_rng(12)
    sites = framed_sites(x, y, model, (0, 0), True)
    state, exists = sites.block.state, sites.block.exists
    for field in range(3):
        own = np.flatnonzero(exists & (np.arange(exists.size) // sites.block.frame.plane == field))
        state[own] = random.choice([0, 1, 1, 2 if field == 0 else 0, 255], own.size)
    found, choices = np.full(state.size, np.inf, np.float32), np.zeros(state.size, np.uint8)
    find_stabilities(sites.block, sites.weights, np.flatnonzero(exists).astype(np.int32), found, choices)
    shape = (3, 10, 11)
    values = naive.State(y, list(state.reshape(shape)[:, 2:-2, 2:-2].copy()))
    for site in naive.sites(values, True):
        g, choice = naive.stability(values, site, model, sure=True)
        at = np.ravel_multi_index((site[0], site[1] + 2, site[2] + 2), shape)
        assert found[at] == pytest.approx(g, abs=1e-4)
        assert g == np.inf or choices[at] == choice


@settings(max_examples=10, deadline=None)
@given(
    st.tuples(st.integers(1, 5), st.integers(1, 6)),
    st.integers(0, 999),
    st.sampled_from([None, *TERMS]),
    st.sampled_from([2, 99]),
    st.booleans(),
)
def test_parallel_lines_are_those_of_brute_force(shape: tuple, seed: int, only: str, rounds: int, sure: bool) -> None:
    y, x = scene(*shape, 3, seed)
    model, origin = model_of(only=only), (seed % 7, 1000)
    state = naive_state(y, x)
    # Without a weight the naive neighbourhood is larger than need be, so that only all terms compare.
    if only is not None:
        model = dataclasses.replace(model, **{name: 2.0**-9 for name in TERMS if getattr(model, name) == 0})
    expected = naive.parallel_hcf(state, model, rounds, origin, integrated=False, sure=sure)
    found = line_field(x, model, search=Search(rounds=rounds, sure=sure), origin=origin)
    for mine, theirs in zip(found[:2], state.fields[1:], strict=True):
        assert np.array_equal(mine, np.where(theirs == 255, 0, theirs))
    assert (found.rounds, found.unresolved) == expected


@settings(max_examples=12, deadline=None)
@given(
    st.tuples(st.integers(1, 4), st.integers(1, 4)),
    st.integers(0, 999),
    st.sampled_from([2, 4]),
    st.sampled_from([3, 99]),
    st.booleans(),
)
def test_parallel_coupled_fields_are_those_of_brute_force(
    shape: tuple, seed: int, levels: int, rounds: int, sure: bool
) -> None:
    y, _ = scene(*shape, levels, seed)
    model, origin = model_of(levels), (5, seed)
    state = naive_state(y, None)
    expected = naive.parallel_hcf(state, model, rounds, origin, integrated=True, sure=sure)
    found = coupled_fields(y, model, search=Search(rounds=rounds, sure=sure), origin=origin)
    for mine, theirs, empty in zip(found[:3], state.fields, (255, 0, 0), strict=True):
        assert np.array_equal(mine, np.where(theirs == 255, empty, theirs))
    assert (found.rounds, found.unresolved) == expected


@pytest.mark.parametrize(("levels", "sigma"), [(2, 0.3), (4, 0.3), (4, 1.2)])
def test_the_worklist_forgets_no_site(levels: int, sigma: float) -> None:
    """After each round the stabilities are those that looking at every site gives."""
    y, _ = smooth_scene(80, levels)
    sites = framed_sites(np.full(y.shape, 255, np.uint8), y, EdgeModel(levels, sigma=sigma), (0, 0), True)
    kept, choices = np.empty(sites.block.state.size, np.float32), np.empty(sites.block.state.size, np.uint8)
    fresh = np.empty_like(kept)
    wanting = wishes(sites.block, sites.weights, kept, choices, False)
    while wanting.size:
        _, wanting = parallel_rounds(sites.block, sites.weights, kept, choices, wanting, 1)
        again = wishes(sites.block, sites.weights, fresh, choices.copy(), True)
        assert np.array_equal(kept, fresh) and np.array_equal(np.sort(wanting), again)


# ------------------------------------------------------------------------------------------------- minima


@pytest.mark.parametrize("method", ["parallel", "serial", "icm", "annealing"])
@pytest.mark.parametrize("only", [None, *TERMS])
def test_no_single_element_can_lower_the_energy(method: Method, only: str | None) -> None:
    _, x = scene(14, 13, 3, seed=5)
    model = model_of(only=only)
    found = line_field(x, model, search=Search(method, 99, Annealing(sweeps=5)))
    assert found.unresolved == 0
    least = line_energy(x, found, model)
    elements = np.stack(found[:2])
    assert elements.max() == 1
    for field, i, j in np.argwhere(elements < 2):
        flipped = elements.copy()
        flipped[field, i, j] ^= 1
        assert line_energy(x, LineField(flipped[0], flipped[1], 0, 0), model) >= least - 1e-6


@pytest.mark.parametrize("method", ["parallel", "serial", "icm", "annealing"])
@pytest.mark.parametrize("potential", ["quadratic", "reciprocal"])
def test_no_single_site_can_lower_the_coupled_energy(method: Method, potential: str) -> None:
    y, _ = scene(9, 8, 4, seed=6)
    model = model_of(4, potential=potential)
    found = coupled_fields(y, model, search=Search(method, 99, Annealing(sweeps=5)))
    assert found.unresolved == 0
    assert np.array_equal(found.labels == 255, np.isnan(y))
    least = energy(y, *found[:3], model)
    for field in range(3):
        for i, j in np.argwhere(~np.isnan(y)):
            for value in range(4 if field == 0 else 2):
                changed = [array.copy() for array in found[:3]]
                changed[field][i, j] = value
                assert energy(y, *changed, model) >= least - 1e-3


@pytest.mark.parametrize("levels", [2, 4])
def test_energies_of_the_optimisers_lie_as_they_should(levels: int) -> None:
    y, x = smooth_scene(100, levels)
    model = EdgeModel(levels)
    methods: tuple[Method, ...] = ("parallel", "serial", "icm", "annealing")
    fields = {method: line_field(x, model, search=Search(method, 60)) for method in methods}
    lines = {method: line_energy(x, fields[method], model) for method in methods}
    plain = line_field(x, model, search=Search("serial", sure=False))
    assert lines["parallel"] <= 1.005 * lines["serial"]
    assert lines["annealing"] < lines["parallel"] < min(lines["icm"], line_energy(x, plain, model))
    # Edges that nothing speaks for, or against, are not drawn.
    assert fields["annealing"].horizontal.sum() < 1.2 * fields["serial"].horizontal.sum()
    both = {method: energy(y, *coupled_fields(y, model, search=Search(method, 60))[:3], model) for method in methods}
    assert both["parallel"] - both["serial"] <= 0.01 * abs(both["serial"])
    assert both["annealing"] < both["parallel"] < both["icm"]


def test_labels_to_start_from_are_made_better() -> None:
    y, x = smooth_scene(60, 2)
    model = EdgeModel(2)
    drawn = line_field(x, model)
    found = coupled_fields(y, model, start=x)
    assert energy(y, *found[:3], model) < energy(y, x, *drawn[:2], model)
    assert found.unresolved == 0 and found.rounds < coupled_fields(y, model).rounds
    y[:9, 3] = np.nan
    x[40:, 40:] = 255
    found = coupled_fields(y, model, start=x)
    assert np.array_equal(found.labels == 255, np.isnan(y)) and found.unresolved == 0


def test_straight_border_is_drawn_and_a_gap_in_it_is_not_left() -> None:
    x = np.zeros((6, 9), np.uint8)
    x[3:] = 1
    x[2:4, 4] = 1, 0
    found = line_field(x, EdgeModel(2))
    expected = np.zeros_like(x)
    expected[2] = 1
    assert np.array_equal(found.horizontal[2], expected[2])


def test_nothing_is_drawn_beside_nodata_or_beyond_the_raster() -> None:
    _, x = scene(30, 30, 4, seed=3, missing=0.3)
    for found in (line_field(x, EdgeModel(4)), coupled_fields(np.where(x == 255, np.nan, x), EdgeModel(4))[1:]):
        h, v = found[:2]
        assert h.sum() and v.sum() and h.max() == v.max() == 1
        assert not h[-1].any() and not v[:, -1].any()
        assert not h[x == 255].any() and not v[x == 255].any()
        assert not h[:-1][x[1:] == 255].any() and not v[:, :-1][x[:, 1:] == 255].any()


# ------------------------------------------------------------------------------------------------- tiles


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([("parallel", 2), ("parallel", 3), ("icm", 1), ("icm", 2), ("annealing", 1)]),
    st.booleans(),
    st.sampled_from([None, "xi"]),
    st.integers(0, 99),
    st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(1, 30), st.integers(1, 30)),
)
def test_law_1_a_block_with_its_halo_gives_the_same(
    scheme: tuple, integrated: bool, only: str | None, seed: int, window: tuple[int, int, int, int]
) -> None:
    y, x = scene(70, 70, 2, seed)
    model = model_of(2, only=only)
    method, rounds = scheme
    schedule = Annealing(sweeps=1, hot=0.5, cold=0.5, seed=seed)
    search = Search(method, rounds, schedule)
    margin = halo(model, search, integrated=integrated)
    top, left, rows, columns = window
    low = max(top - margin, 0), max(left - margin, 0)
    block = np.s_[low[0] : top + rows + margin, low[1] : left + columns + margin]
    core = np.s_[top - low[0] : top - low[0] + rows, left - low[1] : left - low[1] + columns]
    run = coupled_fields if integrated else line_field
    given_array = y if integrated else x
    at = np.s_[top : top + rows, left : left + columns]
    whole: CoupledFields | LineField = run(given_array, model, origin=(300, 7), core=at, search=search)  # type: ignore
    part = run(given_array[block], model, origin=(300 + low[0], 7 + low[1]), core=core, search=search)  # type: ignore
    for one, other in zip(whole[:-2], part[:-2], strict=True):
        assert np.array_equal(one[at], other[core])
    assert whole.unresolved == part.unresolved


def test_the_halo_follows_from_the_terms() -> None:
    full, corners = EdgeModel(2), EdgeModel(2, gamma=0, zeta=0)
    assert halo(full, Search(rounds=10)) == 2 * 2 * 10 + 1 and halo(corners, Search(rounds=10)) == 2 * 1 * 10 + 1
    assert halo(full, Search("icm", 10)) == 2 * 6 * 10 + 1
    assert halo(full, Search("icm", 10), integrated=True) == 2 * 8 * 10 + 1
    near = neighbourhoods(full, integrated=True)
    assert [len(near.neighbours[field]) for field in (X, H, V)] == [8, 14, 14]
    for field, neighbours in enumerate(near.neighbours):
        for other, i, j in neighbours:
            assert (field, -i, -j) in near.neighbours[other]
    with pytest.raises(ValueError, match="whole raster"):
        halo(full, Search("serial"))
    with pytest.raises(ValueError, match="between labels"):
        halo(full, Search("messages"))


def test_ties_and_draws_depend_on_the_place() -> None:
    _, x = scene(40, 40, 2, seed=8)
    for method in ("parallel", "annealing"):
        here, there = (
            line_field(x, EdgeModel(2), search=Search(method), origin=at).horizontal for at in ((0, 0), (1, 0))
        )
        assert not np.array_equal(here, there)
    seeds = [
        line_field(x, EdgeModel(2), search=Search("annealing", annealing=Annealing(seed=s))).vertical for s in (0, 1)
    ]
    assert not np.array_equal(*seeds)


def test_unresolved_sites_are_counted_in_the_core_alone() -> None:
    _, x = scene(40, 40, 3, seed=9)
    whole = line_field(x, EdgeModel(3), search=Search(rounds=1))
    halves = [
        line_field(x, EdgeModel(3), search=Search(rounds=1), core=np.s_[part, :])
        for part in (slice(0, 17), slice(17, None))
    ]
    assert whole.unresolved == halves[0].unresolved + halves[1].unresolved > 0 < halves[0].unresolved
    assert set(np.unique(whole.horizontal)) == {0, 1}


def test_bad_input_is_named() -> None:
    x = np.zeros((4, 4), np.uint8)
    with pytest.raises(ValueError, match="two-dimensional"):
        line_field(x[0], EdgeModel(2))
    with pytest.raises(ValueError, match="0 to 1"):
        line_field(x + 2, EdgeModel(2))
    with pytest.raises(ValueError, match="between labels"):
        coupled_fields(x, EdgeModel(2), search=Search("messages"))
