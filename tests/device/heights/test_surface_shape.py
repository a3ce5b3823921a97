"""Planarity and bend on the device are the CPU's, bit for bit, and those of every window fitted anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.heights import ground as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.heights.surface_shape import MISSING, surface_shape


def surface(rows: int, columns: int, seed: int, missing: float) -> NDArray[np.int32]:
    random = np.random.default_rng(seed)
    ticks = 8_000_000 + random.integers(-5000, 5000, (rows, columns)) + 300 * np.arange(columns)
    return np.where(random.random(ticks.shape) < missing, MISSING, ticks).astype(np.int32)


@settings(max_examples=8)
@given(
    st.builds(surface, st.integers(1, 9), st.integers(1, 12), st.integers(0, 999), st.sampled_from([0, 0.2, 0.7])),
    st.integers(1, 3),
)
def test_measures_are_those_of_the_cpu(ticks: NDArray[np.int32], half_width: int) -> None:
    here, there = (surface_shape(array, half_width=half_width) for array in (ticks, to_device(ticks)))
    assert on_device(there.planarity, there.bend)
    for name in ("planarity", "bend"):
        found = to_host(getattr(there, name))
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, getattr(here, name))


def test_planes_are_those_of_every_window_fitted_anew() -> None:
    ticks = surface(8, 9, 3, 0.2)
    rough = np.array([naive.plane(ticks, MISSING, i, j, 1) / 1000 for i, j in np.ndindex(ticks.shape)])
    rough = np.where(np.isnan(rough), np.inf, rough).reshape(ticks.shape)
    best = naive.window_lowest(rough, 1)
    found = to_host(surface_shape(to_device(ticks), half_width=1).planarity)
    np.testing.assert_allclose(found, np.where((ticks != MISSING) & (best < np.inf), best, np.nan), rtol=1e-5)


def test_ticks_too_large_are_refused() -> None:
    with pytest.raises(ValueError, match="must lie within"):
        surface_shape(to_device(np.full((3, 3), -(2**24), np.int32)))
