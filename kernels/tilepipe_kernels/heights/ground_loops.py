"""Rules and loops of `ground`: minima of windows, coarse cells, interpolation between what is present.

Heights are float32, `MISSING` where there is none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

MISSING = np.float32(np.inf)
"""Stands for a height that is not known."""

BAND = np.float32(0.3)
"""Metres above and below the lowest height of a cell that are ground on level terrain."""

FEW = 4
"""A cell of fewer heights is as low as its lowest, not its second lowest one."""

_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)

Floats = NDArray[np.float32]


# ------------------------------------------------------------------------------------------ minima of windows


@loop
def lowest_along_rows(out: Floats, values: Floats, half_width: int) -> None:
    """Minimum of 2 half_width + 1 neighbours in a row, by minima over spans that double."""
    rows, columns = values.shape
    size = 2 * half_width + 1
    line, other = np.full(columns + 2 * half_width, MISSING), np.full(columns + 2 * half_width, MISSING)
    for i in range(rows):
        line[:half_width] = MISSING
        line[half_width : half_width + columns] = values[i]
        line[half_width + columns :] = MISSING
        span = 1
        while 2 * span <= size:
            near, far, into = line, line[span:], other
            for j in range(far.size):
                into[j] = min(near[j], far[j])
            line, other = other, line
            span *= 2
        near, far, into = line, line[size - span :], out[i]
        for j in range(columns):
            into[j] = min(near[j], far[j])


@loop
def _lower(into: Floats, one: Floats, other: Floats) -> None:
    for j in range(into.size):
        into[j] = min(one[j], other[j])


@loop
def lowest_along_columns(out: Floats, values: Floats, half_width: int) -> None:
    """Minimum of 2 half_width + 1 neighbours in a column: van Herk 1992, Gil & Werman 1993, on whole rows."""
    rows, columns = values.shape
    size = 2 * half_width + 1
    # Row i of `after` holds the minimum from row i to the end of its group of `size` rows.
    after = np.empty((size, columns), np.float32)
    before = np.empty(columns, np.float32)
    nothing = np.full(columns, MISSING)
    for top in range(-half_width, rows, size):
        for k in range(size - 1, -1, -1):
            row = top + k
            here = values[row] if 0 <= row < rows else nothing
            _lower(after[k], here, after[k + 1] if k + 1 < size else nothing)
        before[:] = MISSING
        for k in range(size):
            centre = top + k + half_width
            if 0 <= centre < rows:
                _lower(out[centre], after[k], before)
            following = top + size + k
            _lower(before, before, values[following] if following < rows else nothing)


def window_lowest(values: Floats, half_width: int) -> Floats:
    """See `ground.window_lowest`; the cost does not grow with the square."""
    along, out = np.empty_like(values), np.empty_like(values)
    lowest_along_rows(along, values, half_width)
    lowest_along_columns(out, along, half_width)
    return out


# ------------------------------------------------------------------------------------------ coarse cells


@rule
def two_lowest(
    first: np.float32, second: np.float32, count: int, height: np.float32
) -> tuple[np.float32, np.float32, int]:
    """Lowest and second lowest of `count` heights, and of one more if it is finite."""
    if abs(height) < MISSING:
        return min(first, height), min(second, max(first, height)), count + 1
    return first, second, count


@loop
def lowest_of_cells(low: Floats, dsm: Floats, side: int, row_shift: int, column_shift: int) -> None:
    """Second lowest height of each cell, so that a stray low pixel does not count; the lowest of a few."""
    rows, columns = dsm.shape
    for i in range(low.shape[0]):
        top, bottom = max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)
        for j in range(low.shape[1]):
            left, right = max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)
            first, second, count = MISSING, MISSING, 0
            for y in range(top, bottom):
                for x in range(left, right):
                    first, second, count = two_lowest(first, second, count, dsm[y, x])
            low[i, j] = second if count >= FEW else first


@rule
def _drop(one: np.float32, other: np.float32) -> np.float32:
    """How far the terrain falls across a cell, from its neighbours on both sides; 0 where one is missing."""
    return abs(one - other) * _HALF if max(one, other) < MISSING else _ZERO


@rule
def ground_band(
    north: np.float32, south: np.float32, west: np.float32, east: np.float32, most: np.float32
) -> np.float32:
    """Height of ground above the lowest of a cell: a band, and the fall across the cell up to `most`."""
    return BAND + min(_drop(north, south) + _drop(west, east), most)


@rule
def add_ground(
    total: np.float32, number: np.float32, above: np.float32, band: np.float32
) -> tuple[np.float32, np.float32]:
    """Add a height above the lowest of its cell to sums, if it is ground."""
    if -BAND <= above <= band:
        return total + above, number + _ONE
    return total, number


@loop
def mean_of_cells(
    mean: Floats, low: Floats, surface: Floats, dsm: Floats, most: np.float32, side: int, row_shift: int,
    column_shift: int,
) -> None:  # fmt: skip
    """Mean of the heights of each ground cell that lie no further above its lowest than the terrain falls across it."""
    rows, columns = dsm.shape
    last_row, last_column = low.shape[0] - 1, low.shape[1] - 1
    for i in range(low.shape[0]):
        top, bottom = max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)
        north, south = surface[max(0, i - 1)], surface[min(last_row, i + 1)]
        for j in range(low.shape[1]):
            if mean[i, j] == MISSING:
                continue
            left, right = max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)
            west, east = surface[i, max(0, j - 1)], surface[i, min(last_column, j + 1)]
            lowest, band = low[i, j], ground_band(north[j], south[j], west, east, most)
            total, number = _ZERO, _ZERO
            for y in range(top, bottom):
                for x in range(left, right):
                    total, number = add_ground(total, number, dsm[y, x] - lowest, band)
            mean[i, j] = lowest + total / number


# ------------------------------------------------------------------------------------------ interpolation


@rule
def mean_of_present(a: np.float32, b: np.float32, c: np.float32, d: np.float32) -> np.float32:
    """Mean of those of four heights that are present."""
    total, number = _ZERO, _ZERO
    for value in (a, b, c, d):
        if value < MISSING:
            total += value
            number += _ONE
    return total / number if number > _ZERO else MISSING


@loop
def pull(coarse: Floats, fine: Floats) -> None:
    """Mean of those of each square of four cells that are present."""
    for i in range(coarse.shape[0]):
        upper, lower = fine[2 * i], fine[2 * i + 1]
        for j in range(coarse.shape[1]):
            coarse[i, j] = mean_of_present(upper[2 * j], upper[2 * j + 1], lower[2 * j], lower[2 * j + 1])


@rule
def corner(index: int, side: int) -> int:
    """The first of the two cells between whose centres position `index` lies, in cells of `side`."""
    return (2 * index + 1 - side) // (2 * side)


@rule
def share(index: int, side: int, first: int) -> np.float32:
    """How far position `index` lies on the way from the centre of cell `first` to the next, 0 to 1."""
    return np.float32(2 * index + 1 - side - 2 * side * first) / np.float32(2 * side)


@rule
def between_rows(above: np.float32, below: np.float32, down: np.float32) -> tuple[np.float32, np.float32]:
    """Weighted sum of two heights of a column of cells, the share `down` apart from the upper one, and its weight."""
    a = _ONE - down if above < MISSING else _ZERO
    b = down if below < MISSING else _ZERO
    return (a * above if a > _ZERO else _ZERO) + (b * below if b > _ZERO else _ZERO), a + b


@rule
def between_columns(
    left: np.float32, left_weight: np.float32, right: np.float32, right_weight: np.float32, across: np.float32,
    otherwise: np.float32,
) -> np.float32:  # fmt: skip
    """Height between two columns of cells, the share `across` apart from the left one; `otherwise` without any."""
    a, b = _ONE - across, across
    total = a * left_weight + b * right_weight
    return (a * left + b * right) / total if total > _ZERO else otherwise


@loop
def spread(
    fine: Floats, wanted: NDArray[np.bool_], coarse: Floats, side: int, row_shift: int, column_shift: int
) -> None:
    """Fill `fine` where wanted by bilinear interpolation between those cells of `coarse` that are present."""
    rows, columns = coarse.shape
    value, weight = np.empty(columns, np.float32), np.empty(columns, np.float32)
    left, right = np.empty(fine.shape[1], np.int64), np.empty(fine.shape[1], np.int64)
    across = np.empty(fine.shape[1], np.float32)
    for j in range(fine.shape[1]):
        x = corner(j + column_shift, side)
        left[j], right[j], across[j] = max(x, 0), min(x + 1, columns - 1), share(j + column_shift, side, x)
    for i in range(fine.shape[0]):
        y = corner(i + row_shift, side)
        down = share(i + row_shift, side, y)
        above, below = coarse[max(y, 0)], coarse[min(y + 1, rows - 1)]
        for k in range(columns):
            value[k], weight[k] = between_rows(above[k], below[k], down)
        row, here = fine[i], wanted[i]
        for j in range(row.size):
            if here[j]:
                a, b = left[j], right[j]
                row[j] = between_columns(value[a], weight[a], value[b], weight[b], across[j], row[j])
