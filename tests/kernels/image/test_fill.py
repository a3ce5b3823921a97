"""Voids get the nearest value within reach, the same however the raster is cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.naive.image import fill as naive
from tilepipe_kernels.image import fill


def scene(seed: int, shape: tuple[int, int], share: float) -> np.ndarray:
    """All values differ, so that a wrong neighbour shows."""
    rng = np.random.default_rng(seed)
    values = rng.permutation(shape[0] * shape[1]).reshape(shape).astype(np.float32)
    values[rng.random(shape) < share] = np.nan
    return values


@given(
    seed=st.integers(0, 2**20),
    rows=st.integers(1, 14),
    columns=st.integers(1, 14),
    share=st.sampled_from([0.1, 0.5, 0.9, 1.0]),
    reach=st.integers(0, 9),
)
def test_like_looking_at_every_pixel(seed, rows, columns, share, reach):
    values = scene(seed, (rows, columns), share)
    expected = naive.fill_voids(values, reach)
    assert np.array_equal(fill.fill_voids(values, reach), expected, equal_nan=True)


@given(
    seed=st.integers(0, 2**20),
    reach=st.integers(1, 5),
    top=st.integers(0, 20),
    left=st.integers(0, 20),
    size=st.integers(1, 12),
)
def test_tiling_is_invisible(seed, reach, top, left, size):
    values = scene(seed, (32, 32), 0.8)
    whole = fill.fill_voids(values, reach)
    halo = fill.halo(reach)
    low_row, low_column = max(0, top - halo), max(0, left - halo)
    part = values[low_row : top + size + halo, low_column : left + size + halo]
    core = fill.fill_voids(part, reach)[top - low_row :, left - low_column :][:size, :size]
    assert np.array_equal(core, whole[top : top + size, left : left + size], equal_nan=True)


def test_nothing_to_fill():
    values = scene(1, (5, 6), 0.5)
    assert np.array_equal(fill.fill_voids(values, 0), values, equal_nan=True)
    assert np.isnan(fill.fill_voids(np.full((4, 4), np.nan), 3)).all()
    whole = np.arange(12, dtype=np.uint8).reshape(3, 4)
    filled = fill.fill_voids(whole, 3)
    assert filled.dtype == np.float32
    assert np.array_equal(filled, whole)


def test_the_input_is_left_alone():
    values = scene(2, (8, 8), 0.5)
    before = values.copy()
    fill.fill_voids(values, 4)
    assert np.array_equal(values, before, equal_nan=True)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="two dimensions"):
        fill.fill_voids(np.zeros(4), 1)
    with pytest.raises(ValueError, match="must not be negative"):
        fill.fill_voids(np.zeros((4, 4)), -1)
