"""Positions of points as integers, and points dealt out to tiles with their margins.

A cell is parted into 65,536 subcells a side, and a point stands at the middle of its subcell; at a cell of
half a metre that is 8 micrometres.  What follows from positions is therefore exact and knows no rounding by
tile.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

SUBCELL_BITS = 16
SUBCELLS = 1 << SUBCELL_BITS
POINT = np.dtype([("row", "<u2"), ("column", "<u2"), ("y", "<u2"), ("x", "<u2"), ("value", "<i4")])
"""A point in a tile: its cell, counted from the tile's padded corner; its subcell; its value in ticks."""

MAXIMUM_SIDE = 1 << 15
"""Of a padded tile, in cells: two coordinates in subcells fit in 64 bits."""


@rule
def subcell_of(raw: int, scale: float, offset: float, cell: float) -> int:
    """Global subcell of a LAS coordinate; a negative ``cell`` counts against the axis (rows go south)."""
    return math.floor((raw * scale + offset) / cell * SUBCELLS)


@loop
def _subcells(raw: NDArray[np.int32], scale: float, offset: float, cell: float, result: NDArray[np.int64]) -> None:
    for i in range(raw.size):
        result[i] = subcell_of(raw[i], scale, offset, cell)


def subcells(raw: NDArray[Any], scale: float, offset: float, cell: float) -> NDArray[np.int64]:
    """Global subcell indices ``floor((raw * scale + offset) / cell * 65536)``.

    Parameters
    ----------
    raw
        LAS integer coordinates, shape (points,).
    scale, offset
        From the LAS header: coordinate = raw * scale + offset, in CRS units.
    cell
        Cell side in CRS units; negative for rows, which count southwards from the CRS origin.

    Returns
    -------
    ndarray of int64, shape (points,)
        The cell is this shifted right by 16 bits; a point on the edge of two cells lies in the eastern or
        southern one.

    Examples
    --------
    LAS coordinates in centimetres, cells of half a metre: the points lie in cells 0, 1 and 2.

    >>> import numpy as np
    >>> from tilepipe_kernels.points.point_tiles import subcells
    >>> (subcells(np.array([20, 50, 149]), scale=0.01, offset=0.0, cell=0.5) >> 16).tolist()
    [0, 1, 2]
    """
    raw = np.ascontiguousarray(raw, np.int32)
    result = np.empty(raw.size, np.int64)
    _subcells(raw, scale, offset, cell, result)
    return result


@rule
def _tiles_of(cell: int, margin: int, bits: int, tiles: int) -> tuple[int, int]:
    """First and last tile, along one axis, whose padded window holds a cell; none if the last is less."""
    return max(0, (cell - margin) >> bits), min(tiles - 1, (cell + margin) >> bits)


@loop
def _count_by_tile(
    rows: NDArray[np.int64], columns: NDArray[np.int64], origin: tuple[int, int], tiles: tuple[int, int],
    bits: int, margin: int, starts: NDArray[np.int64],
) -> None:  # fmt: skip
    for i in range(rows.size):
        top, bottom = _tiles_of((rows[i] >> 16) - origin[0], margin, bits, tiles[0])
        left, right = _tiles_of((columns[i] >> 16) - origin[1], margin, bits, tiles[1])
        if top == bottom and left == right:
            starts[top * tiles[1] + left + 1] += 1
            continue
        for tile_row in range(top, bottom + 1):
            for tile_column in range(left, right + 1):
                starts[tile_row * tiles[1] + tile_column + 1] += 1


@loop
def _next(cursors: NDArray[np.int64], tile: int) -> int:
    at: int = cursors[tile]
    cursors[tile] = at + 1
    return at


@loop
def _put(point: Any, row: int, column: int, y: np.uint16, x: np.uint16, value: np.int32) -> None:
    point.row, point.column, point.y, point.x, point.value = row, column, y, x, value


@loop
def _sort_by_tile(
    rows: NDArray[np.int64], columns: NDArray[np.int64], values: NDArray[np.int32], origin: tuple[int, int],
    tiles: tuple[int, int], bits: int, margin: int, cursors: NDArray[np.int64], result: NDArray[Any],
) -> None:  # fmt: skip
    for i in range(rows.size):
        row, column = (rows[i] >> 16) - origin[0], (columns[i] >> 16) - origin[1]
        top, bottom = _tiles_of(row, margin, bits, tiles[0])
        left, right = _tiles_of(column, margin, bits, tiles[1])
        y, x = np.uint16(rows[i] & (SUBCELLS - 1)), np.uint16(columns[i] & (SUBCELLS - 1))
        # nearly every point lies in one tile, and empty loops around it would double its cost
        if top == bottom and left == right:
            at = _next(cursors, top * tiles[1] + left)
            _put(result[at], row - (top << bits) + margin, column - (left << bits) + margin, y, x, values[i])
            continue
        for tile_row in range(top, bottom + 1):
            for tile_column in range(left, right + 1):
                at = _next(cursors, tile_row * tiles[1] + tile_column)
                own_row, own_column = row - (tile_row << bits) + margin, column - (tile_column << bits) + margin
                _put(result[at], own_row, own_column, y, x, values[i])


def sort_by_tile(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    values: NDArray[np.int32],
    *,
    origin: tuple[int, int],
    tiles: tuple[int, int],
    side: int,
    margin: int,
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Deal points out to square tiles; a point within ``margin`` of other tiles goes to these as well.

    Parameters
    ----------
    rows, columns
        Global subcell indices of the points (`subcells`), shape (points,).
    values
        Values in ticks, int32, shape (points,).
    origin
        Global row and column of the first tile's first cell.
    tiles
        Number of tiles down and across; points that reach none of them are dropped.
    side, margin
        Side of a tile, a power of two, and width of the margin around it, in cells.

    Returns
    -------
    points
        Records of dtype `POINT`, tile by tile in row-major order.
    starts
        int64, shape (tiles + 1,): tile ``t`` has ``points[starts[t]:starts[t + 1]]``.

    Raises
    ------
    ValueError
        If the side is not a power of two, or a padded tile is wider than 32,768 cells.

    Examples
    --------
    Two tiles of 8 × 8 cells; the point in column 9 lies in the second, within two cells of the first.

    >>> import numpy as np
    >>> from tilepipe_kernels.points.point_tiles import SUBCELLS, sort_by_tile
    >>> rows, columns = np.array([0, 0]) * SUBCELLS, np.array([3, 9]) * SUBCELLS
    >>> values = np.array([50, 70], np.int32)
    >>> points, starts = sort_by_tile(rows, columns, values, origin=(0, 0), tiles=(1, 2), side=8, margin=2)
    >>> starts.tolist(), points["value"].tolist()
    ([0, 2, 3], [50, 70, 70])
    """
    if side < 1 or side & (side - 1):
        raise ValueError(f"the side of a tile must be a power of two, not {side}")
    if side + 2 * margin > MAXIMUM_SIDE:
        raise ValueError(f"a tile of {side} cells with a margin of {margin} is too wide; shorten the reach")
    starts = np.zeros(tiles[0] * tiles[1] + 1, np.int64)
    bits = side.bit_length() - 1
    _count_by_tile(rows, columns, origin, tiles, bits, margin, starts)
    np.cumsum(starts, out=starts)
    points = np.empty(int(starts[-1]), POINT)
    _sort_by_tile(rows, columns, values, origin, tiles, bits, margin, starts[:-1].copy(), points)
    return points, starts
