"""Points of one tile sorted by cell, with exact places and distances, for `gridding`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.points.point_tiles import SUBCELLS

Places = NDArray[np.int64]
"""A point's row of subcells in the upper half, its column of subcells in the lower."""

_HALF_WORD, _QUARTER_WORD = 0xFFFFFFFF, 0xFFFF
_HALF = SUBCELLS >> 1
_VALUE_SHIFT = 1 << 31


@rule
def squared_distance(place: int, y: int, x: int) -> int:
    """From a cell's centre to a point, in half subcells; both offsets are odd, so never zero."""
    down, across = 2 * (place >> 32) + 1 - y, 2 * (place & _HALF_WORD) + 1 - x
    return down * down + across * across


@rule
def squared_gap(step: int) -> int:
    """Square of the least offset along an axis from a cell's centre into one ``step`` away, half subcells."""
    gap = max(0, 2 * abs(step) - 1) * SUBCELLS
    return gap * gap


@loop
def sort_by_cell(
    points: NDArray[Any], columns: int, starts: NDArray[np.int32], places: Places, values: NDArray[np.int32]
) -> None:
    """Counting sort; ``starts`` holds two more entries than cells and comes zeroed."""
    for i in range(points.size):
        point = points[i]
        starts[np.int64(point.row) * columns + point.column + 2] += 1
    for cell in range(1, starts.size):
        starts[cell] += starts[cell - 1]
    for i in range(points.size):
        point = points[i]
        row, column = np.int64(point.row), np.int64(point.column)
        after = row * columns + column + 1
        y, x = (row << 16) | np.int64(point.y), (column << 16) | np.int64(point.x)
        places[starts[after]] = (y << 32) | x
        values[starts[after]] = point.value
        starts[after] += 1


@loop
def sort_within_cells(starts: NDArray[np.int32], places: Places, values: NDArray[np.int32]) -> None:
    """Order the points of each cell by place, then value, so that sums run in an order that content decides."""
    for cell in range(starts.size - 2):
        start, stop = starts[cell], starts[cell + 1]
        if stop - start < 2:
            continue
        # what tells the points of one cell apart fits in a word: subcell row, subcell column, value
        keys = np.empty(stop - start, np.int64)
        for i in range(start, stop):
            subrow, subcolumn = (places[i] >> 32) & _QUARTER_WORD, places[i] & _QUARTER_WORD
            keys[i - start] = (((subrow - _HALF) << 16) | subcolumn) << 32 | (np.int64(values[i]) + _VALUE_SHIFT)
        keys.sort()
        row, column = places[start] >> 48 << 48, places[start] & (_QUARTER_WORD << 16)
        for i in range(start, stop):
            key = keys[i - start]
            places[i] = row | (((key >> 48) + _HALF) << 32) | column | ((key >> 32) & _QUARTER_WORD)
            values[i] = (key & _HALF_WORD) - _VALUE_SHIFT
