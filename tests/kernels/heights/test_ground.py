"""The bare earth under streets, roofs, trees, hills and pits; its tiling, and its windows against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.heights import ground as naive
from tilepipe_kernels.heights.ground import _terrain, ground_height, half_widths, halo, window_highest, window_lowest
from tilepipe_kernels.heights.ground_loops import lowest_of_cells

Floats = NDArray[np.float32]


def city(rows: int, columns: int, seed: int = 0, missing: float = 0.02) -> tuple[Floats, Floats]:
    """Hilly ground and what stands on it: houses, trees, pits and voids, at 0.5 m."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns] * 0.5
    ground = (0.08 * x + 6 * np.sin(x / 40) * np.cos(y / 50)).astype(np.float32)
    dsm = ground + random.normal(0, 0.03, ground.shape).astype(np.float32)
    for _ in range(rows * columns // 1500):
        top, left = random.integers(0, rows), random.integers(0, columns)
        house = np.s_[top : top + random.integers(8, 40), left : left + random.integers(8, 40)]
        dsm[house] = ground[house].max() + random.uniform(3, 12)
    for _ in range(rows * columns // 3000):
        top, left = random.integers(0, rows), random.integers(0, columns)
        crown = np.s_[top : top + 10, left : left + 10]
        dsm[crown] += random.uniform(1, 9, dsm[crown].shape).astype(np.float32)
    dsm[random.random(dsm.shape) < missing / 10] -= 8
    dsm[random.random(dsm.shape) < missing] = np.nan
    return dsm, ground


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(1, 7), st.integers(0, 99))
def test_windows_are_those_of_brute_force(rows: int, columns: int, half_width: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    values = random.normal(size=(rows, columns)).astype(np.float32)
    values[random.random(values.shape) < 0.2] = np.inf
    np.testing.assert_array_equal(window_lowest(values, half_width), naive.window_lowest(values, half_width))
    np.testing.assert_array_equal(window_highest(-values, half_width), naive.window_highest(-values, half_width))


def test_cells_and_objects_are_those_of_brute_force() -> None:
    dsm, _ = city(70, 90, missing=0.4)
    shape, origin = (19, 24), (3, 2)
    low = np.empty(shape, np.float32)
    lowest_of_cells(low, dsm, 4, *origin)
    expected = naive.lowest_of_cells(dsm, 4, origin)
    assert {tuple(cell) for cell in np.argwhere(np.isfinite(low)).tolist()} == set(expected)
    for cell, lowest in expected.items():
        assert low[cell] == np.float32(lowest)
    low[5:9, 5:9] = np.inf
    widths = [1, 2, 4, 7]
    surface, not_ground = _terrain(low, widths, 2.0, 0.3, 1.5)
    objects = naive.is_object(low.astype(np.float64), widths, 2.0, 0.3, 1.5)
    assert 0.1 < objects.mean() < 0.9
    # Beyond the objects only pits are no ground.
    assert not_ground[objects].all() and (not_ground & ~objects).mean() < 0.1
    np.testing.assert_array_equal(surface, np.where(objects, naive.opening(low, widths[-1]), low))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 330), st.integers(0, 380), st.integers(1, 60), st.integers(1, 60), st.integers(0, 1000))
def test_a_block_with_its_halo_gives_the_bits_of_the_whole(
    top: int, left: int, rows: int, columns: int, start: int
) -> None:
    dsm, _ = city(400, 450)
    origin = (start, 7 * start)
    options = {"resolution": 0.5, "largest_object": 12.0}
    whole = ground_height(dsm, origin=origin, **options)
    width = halo(**options)
    assert width < 200
    y, x = max(0, top - width), max(0, left - width)
    block = dsm[y : top + rows + width, x : left + columns + width]
    part = ground_height(block, origin=(origin[0] + y, origin[1] + x), **options)
    core = part[top - y :, left - x :][:rows, :columns]
    np.testing.assert_array_equal(core, whole[top : top + rows, left : left + columns])


def test_ground_of_a_hilly_city_is_found_and_voids_stay_voids() -> None:
    dsm, ground = city(600, 600)
    found = ground_height(dsm, resolution=0.5)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(dsm))
    error = (found - ground)[~np.isnan(dsm)]
    assert np.sqrt(np.mean(error**2)) < 0.35 and abs(error.mean()) < 0.1
    raised = dsm - ground > 2.5
    assert ((dsm - found > 2.5) == raised)[~np.isnan(dsm)].mean() > 0.99


def test_a_steep_slope_is_kept_and_a_house_on_it_taken_off() -> None:
    ground = np.repeat(0.5 * 0.6 * np.arange(300, dtype=np.float32)[:, None], 300, axis=1)
    dsm = ground.copy()
    dsm[120:160, 100:170] = ground[160, 0] + 4
    error = np.abs(ground_height(dsm, resolution=0.5) - ground)[20:-20, 20:-20]
    assert error.max() < 1.0 and error.mean() < 0.02


def test_neither_a_canal_nor_a_pit_drags_the_ground_down() -> None:
    dsm = np.full((400, 400), 1.0, np.float32)
    dsm[:, 150:180] = -0.4
    dsm[60:90, 190:260] = 15
    dsm[300:304, 300:304] = -9
    found = ground_height(dsm, resolution=0.5)
    far = np.ones(dsm.shape, bool)
    far[:, 145:185] = False
    np.testing.assert_allclose(found[far], 1.0, atol=0.25)
    np.testing.assert_allclose(found[:, 155:175], -0.4, atol=1e-3)


def test_only_objects_narrower_than_the_largest_are_taken_off() -> None:
    dsm = np.zeros((500, 500), np.float32)
    dsm[200:300, 200:300] = 10
    assert ground_height(dsm, resolution=0.5, largest_object=60)[250, 250] == pytest.approx(0, abs=0.01)
    assert ground_height(dsm, resolution=0.5, largest_object=30)[250, 250] == pytest.approx(10)


def test_the_unit_of_length_is_the_metre_at_any_resolution() -> None:
    for resolution in (0.25, 1.0, 3.0):
        pixels = int(300 / resolution)
        dsm = np.zeros((pixels, pixels), np.float32)
        dsm[pixels // 3 : pixels // 2, pixels // 3 : pixels // 2] = 8
        np.testing.assert_allclose(ground_height(dsm, resolution=resolution), 0, atol=0.01)
    assert half_widths(1.0, 80)[-1] == half_widths(0.5, 80)[-1] == 20


def test_empty_void_and_bad_input() -> None:
    assert ground_height(np.zeros((0, 5)), resolution=1).shape == (0, 5)
    assert np.isnan(ground_height(np.full((9, 9), np.nan), resolution=1)).all()
    assert np.isnan(ground_height(np.full((9, 9), np.inf), resolution=1)).all()
    np.testing.assert_array_equal(ground_height(np.full((1, 1), 7, np.int16), resolution=1), [[7]])
    with pytest.raises(ValueError, match="two-dimensional"):
        ground_height(np.zeros(5), resolution=1)
    with pytest.raises(ValueError, match="resolution"):
        ground_height(np.zeros((5, 5)), resolution=0)
    with pytest.raises(ValueError, match="largest_object"):
        halo(1.0, -3)
    with pytest.raises(ValueError, match="slope"):
        ground_height(np.zeros((5, 5)), resolution=1, slope=-1)
