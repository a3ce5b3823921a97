"""The ground on the device is the CPU's, bit for bit, and its windows are the oracle's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.heights import ground as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.heights.ground import ground_height, window_highest, window_lowest


def town(rows: int, columns: int, seed: int) -> NDArray[np.float32]:
    """A slope with houses, pits and voids."""
    random = np.random.default_rng(seed)
    dsm = 0.1 * np.arange(columns) + random.normal(0, 0.1, (rows, columns))
    for _ in range(2):
        top, left = random.integers(0, rows), random.integers(0, columns)
        dsm[top : top + 6, left : left + 5] += random.uniform(3, 9)
    dsm[random.random(dsm.shape) < 0.02] -= 8
    dsm[random.random(dsm.shape) < 0.1] = np.nan
    return dsm.astype(np.float32)


@settings(max_examples=8)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 4), st.integers(0, 99))
def test_windows_are_those_of_brute_force(rows: int, columns: int, half_width: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    values = random.normal(size=(rows, columns)).astype(np.float32)
    values[random.random(values.shape) < 0.2] = np.inf
    lowest, highest = window_lowest(to_device(values), half_width), window_highest(to_device(-values), half_width)
    assert on_device(lowest, highest)
    np.testing.assert_array_equal(to_host(lowest), naive.window_lowest(values, half_width))
    np.testing.assert_array_equal(to_host(highest), naive.window_highest(-values, half_width))
    turned = to_host(window_lowest(to_device(values).T, half_width))
    np.testing.assert_array_equal(turned, naive.window_lowest(values.T, half_width))


@pytest.mark.parametrize(
    ("shape", "resolution", "origin"), [((24, 20), 1.0, (0, 0)), ((17, 23), 0.5, (5, 3)), ((9, 11), 2.5, (7, 1))]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_ground_is_that_of_the_cpu(
    shape: tuple[int, int], resolution: float, origin: tuple[int, int], seed: int
) -> None:
    dsm = town(*shape, seed)
    options = {"resolution": resolution, "largest_object": 8.0, "origin": origin}
    found = ground_height(to_device(dsm), **options)
    assert on_device(found) and found.dtype == np.float32
    np.testing.assert_array_equal(to_host(found), ground_height(dsm, **options))


def test_nothing_has_no_ground() -> None:
    found = ground_height(to_device(np.full((6, 7), np.nan, np.float32)), resolution=1.0, largest_object=4.0)
    assert np.isnan(to_host(found)).all()
