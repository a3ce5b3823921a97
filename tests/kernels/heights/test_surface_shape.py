"""Planarity and bend of surfaces against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.heights import ground as naive
from tilepipe_kernels.heights.surface_shape import MISSING, half_width_at, halo, surface_shape

MEASURES = ("planarity", "bend")


def surface(rows: int, columns: int, seed: int, missing: float, base: int = 0) -> NDArray[np.int32]:
    random = np.random.default_rng(seed)
    ticks = base + random.integers(-5000, 5000, (rows, columns)) + 300 * np.arange(columns)
    return np.where(random.random(ticks.shape) < missing, MISSING, ticks).astype(np.int32)


@settings(max_examples=25, deadline=None)
@given(
    st.builds(surface, st.integers(1, 9), st.integers(1, 12), st.integers(0, 999), st.sampled_from([0, 0.2, 0.7])),
    st.integers(1, 3),
)
def test_measures_are_those_of_every_window_fitted_anew(ticks: NDArray[np.int32], half_width: int) -> None:
    found = surface_shape(ticks, half_width=half_width)
    rough = np.full(ticks.shape, np.nan)
    for i, j in np.ndindex(ticks.shape):
        rough[i, j] = naive.plane(ticks, MISSING, i, j, half_width) / 1000
        np.testing.assert_allclose(found.bend[i, j], naive.bend(ticks, MISSING, i, j, half_width) / 1000, rtol=1e-6)
    best = naive.window_lowest(np.where(np.isnan(rough), np.inf, rough), half_width)
    present = ticks != MISSING
    np.testing.assert_allclose(found.planarity, np.where(present & (best < np.inf), best, np.nan), rtol=1e-5, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 30), st.integers(0, 40), st.integers(1, 20), st.integers(1, 20), st.integers(1, 4))
def test_a_block_with_its_halo_gives_the_bits_of_the_whole(
    top: int, left: int, rows: int, columns: int, half_width: int
) -> None:
    ticks = surface(50, 60, 4, 0.1, base=3_000_000)
    whole = surface_shape(ticks, half_width=half_width)
    width = halo(half_width)
    y, x = max(0, top - width), max(0, left - width)
    part = surface_shape(ticks[y : top + rows + width, x : left + columns + width], half_width=half_width)
    for name in MEASURES:
        core = getattr(part, name)[top - y :, left - x :][:rows, :columns]
        np.testing.assert_array_equal(core, getattr(whole, name)[top : top + rows, left : left + columns])


def test_a_tilted_plane_is_not_bent_at_any_height() -> None:
    rows, columns = np.mgrid[:20, :30]
    found = surface_shape((8_000_000 + 300 * columns - 400 * rows).astype(np.int32))
    assert (found.planarity == 0).all()
    assert np.nanmax(found.bend) == 0 and np.isnan(found.bend[0, 0])


def test_the_edge_of_a_roof_is_forgiven_and_a_crown_is_not() -> None:
    ticks = np.zeros((30, 30), np.int32)
    ticks[10:20, 8:22] = 6000
    found = surface_shape(ticks)
    assert (found.planarity[10:20, 8:22] == 0).all() and found.bend[10, 15] == 0
    ticks[10:20, 8:22] = np.random.default_rng(0).integers(3000, 9000, (10, 14))
    found = surface_shape(ticks)
    assert found.planarity[12:18, 10:20].min() > 0.5 and np.median(found.bend[12:18, 10:20]) > 0.3


def test_the_window_is_of_metres() -> None:
    assert [half_width_at(resolution) for resolution in (0.1, 0.25, 0.5, 1.0, 5.0)] == [6, 4, 2, 1, 1]
    with pytest.raises(ValueError, match="resolution"):
        half_width_at(0)


def test_bad_input_is_named() -> None:
    ticks = np.zeros((4, 4), np.int32)
    with pytest.raises(ValueError, match="int32"):
        surface_shape(ticks.astype(np.float32))
    with pytest.raises(ValueError, match="half_width"):
        surface_shape(ticks, half_width=7)
    with pytest.raises(ValueError, match="reference"):
        surface_shape(ticks - 2**25)
