"""The quadtree on the device has the very leaves of the CPU and of the oracle."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.regions import quadtree as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.regions.quadtree import split
from tilepipe_kernels.regions.quadtree_sums import MISSING

COLUMNS = ("first", "level", "count", "total", "squares")


def scene(rows: int, columns: int, seed: int, missing: float, noise: int = 1) -> NDArray[np.int32]:
    """A step in a plane far from zero, with noise and nodata."""
    random = np.random.default_rng(seed)
    ticks = np.full((rows, columns), -2_000_000, np.int32)
    ticks[random.integers(0, rows) :, random.integers(0, columns) :] += 3_000
    ticks += random.integers(-noise, noise + 1, ticks.shape, dtype=np.int32)
    ticks[random.random(ticks.shape) < missing] = MISSING
    return ticks


@settings(max_examples=12)
@given(
    st.builds(
        scene, st.integers(1, 18), st.integers(1, 18), st.integers(0, 9999), st.sampled_from([0.0, 0.1, 0.7, 1.0])
    ),
    st.sampled_from([0.0, 0.25, 0.5, 400.0]),
    st.sampled_from([(1, 1), (1, 8), (2, 2), (2, 16), (4, 8), (8, 16)]),
)
def test_leaves_are_those_of_the_oracle(ticks: NDArray[np.int32], threshold: float, sides: tuple[int, int]) -> None:
    smallest, largest = sides
    labels, leaves = split(to_device(ticks), threshold=threshold, smallest=smallest, largest=largest)
    columns = [getattr(leaves, name) for name in COLUMNS]
    assert on_device(labels, *columns)
    expected, rows = naive.split(ticks, Fraction(threshold), smallest, largest)
    np.testing.assert_array_equal(to_host(labels), expected)
    assert list(zip(*(to_host(column).tolist() for column in columns), strict=True)) == rows


def test_columns_have_the_types_of_the_cpu() -> None:
    ticks = scene(9, 7, 1, 0.1)
    labels, leaves = split(ticks, threshold=0.5, smallest=2, largest=8)
    found, table = split(to_device(ticks), threshold=0.5, smallest=2, largest=8)
    assert labels.dtype == found.dtype
    for name in COLUMNS:
        here, there = getattr(leaves, name), getattr(table, name)
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, to_host(there))


def test_block_without_pixels_has_no_leaves() -> None:
    labels, leaves = split(to_device(np.empty((0, 5), np.int32)), threshold=1, smallest=2, largest=8)
    assert labels.shape == (0, 5) and leaves.first.size == 0


def test_ticks_too_large_are_refused() -> None:
    with pytest.raises(ValueError, match="ticks reach 40000000"):
        split(to_device(np.full((4, 4), -40_000_000, np.int32)), threshold=1, smallest=1, largest=64)
