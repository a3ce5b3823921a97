"""Quadtree split of heights on their variance (`objects`, step 2).

A square is split in four while the variance of its heights exceeds a threshold.  Squares are dyadic and anchored to
the global grid, so blocks that start on a multiple of the largest square give the leaves that the whole raster
gives.  Heights are integer ticks: sums are exact, and so is every decision.

The squares of one largest square form a heap: node 0 is the largest square, the quarters of node i are
``4 * i + 1 .. 4 * i + 4`` (row-major), and the *cells* come last, in Z-order: squares of two pixels a side, or of one
if leaves can be single pixels.  The sums of one heap fit in the cache; no pyramid of the whole block is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.regions.quadtree_sums import (
    LARGEST_SIDE,
    MISSING,
    Sums,
    Ticks,
    clipped,
    extremes,
    sum_cells,
    sum_up,
)

REACH = 2**31
"""Largest product of a tick's magnitude and the side of the largest leaf: then sums of squares stay within 2**62."""

THRESHOLD_UNITS = 2**20
"""Units per squared tick in which the threshold is taken: a decision then compares integers."""

Labels = NDArray[np.int32]
Leaves = tuple[Labels, Labels, NDArray[np.uint8], NDArray[np.int32], Sums, Sums]
"""Row and column of the first valid pixel, level, count, total, squares of the leaves of one band."""
Table = tuple[Sums, NDArray[np.uint8], NDArray[np.int32], Sums, Sums]


@dataclass(frozen=True)
class LeafTable:
    """Leaves 1..n of one block, one element per leaf; sums of the parts of a leaf add up.

    Attributes
    ----------
    first
        int64: flat index in the block of the first valid pixel, row-major; increasing.
    level
        uint8: the side of the square is ``2**level`` pixels.
    count
        int32: number of valid pixels.
    total, squares
        int64: sum of the ticks and of the squared ticks.
    """

    first: NDArray[np.int64]
    level: NDArray[np.uint8]
    count: NDArray[np.int32]
    total: NDArray[np.int64]
    squares: NDArray[np.int64]


@rule
def exceeds(count: int, total: int, squares: int, whole: int, part: int) -> bool:
    """Whether the population variance exceeds ``whole + part / THRESHOLD_UNITS``, exactly and within 64 bits.

    With m the mean rounded down and r = total - m * count, the sum of squared deviations from m is
    S = squares - m * (total + r), and count * variance = S - r² / count, where 0 <= r < count.
    """
    mean = total // count
    rest = total - mean * count
    excess = squares - mean * (total + rest) - whole * count
    # What the rest and the part of the threshold can change lies between 0 and 2 * count.
    if excess <= 0 or excess >= 2 * count:
        return excess > 0
    return (excess * count - rest * rest) * THRESHOLD_UNITS > part * count * count


# ------------------------------------------------------------------------------------------------- sums


# ------------------------------------------------------------------------------------------------- leaves


@loop
def _first_valid(ticks: Ticks, top: int, left: int, side: int) -> tuple[int, int]:
    """Row and column of the first valid pixel of a square that has one."""
    bottom, right = min(top + side, ticks.shape[0]), min(left + side, ticks.shape[1])
    for i in range(top, bottom):
        for j in range(left, right):
            if ticks[i, j] != MISSING:
                return i, j
    return top, left


@loop
def _find_leaves(
    ticks: Ticks, top: int, left: int, levels: tuple[int, int], sums: Sums, whole: int, part: int, stack: Sums,
    leaves: Leaves, found: int,
) -> int:  # fmt: skip
    """Add the leaves of one largest square in Z-order and return how many the band has so far."""
    row, column, level, count, total, squares = leaves
    lowest, highest = levels
    depth = 1
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, top, left, highest
    while depth > 0:
        depth -= 1
        node, i, j, k = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
        if sums[0, node] == 0:
            continue
        if k > lowest and exceeds(sums[0, node], sums[1, node], sums[2, node], whole, part):
            half = 1 << (k - 1)
            for quarter in range(3, -1, -1):
                stack[depth, 0], stack[depth, 3] = 4 * node + 1 + quarter, k - 1
                stack[depth, 1], stack[depth, 2] = i + half * (quarter >> 1), j + half * (quarter & 1)
                depth += 1
            continue
        if ticks[i, j] == MISSING:
            i, j = _first_valid(ticks, i, j, 1 << k)
        row[found], column[found], level[found] = i, j, k
        count[found], total[found], squares[found] = sums[0, node], sums[1, node], sums[2, node]
        found += 1
    return found


