"""Voids, distances, morphology and skeletons on the device give the very pixels of the CPU."""

from __future__ import annotations

import numpy as np
import pytest

from tests.naive.network import skeleton as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.image import distance, fill, morphology
from tilepipe_kernels.network import skeleton

RNG = np.random.default_rng(3)
ROWS, COLUMNS = np.mgrid[:30, :34]
STREETS = (abs(ROWS - 0.6 * COLUMNS - 3) < 4) | (abs(ROWS + COLUMNS - 35) < 3)
STREETS &= RNG.random(STREETS.shape) > 0.03
NOISE = RNG.random((21, 18)) > 0.3


@pytest.mark.parametrize("mask", [STREETS, NOISE, np.ones((7, 5), np.bool_), np.zeros((4, 6), np.bool_)])
@pytest.mark.parametrize("cap", [2, 9])
def test_nearest_background_is_the_same(mask: np.ndarray, cap: int) -> None:
    expected = distance.nearest_background(mask, cap)
    found = distance.nearest_background(to_device(mask), cap)
    for a, b in zip(expected, found, strict=True):
        assert on_device(b)
        np.testing.assert_array_equal(to_host(b), a)


def test_bands_of_rows_are_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    from tilepipe_kernels.image.device import distance as on_gpu

    monkeypatch.setattr(on_gpu, "_BAND", 4)
    found = distance.nearest_background(to_device(STREETS), 3)
    np.testing.assert_array_equal(to_host(found[0]), distance.nearest_background(STREETS, 3)[0])


@pytest.mark.parametrize("reach", [0.5, 1.0, 2.3, 5.0])
def test_voids_are_filled_alike(reach: float) -> None:
    values = RNG.random((17, 22)).astype(np.float32)
    values[RNG.random(values.shape) < 0.7] = np.nan
    found = fill.fill_voids(to_device(values), reach)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), fill.fill_voids(values, reach))


@pytest.mark.parametrize("mask", [STREETS, NOISE])
def test_morphology_is_the_same(mask: np.ndarray) -> None:
    there = to_device(mask)
    for radius in (0.0, 1.0, 2.2):
        np.testing.assert_array_equal(to_host(morphology.open_mask(there, radius)), morphology.open_mask(mask, radius))
        np.testing.assert_array_equal(
            to_host(morphology.close_mask(there, radius)), morphology.close_mask(mask, radius)
        )
    for size in (1, 2, 4):
        found = morphology.fill_specks(there, size)
        assert on_device(found)
        np.testing.assert_array_equal(to_host(found), morphology.fill_specks(mask, size))


def test_grey_opening_is_the_same() -> None:
    heights = RNG.random((15, 19)).astype(np.float32)
    heights[RNG.random(heights.shape) < 0.2] = np.nan
    heights[3:9, 4:11] = np.nan
    found = morphology.open_grey(to_device(heights), 2)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), morphology.open_grey(heights, 2))


@pytest.mark.parametrize("origin", [(0, 0), (3, 4), (1, 1)])
def test_skeleton_is_the_same(origin: tuple[int, int]) -> None:
    expected, squared = skeleton.medial_axis_and_distance(STREETS, cap=6, origin=origin)
    axis, squared_there = skeleton.medial_axis_and_distance(to_device(STREETS), cap=6, origin=origin)
    assert on_device(axis)
    np.testing.assert_array_equal(to_host(axis), expected)
    np.testing.assert_array_equal(to_host(squared_there), squared)
    links = skeleton.skeleton_links(axis)
    assert on_device(links)
    np.testing.assert_array_equal(to_host(links), skeleton.skeleton_links(expected))
    np.testing.assert_array_equal(to_host(skeleton.width_at(squared_there)), skeleton.width_at(squared))
    assert naive is not None
