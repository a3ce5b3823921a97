"""What two tiles know of their seam is what a whole raster has there; a border of the raster is none."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tilepipe.tiling.grid import TileGrid
from tilepipe.tiling.seams import border_facts, raster_borders, seam_sides, touches_seam

sizes = st.integers(1, 12)
grids = st.builds(lambda *sides: TileGrid(sides[:2], sides[2:]), sizes, sizes, sizes, sizes)


@given(grids)
def test_borders_of_the_raster_have_no_neighbour(grid):
    owner = np.full((grid.shape[0] + 2, grid.shape[1] + 2), -1)
    for tile in grid.tiles():
        owner[1:-1, 1:-1][tile.core.slices] = tile.number
    for tile in grid.tiles():
        (top, bottom), (left, right) = (np.flatnonzero((owner == tile.number).any(axis))[[0, -1]] for axis in (1, 0))
        beside = owner[top - 1, left], owner[bottom + 1, left], owner[top, left - 1], owner[top, right + 1]
        assert raster_borders(grid, tile.number) == tuple(number == -1 for number in beside)


@given(grids, st.integers(0, 1000))
def test_the_sides_of_a_seam_are_its_pixels(grid, seed):
    values = np.random.default_rng(seed).integers(0, 1000, grid.shape)
    facts = [border_facts("value", values[tile.core.slices]) for tile in grid.tiles()]
    found = list(seam_sides(grid, facts, "value"))
    assert [seam for seam, _, _ in found] == list(grid.seams())
    for seam, first, second in found:
        before, after = grid.tile(seam.first).core, grid.tile(seam.second).core
        if seam.vertical:
            assert (first == values[before.top : before.bottom, before.right - 1]).all()
            assert (second == values[after.top : after.bottom, before.right]).all()
        else:
            assert (first == values[before.bottom - 1, before.left : before.right]).all()
            assert (second == values[before.bottom, after.left : after.right]).all()


@given(st.tuples(sizes, sizes), st.tuples(*[st.booleans()] * 4), st.integers(0, 1000))
def test_labels_on_a_side_that_is_no_border_touch_a_seam(shape, borders, seed):
    labels = np.random.default_rng(seed).integers(0, 6, shape).astype(np.int32)
    sides = labels[0], labels[-1], labels[:, 0], labels[:, -1]
    expected = {int(label) for side, border in zip(sides, borders, strict=True) if not border for label in side} - {0}
    assert set(np.flatnonzero(touches_seam(labels, 5, borders)).tolist()) == expected