@loop
def _paint(labels: Labels, ticks: Ticks, top: int, left: int, side: np.int64, count: int, number: int) -> None:
    """Write the leaf's number at its valid pixels."""
    bottom, right = min(top + side, labels.shape[0]), min(left + side, labels.shape[1])
    full = count == (bottom - top) * (right - left)
    for i in range(top, bottom):
        if full:
            for j in range(left, right):
                labels[i, j] = number
        else:
            for j in range(left, right):
                labels[i, j] = number if ticks[i, j] != MISSING else 0


@loop
def _number_leaves(
    ticks: Ticks, labels: Labels, top: int, leaves: Leaves, found: int, starts: Sums, table: Table, before: int
) -> None:
    """Number the leaves of the band at row `top` by first pixel, write their table and paint them.

    Of two squares that share a row the left one comes first in Z-order, so a stable counting sort by the row of the
    first pixel sorts by the pixel.
    """
    row, column, levels, counts, totals, squares = leaves
    starts[:] = 0
    for leaf in range(found):
        starts[row[leaf] - top + 1] += 1
    for i in range(1, starts.size):
        starts[i] += starts[i - 1]
    for leaf in range(found):
        index = before + starts[row[leaf] - top]
        starts[row[leaf] - top] += 1
        table[0][index] = np.int64(row[leaf]) * ticks.shape[1] + column[leaf]
        table[1][index], table[2][index] = levels[leaf], counts[leaf]
        table[3][index], table[4][index] = totals[leaf], squares[leaf]
        k = np.int64(levels[leaf])
        _paint(labels, ticks, row[leaf] >> k << k, column[leaf] >> k << k, np.int64(1) << k, counts[leaf], index + 1)


@loop
def _split(
    ticks: Ticks, levels: tuple[int, int], whole: int, part: int, cells: NDArray[np.int64], labels: Labels,
    leaves: Leaves, table: Table,
) -> int:  # fmt: skip
    """Split band by band, a band being a row of largest squares; return the number of leaves."""
    largest = 1 << levels[1]
    inner = cells[0, 0]
    sums = np.empty((3, inner + cells.size), np.int64)
    row = np.empty((3, cells.shape[0]), np.int64)
    padded = np.empty((largest, largest), np.int32)
    stack = np.empty((3 * levels[1] + 4, 4), np.int64)
    starts = np.empty(largest + 1, np.int64)
    number = 0
    for top in range(0, ticks.shape[0], largest):
        found = 0
        for left in range(0, ticks.shape[1], largest):
            if top + largest <= ticks.shape[0] and left + largest <= ticks.shape[1]:
                sum_cells(ticks[top : top + largest, left : left + largest], cells, row, sums)
            else:
                clipped(ticks, top, left, padded)
                sum_cells(padded, cells, row, sums)
            sum_up(sums, inner)
            found = _find_leaves(ticks, top, left, levels, sums, whole, part, stack, leaves, found)
        _number_leaves(ticks, labels, top, leaves, found, starts, table, number)
        number += found
    return number


def _heap_cells(across: int) -> NDArray[np.int64]:
    """Heap node of each cell, shape (across, across): the bits of row and column interleaved."""
    order = np.zeros((1, 1), np.int64)
    while len(order) < across:
        quarter = order.size
        order = np.block([[order, order + quarter], [order + 2 * quarter, order + 3 * quarter]])
    return order + (across * across - 1) // 3


def _empty_table(size: int) -> Table:
    """Room for the columns of a `LeafTable`."""
    totals = np.empty((2, size), np.int64)
    return np.empty(size, np.int64), np.empty(size, np.uint8), np.empty(size, np.int32), totals[0], totals[1]


def _magnitude(ticks: Ticks) -> int:
    """Largest magnitude of a block's ticks."""
    if on_device(ticks):
        return device_form(__name__).magnitude(ticks)
    lowest, highest = extremes(ticks)
    return max(-int(lowest), int(highest))


