"""`quadtree` on the device: sums level by level from the pixels up, decisions from the largest squares down.

The squares of one level lie row by row behind those of the levels below, from the *cells*, which are as small as the
smallest leaf or of four pixels a side.  Each square knows its first valid pixel, and by it every pixel of a leaf finds
the leaf's number: the number of first pixels up to there.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.regions.quadtree import LeafTable, exceeds
from tilepipe_kernels.regions.quadtree_sums import MISSING, add_tick

_LONGEST_CELL = 4
_NOTHING = np.int64(0)
_NOWHERE = np.int32(2**31 - 1)
_SPLIT, _EMPTY = np.int32(-1), np.int32(-2)


class _Level(NamedTuple):
    """Squares of one size: where they begin among all squares, and how many rows and columns of them there are."""

    start: int
    rows: int
    columns: int


def magnitude(ticks: Any) -> int:
    """Largest magnitude of the ticks of a device array, nodata left out."""
    xp = namespace(ticks)
    if ticks.size == 0:
        return 0
    # the one scalar that is read before the work: what is too large must not be summed
    return int(xp.max(xp.abs(xp.where(ticks == MISSING, xp.int32(0), ticks))))


# ------------------------------------------------------------------------------------------------- sums


@grid
def _sum_cells(count: int, sums: Any, first: Any, ticks: Any, side: int, across: int) -> None:
    """Sums and first valid pixel of each cell."""
    rows, columns = ticks.shape
    for cell in range(cuda.grid(1), count, cuda.gridsize(1)):
        top, left = cell // across * side, cell % across * side
        number = total = squares = _NOTHING
        place = _NOWHERE
        for i in range(top, min(top + side, rows)):
            for j in range(left, min(left + side, columns)):
                if number == 0 and ticks[i, j] != MISSING:
                    place = np.int32(i * columns + j)
                number, total, squares = add_tick(ticks[i, j], number, total, squares)
        sums[0, cell], sums[1, cell], sums[2, cell] = number, total, squares
        first[cell] = place


@grid
def _sum_up(
    count: int, sums: Any, first: Any, start: int, across: int, below: int, rows_below: int, columns_below: int
) -> None:
    """Sums of the squares of a level, which starts at `start`, from those of their quarters, at `below`."""
    for square in range(cuda.grid(1), count, cuda.gridsize(1)):
        top, left = 2 * (square // across), 2 * (square % across)
        number = total = squares = _NOTHING
        place = _NOWHERE
        for i in range(top, min(top + 2, rows_below)):
            for j in range(left, min(left + 2, columns_below)):
                quarter = below + i * columns_below + j
                number += sums[0, quarter]
                total += sums[1, quarter]
                squares += sums[2, quarter]
                place = min(place, first[quarter])
        node = start + square
        sums[0, node], sums[1, node], sums[2, node] = number, total, squares
        first[node] = place


# ------------------------------------------------------------------------------------------------- leaves


@grid
def _descend(
    count: int, owner: Any, marks: Any, sums: Any, first: Any, start: int, across: int, above: int, across_above: int,
    divisible: bool, whole: int, part: int,
) -> None:  # fmt: skip
    """Find the leaves of a level below the one at `above`, which is negative for the largest squares.

    A square's owner is the first pixel of the leaf that it is or lies in; a leaf marks that pixel with 1 + its place
    among all squares.
    """
    for square in range(cuda.grid(1), count, cuda.gridsize(1)):
        node = start + square
        if above >= 0:
            parent = owner[above + square // across // 2 * across_above + square % across // 2]
            if parent != _SPLIT:
                owner[node] = parent
                continue
        if sums[0, node] == 0:
            owner[node] = _EMPTY
        elif divisible and exceeds(sums[0, node], sums[1, node], sums[2, node], whole, part):
            owner[node] = _SPLIT
        else:
            owner[node] = first[node]
            marks[first[node]] = node + 1


@grid
def _paint(
    count: int, labels: Any, ticks: Any, owner: Any, number: Any, columns: int, start: int, across: int, level: int
) -> None:
    """Write at each valid pixel the number of the leaf that owns its smallest square."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if ticks[p] != MISSING:
            square = (p // columns >> level) * across + (p % columns >> level)
            labels[p] = number[owner[start + square]]


def _pyramid(shape: tuple[int, int], lowest: int, highest: int) -> list[_Level]:
    """Where the squares of ``2**k`` pixels a side lie, for k = `lowest` … `highest`."""
    levels, start = [], 0
    for k in range(lowest, highest + 1):
        rows, columns = (-(-length >> k) for length in shape)
        levels.append(_Level(start, rows, columns))
        start += rows * columns
    return levels


def split(ticks: Any, whole: int, part: int, smallest: int, largest: int) -> tuple[Any, LeafTable]:
    """Labels and leaves of an int32 device array, as of `quadtree.split`."""
    xp = namespace(ticks)
    cell = min(smallest, _LONGEST_CELL)
    lowest, highest = cell.bit_length() - 1, largest.bit_length() - 1
    levels = _pyramid(ticks.shape, lowest, highest)
    size = levels[-1].start + levels[-1].rows * levels[-1].columns
    if size >= 2**31 - 1:
        raise ValueError(f"{ticks.size} pixels are too many for one block; split smaller blocks")
    sums, first = xp.empty((3, size), xp.int64), xp.empty(size, xp.int32)
    _sum_cells(levels[0].rows * levels[0].columns, sums, first, ticks, cell, levels[0].columns)
    for below, (start, rows, columns) in pairwise(levels):
        _sum_up(rows * columns, sums, first, start, columns, *below)
    owner, marks = xp.empty(size, xp.int32), xp.zeros(ticks.size, xp.int32)
    above, across_above = -1, 0
    leaf = smallest.bit_length() - 1
    for k in range(highest, leaf - 1, -1):
        start, rows, columns = levels[k - lowest]
        _descend(
            rows * columns, owner, marks, sums, first, start, columns, above, across_above, k > leaf, whole, part
        )  # fmt: skip
        above, across_above = start, columns
    labels = xp.zeros(ticks.shape, xp.int32)
    number = xp.cumsum(marks > 0, dtype=xp.int32)
    _paint(
        ticks.size, labels.reshape(-1), ticks.reshape(-1), owner, number, ticks.shape[1], above, across_above, leaf
    )  # fmt: skip
    # how many leaves there are is read here, for the size of their table
    pixel = xp.flatnonzero(marks)
    node = marks[pixel] - xp.int32(1)
    level = xp.full(node.shape, lowest, xp.uint8)
    for higher in levels[1:]:
        level += node >= higher.start
    table = LeafTable(pixel.astype(xp.int64), level, sums[0, node].astype(xp.int32), sums[1, node], sums[2, node])
    return labels, table
