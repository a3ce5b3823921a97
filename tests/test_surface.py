"""Roughness, slope, depth and bend of surfaces, and their sums over regions, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive import ground as naive
from tilepipe_kernels.surface import CAPS, MISSING, RegionFeatures, halo, region_features, surface_shape

MEASURES = ("roughness", "planarity", "slope", "depth", "bend")


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
    found = surface_shape(ticks, resolution=0.5, half_width=half_width)
    rough = np.full(ticks.shape, np.nan)
    for i, j in np.ndindex(ticks.shape):
        deviation, slope = naive.plane(ticks, MISSING, i, j, half_width)
        rough[i, j] = deviation / 1000
        np.testing.assert_allclose(found.slope[i, j], slope / 500, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(found.bend[i, j], naive.bend(ticks, MISSING, i, j, half_width) / 1000, rtol=1e-6)
    np.testing.assert_allclose(found.roughness, rough, rtol=1e-5, atol=1e-6)
    present, heights = ticks != MISSING, ticks.astype(np.float64)
    best = naive.window_lowest(np.where(np.isnan(rough), np.inf, rough), half_width)
    np.testing.assert_allclose(found.planarity, np.where(present & (best < np.inf), best, np.nan), rtol=1e-5, atol=1e-6)
    highest = naive.window_highest(np.where(present, heights, -np.inf), half_width)
    lowest = naive.window_lowest(np.where(present, heights, np.inf), half_width)
    depth = np.subtract(highest, lowest, out=np.full(ticks.shape, np.nan), where=present)
    np.testing.assert_allclose(found.depth, depth / 1000, rtol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 30), st.integers(0, 40), st.integers(1, 20), st.integers(1, 20), st.integers(1, 4))
def test_a_block_with_its_halo_gives_the_bits_of_the_whole(
    top: int, left: int, rows: int, columns: int, half_width: int
) -> None:
    ticks = surface(50, 60, 4, 0.1, base=3_000_000)
    whole = surface_shape(ticks, resolution=0.5, half_width=half_width)
    width = halo(half_width)
    y, x = max(0, top - width), max(0, left - width)
    part = surface_shape(
        ticks[y : top + rows + width, x : left + columns + width], resolution=0.5, half_width=half_width
    )
    for name in MEASURES:
        core = getattr(part, name)[top - y :, left - x :][:rows, :columns]
        np.testing.assert_array_equal(core, getattr(whole, name)[top : top + rows, left : left + columns])


def test_a_tilted_plane_is_neither_rough_nor_bent_at_any_height() -> None:
    rows, columns = np.mgrid[:20, :30]
    ticks = (8_000_000 + 300 * columns - 400 * rows).astype(np.int32)
    found = surface_shape(ticks, resolution=0.5)
    assert (found.roughness == 0).all() and (found.planarity == 0).all()
    np.testing.assert_allclose(found.slope, 1.0, rtol=1e-6)
    assert np.nanmax(found.bend) == 0 and np.isnan(found.bend[0, 0])


def test_only_planarity_and_bend_forgive_the_edge_of_a_roof() -> None:
    ticks = np.zeros((30, 30), np.int32)
    ticks[10:20, 8:22] = 6000
    found = surface_shape(ticks, resolution=0.5)
    assert found.roughness[10, 15] > 1 and found.depth[10, 15] == 6
    assert (found.planarity[10:20, 8:22] == 0).all() and found.bend[10, 15] == 0


def test_sums_of_regions_add_up_over_tiles_and_are_capped() -> None:
    ticks = surface(24, 31, 1, 0.1)
    labels = np.random.default_rng(2).integers(0, 5, ticks.shape).astype(np.int32)
    height = np.where(ticks == MISSING, np.nan, ticks / 1000).astype(np.float32)
    shape = surface_shape(ticks, resolution=0.5)
    whole = region_features(labels, height, shape, 4)

    def part(columns: slice) -> RegionFeatures:
        cut = type(shape)(*(getattr(shape, name)[:, columns] for name in MEASURES))
        return region_features(labels[:, columns], height[:, columns], cut, 4)

    left, right = part(slice(0, 13)), part(slice(13, None))
    np.testing.assert_array_equal(whole.count, left.count + right.count)
    for name, cap in CAPS.items():
        np.testing.assert_array_equal(whole.sums[name], left.sums[name] + right.sums[name])
        np.testing.assert_array_equal(whole.known[name], left.known[name] + right.known[name])
        values = (height if name == "height" else getattr(shape, name)).astype(np.float64)
        means = [np.nanmean(np.clip(values[labels == label], -cap, cap)) for label in range(1, 5)]
        np.testing.assert_allclose(whole.mean(name), means, atol=5e-4)


def test_bad_input_is_named() -> None:
    ticks = np.zeros((4, 4), np.int32)
    with pytest.raises(ValueError, match="int32"):
        surface_shape(ticks.astype(np.float32), resolution=0.5)
    with pytest.raises(ValueError, match="half_width"):
        surface_shape(ticks, resolution=0.5, half_width=7)
    with pytest.raises(ValueError, match="resolution"):
        surface_shape(ticks, resolution=0)
    with pytest.raises(ValueError, match="reference"):
        surface_shape(ticks - 2**25, resolution=0.5)
    shape = surface_shape(ticks, resolution=0.5)
    with pytest.raises(ValueError, match="one shape"):
        region_features(np.zeros((3, 4), np.int32), ticks.astype(np.float32), shape, 1)
    with pytest.raises(ValueError, match=r"0\.\.1"):
        region_features(ticks + 2, ticks.astype(np.float32), shape, 1)
