"""The point nearest to each cell's centre, exactly, for `gridding`.

Points are sorted by cell, so that those of neighbouring cells of one row lie in one run.  A run is walked
without asking for its cells, since a place is global in the tile; cells matter only where distances tie.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.points.placed_points import Places, squared_distance, squared_gap
from tilepipe_kernels.points.point_tiles import SUBCELLS

Best = tuple[int, int]
"""Squared distance in half subcells, and the point's index; -1 before one is found."""

_NO_LIMIT = 1 << 62


@rule
def _content(place: int) -> int:
    """A place as cell in row-major order, then position in the cell: what settles ties."""
    row, y, column, x = place >> 48, (place >> 32) & 0xFFFF, (place >> 16) & 0xFFFF, place & 0xFFFF
    return (row << 48) | (column << 32) | (y << 16) | x


@loop
def _nearer(
    places: Places, values: NDArray[np.int32], start: int, stop: int, y: int, x: int, best: int, found: int
) -> Best:
    """The best so far or a nearer point of a run; of equally near ones the first by content, then by value."""
    for i in range(start, stop):
        distance = squared_distance(places[i], y, x)
        if distance > best:
            continue
        if distance == best and found >= 0:
            own, other = _content(places[i]), _content(places[found])
            if own > other or (own == other and values[i] >= values[found]):
                continue
        best, found = distance, i
    return best, found


@loop
def _nearest_around(
    places: Places, values: NDArray[np.int32], starts: NDArray[np.int32], columns: int, row: int, column: int,
    best: int, found: int,
) -> Best:  # fmt: skip
    """Best of the nine cells around and including one that is not on the border."""
    y, x = (2 * row + 1) * SUBCELLS, (2 * column + 1) * SUBCELLS
    for r in range(row - 1, row + 2):
        cell = r * columns + column
        best, found = _nearer(places, values, starts[cell - 1], starts[cell + 2], y, x, best, found)
    return best, found


@loop
def _nearest_beyond(
    places: Places, values: NDArray[np.int32], starts: NDArray[np.int32], left: NDArray[np.int32],
    right: NDArray[np.int32], row: int, column: int, best: int, found: int,
) -> Best:  # fmt: skip
    """Rows are searched outwards, and in each row the filled cells, while they can hold a point as near."""
    rows, columns = left.shape
    y, x = (2 * row + 1) * SUBCELLS, (2 * column + 1) * SUBCELLS
    step = 0
    while step <= rows and squared_gap(step) <= best:
        for r in range(row - step, row + step + 1, max(1, 2 * step)):
            if r < 0 or r >= rows:
                continue
            c = left[r, column]
            while c >= 0 and squared_gap(r - row) + squared_gap(c - column) <= best:
                cell = r * columns + c
                best, found = _nearer(places, values, starts[cell], starts[cell + 1], y, x, best, found)
                c = left[r, c - 1] if c > 0 else -1
            c = right[r, column + 1] if column + 1 < columns else columns
            while c < columns and squared_gap(r - row) + squared_gap(c - column) <= best:
                cell = r * columns + c
                best, found = _nearer(places, values, starts[cell], starts[cell + 1], y, x, best, found)
                c = right[r, c + 1] if c + 1 < columns else columns
        step += 1
    return best, found


@loop
def grid_nearest(
    places: Places, values: NDArray[np.int32], starts: NDArray[np.int32], left: NDArray[np.int32],
    right: NDArray[np.int32], margin: int, limit: int, result: NDArray[np.float64],
) -> None:  # fmt: skip
    """Value of the nearest point; for a cell without points at most ``limit`` (squared half subcells) away."""
    columns = result.shape[1] + 2 * margin
    for row in range(margin, margin + result.shape[0]):
        for column in range(margin, margin + result.shape[1]):
            cell = row * columns + column
            start, stop = starts[cell], starts[cell + 1]
            if start < stop:
                y, x = (2 * row + 1) * SUBCELLS, (2 * column + 1) * SUBCELLS
                best, found = _nearer(places, values, start, stop, y, x, _NO_LIMIT, -1)
                if best >= squared_gap(1):
                    best, found = _nearest_around(places, values, starts, columns, row, column, best, found)
            else:
                best, found = _nearest_around(places, values, starts, columns, row, column, limit, -1)
                if best >= squared_gap(2):
                    best, found = _nearest_beyond(places, values, starts, left, right, row, column, best, found)
            if found >= 0:
                result[row - margin, column - margin] = values[found]


@loop
def find_filled(starts: NDArray[np.int32], left: NDArray[np.int32], right: NDArray[np.int32]) -> None:
    """Column of the nearest cell with points at or left of a cell (else -1), at or right of it (else width)."""
    rows, columns = left.shape
    for row in range(rows):
        first = row * columns
        last = -1
        for column in range(columns):
            if starts[first + column] < starts[first + column + 1]:
                last = column
            left[row, column] = last
        last = columns
        for column in range(columns - 1, -1, -1):
            if starts[first + column] < starts[first + column + 1]:
                last = column
            right[row, column] = last
