"""Sums of heights over the cells of a quadtree, level by level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

Ticks = NDArray[np.int32]
Sums = NDArray[np.int64]

MISSING = np.int32(-(2**31))
"""The tick that stands for nodata."""

LARGEST_SIDE = 1024
"""Longest side of a leaf, pixels, for which the decision fits in 64 bits."""


@loop
def extremes(ticks: Ticks) -> tuple[np.int32, np.int32]:
    """Lowest and highest tick, not below or above 0; nodata counts as 0."""
    lowest, highest = np.int32(0), np.int32(0)
    for i in range(ticks.shape[0]):
        row = ticks[i]
        for j in range(row.size):
            tick = row[j] if row[j] != MISSING else np.int32(0)
            lowest, highest = min(lowest, tick), max(highest, tick)
    return lowest, highest


@rule
def add_tick(
    tick: np.int32, count: np.int64, total: np.int64, squares: np.int64
) -> tuple[np.int64, np.int64, np.int64]:
    """Add a tick to sums, unless it is nodata."""
    valid = tick != MISSING
    value = np.int64(tick if valid else np.int32(0))
    return count + np.int64(valid), total + value, squares + value * value


@loop
def _sum_pixels(row: Ticks, into: Sums) -> None:
    """Sums of single pixels."""
    nothing = np.int64(0)
    for c in range(row.size):
        into[0, c], into[1, c], into[2, c] = add_tick(row[c], nothing, nothing, nothing)


@loop
def _sum_quads(upper: Ticks, lower: Ticks, into: Sums) -> None:
    """Sums of squares of 2 x 2 pixels."""
    for c in range(upper.size // 2):
        count = total = squares = np.int64(0)
        count, total, squares = add_tick(upper[2 * c], count, total, squares)
        count, total, squares = add_tick(upper[2 * c + 1], count, total, squares)
        count, total, squares = add_tick(lower[2 * c], count, total, squares)
        count, total, squares = add_tick(lower[2 * c + 1], count, total, squares)
        into[0, c], into[1, c], into[2, c] = count, total, squares


@loop
def sum_cells(window: Ticks, cells: NDArray[np.int64], row: Sums, sums: Sums) -> None:
    """Sum the cells of one largest square, whose pixels are `window`; `row` is room for a row of cells."""
    across = cells.shape[0]
    for r in range(across):
        if across == window.shape[0]:
            _sum_pixels(window[r], row)
        else:
            _sum_quads(window[2 * r], window[2 * r + 1], row)
        for c in range(across):
            node = cells[r, c]
            sums[0, node], sums[1, node], sums[2, node] = row[0, c], row[1, c], row[2, c]


@loop
def clipped(ticks: Ticks, top: int, left: int, padded: Ticks) -> None:
    """Copy what the block has of a largest square, nodata elsewhere."""
    padded[:] = MISSING
    for i in range(top, min(top + padded.shape[0], ticks.shape[0])):
        for j in range(left, min(left + padded.shape[1], ticks.shape[1])):
            padded[i - top, j - left] = ticks[i, j]


@loop
def sum_up(sums: Sums, inner: int) -> None:
    """Sum the quarters of the inner nodes of the heap, from the cells to the largest square."""
    for kind in range(3):
        row = sums[kind]
        for node in range(inner - 1, -1, -1):
            quarter = 4 * node + 1
            row[node] = row[quarter] + row[quarter + 1] + row[quarter + 2] + row[quarter + 3]
