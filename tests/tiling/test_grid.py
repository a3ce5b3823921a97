"""Tiles cover the raster once; seams lie between neighbours; windows obey their algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilepipe.tiling.grid import TileGrid, Window

sizes = st.integers(1, 40)


@given(rows=sizes, columns=sizes, tile_rows=sizes, tile_columns=sizes, halo=st.integers(0, 50))
def test_cores_cover_every_pixel_once_and_halos_stay_inside(rows, columns, tile_rows, tile_columns, halo):
    grid = TileGrid((rows, columns), (tile_rows, tile_columns))
    count = np.zeros((rows, columns), int)
    for tile in grid.tiles(halo):
        count[tile.core.slices] += 1
        assert tile.padded == tile.core.padded(halo, grid.shape)
        assert tile.core_in_padded.shape == tile.core.shape
        assert grid.number_at(*tile.core.origin) == tile.number
    assert (count == 1).all()


@given(rows=sizes, columns=sizes, tile_rows=sizes, tile_columns=sizes)
def test_seams_are_the_pairs_of_touching_cores(rows, columns, tile_rows, tile_columns):
    grid = TileGrid((rows, columns), (tile_rows, tile_columns))
    owner = np.empty((rows, columns), int)
    for tile in grid.tiles():
        owner[tile.core.slices] = tile.number
    expected = {(a, b, False) for a, b in zip(owner[:-1].ravel(), owner[1:].ravel(), strict=True) if a != b}
    expected |= {(a, b, True) for a, b in zip(owner[:, :-1].ravel(), owner[:, 1:].ravel(), strict=True) if a != b}
    assert {(s.first, s.second, s.vertical) for s in grid.seams()} == expected


@given(st.tuples(sizes, sizes), st.tuples(sizes, sizes), st.data())
def test_overlapping_finds_exactly_the_tiles_that_share_pixels(shape, tile_shape, data):
    grid = TileGrid(shape, tile_shape)
    top, left = data.draw(st.integers(0, shape[0] - 1)), data.draw(st.integers(0, shape[1] - 1))
    window = Window(top, left, data.draw(st.integers(top + 1, shape[0])), data.draw(st.integers(left + 1, shape[1])))
    expected = [t.number for t in grid.tiles() if not t.core.intersection(window).is_empty]
    assert [t.number for t in grid.overlapping(window)] == expected


def test_coarsened_grid_has_the_same_tiles_of_rectangles():
    grid = TileGrid((10, 14), (6, 9))
    coarse = grid.coarsened((3, 3))
    assert coarse.shape == (4, 5)
    assert coarse.counts == grid.counts
    with pytest.raises(ValueError, match="multiple"):
        TileGrid((10, 10), (5, 5)).coarsened((3, 1))


def test_empty_grid_is_refused():
    with pytest.raises(ValueError, match="at least one pixel"):
        TileGrid((0, 5), (2, 2))
