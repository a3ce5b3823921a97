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

from tilepipe_kernels.compiled import loop, rule

SUBCELLS = 1 << 16
POINT = np.dtype([("row", "<u2"), ("column", "<u2"), ("y", "<u2"), ("x", "<u2"), ("value", "<i4")])
"""A point in a tile: its cell, counted from the tile's padded corner; its subcell; its value in ticks."""

MAXIMUM_SIDE = 1 << 16
"""Of a padded tile, in cells."""


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
    """
    raw = np.ascontiguousarray(raw, np.int32)
    result = np.empty(raw.size, np.int64)
    _subcells(raw, scale, offset, cell, result)
    return result


@loop
def _count_by_tile(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    origin: tuple[int, int],
    tiles: tuple[int, int],
    bits: int,
    margin: int,
    starts: NDArray[np.int64],
) -> None:
    for i in range(rows.size):
        row, column = (rows[i] >> 16) - origin[0], (columns[i] >> 16) - origin[1]
        for tile_row in range(max(0, (row - margin) >> bits), min(tiles[0], ((row + margin) >> bits) + 1)):
            for tile_column in range(max(0, (column - margin) >> bits), min(tiles[1], ((column + margin) >> bits) + 1)):
                starts[tile_row * tiles[1] + tile_column + 1] += 1


@loop
def _sort_by_tile(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    values: NDArray[np.int32],
    origin: tuple[int, int],
    tiles: tuple[int, int],
    bits: int,
    margin: int,
    cursors: NDArray[np.int64],
    result: NDArray[Any],
) -> None:
    for i in range(rows.size):
        row, column = (rows[i] >> 16) - origin[0], (columns[i] >> 16) - origin[1]
        for tile_row in range(max(0, (row - margin) >> bits), min(tiles[0], ((row + margin) >> bits) + 1)):
            for tile_column in range(max(0, (column - margin) >> bits), min(tiles[1], ((column + margin) >> bits) + 1)):
                tile = tile_row * tiles[1] + tile_column
                point = result[cursors[tile]]
                point.row = row - (tile_row << bits) + margin
                point.column = column - (tile_column << bits) + margin
                point.y = rows[i] & (SUBCELLS - 1)
                point.x = columns[i] & (SUBCELLS - 1)
                point.value = values[i]
                cursors[tile] += 1


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
        If the side is not a power of two, or a padded tile is wider than 65,536 cells.
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