def _split_bands(ticks: Ticks, whole: int, part: int, smallest: int, largest: int) -> tuple[Labels, LeafTable]:
    """Labels and leaves of a block on the host."""
    rows, columns = (-(-length // smallest) for length in ticks.shape)
    band = min(rows, largest // smallest) * columns
    leaves = (np.empty(band, np.int32), np.empty(band, np.int32), *_empty_table(band)[1:])
    # Pages that no leaf needs are never touched, so the worst case costs address space only.
    table = _empty_table(rows * columns)
    labels = np.zeros(ticks.shape, np.int32)
    levels = (smallest.bit_length() - 1, largest.bit_length() - 1)
    cells = _heap_cells(largest // min(smallest, 2))
    number = _split(ticks, levels, whole, part, cells, labels, leaves, table)
    first, level, count, total, squares = table
    return labels, LeafTable(
        first[:number].copy(), level[:number].copy(), count[:number].copy(), total[:number].copy(),
        squares[:number].copy(),
    )  # fmt: skip


def halo() -> int:
    """Pixels around a block that its leaves depend on: none, where the block starts on a largest square."""
    return 0


def split(
    ticks: NDArray[np.int32], *, threshold: float, smallest: int, largest: int, origin: tuple[int, int] = (0, 0)
) -> tuple[NDArray[np.int32], LeafTable]:
    """Split a block of heights into the leaves of a quadtree on variance.

    From the largest squares down, a square is split in four when its side exceeds `smallest` and the population
    variance of its valid pixels exceeds `threshold` (METHODS, `objects` step 2; Galvanin et al. 2007).  Squares are
    clipped at the end of the block, which must be the raster's or lie between two largest squares.

    Parameters
    ----------
    ticks
        Heights, int32, shape (rows, columns); `MISSING` is nodata.  Magnitudes of at most ``2**31 // largest``
        (33 554 432 for 64 pixels), so that every sum of squares is exact in int64.
    threshold
        Variance in squared ticks, >= 0; rounded to a whole number of ``1 / THRESHOLD_UNITS``.
    smallest, largest
        Sides of the smallest and the largest leaf, pixels; powers of two up to `LARGEST_SIDE`.
    origin
        Global row and column of ``ticks[0, 0]``; multiples of `largest`.

    Returns
    -------
    labels : ndarray of int32
        Shape (rows, columns); leaves 1..n in row-major order of their first valid pixel, 0 = nodata.
    leaves : LeafTable
        One element per leaf.  Arrays of a device stay there.

    Raises
    ------
    ValueError
        For ticks that are not two-dimensional int32 or too large, sides that are no powers of two, an origin off
        the grid, a negative threshold.

    Examples
    --------
    A square of 4 × 4 pixels: a chimney in its first quarter, all else even.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.quadtree import split
    >>> heights = np.full((4, 4), 3000, np.int32)
    >>> heights[0, 0] = 9000
    >>> labels, leaves = split(heights, threshold=250_000, smallest=1, largest=4)
    >>> labels.tolist()
    [[1, 2, 3, 3], [4, 5, 3, 3], [6, 6, 7, 7], [6, 6, 7, 7]]
    >>> leaves.level.tolist()  # sides of 1 and 2 pixels
    [0, 0, 1, 0, 0, 1, 1]
    """
    if ticks.ndim != 2 or ticks.dtype != np.int32:
        raise ValueError(f"ticks must be a two-dimensional int32 array, not {ticks.dtype} of shape {ticks.shape}")
    if ticks.size >= 2**31 - 1:
        raise ValueError(f"{ticks.size} pixels are too many for one block; split smaller blocks")
    for side in (smallest, largest):
        if side < 1 or side & (side - 1) or side > LARGEST_SIDE:
            raise ValueError(f"sides of leaves must be powers of two from 1 to {LARGEST_SIDE} pixels, not {side}")
    if smallest > largest:
        raise ValueError(f"the smallest leaf ({smallest}) must not exceed the largest ({largest})")
    if origin[0] % largest or origin[1] % largest:
        raise ValueError(f"the block must start on a largest leaf: origin {origin} is no multiple of {largest}")
    if not threshold >= 0:
        raise ValueError(f"threshold must be a variance of 0 or more squared ticks, not {threshold}")
    ticks = namespace(ticks).ascontiguousarray(ticks)
    extreme, reach = _magnitude(ticks), REACH // largest
    if extreme > reach:
        raise ValueError(
            f"ticks reach {extreme}, but leaves of {largest} pixels allow {reach}: subtract a reference"
            " height, take larger ticks, or smaller leaves"
        )
    # No variance exceeds the square of the largest magnitude.
    whole, part = divmod(round(min(float(threshold), float(reach) ** 2) * THRESHOLD_UNITS), THRESHOLD_UNITS)
    if on_device(ticks):
        return device_form(__name__).split(ticks, whole, part, smallest, largest)
    return _split_bands(ticks, whole, part, smallest, largest)
