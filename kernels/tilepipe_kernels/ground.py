"""Bare earth under a surface of heights: what remains when everything narrower than a largest object is taken off.

The surface is reduced to the lowest heights of coarse cells, which are opened by squares of growing size
(Zhang et al. 2003, "A progressive morphological filter for removing nonground measurements from airborne lidar
data", IEEE TGRS 41(4), eqs 2-6).  A cell whose height drops by more than terrain can at one size is an object;
its ground is interpolated from the cells around by pull-push (Gortler et al. 1996, "The lumigraph", section 3.4),
at the top of which the opened surface stands in.  Cells are anchored to the global grid and every step has a
bounded reach, so the ground does not depend on the tiling.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule

CELL = 2.0
"""Side of a coarse cell in metres, rounded to whole pixels: less than the width of an alley between houses."""

_LEVELS = 3
_PIT_HALF_WIDTH = 2
_BAND = np.float32(0.3)
_LEAST_STEP = 0.1
_STEP_GROWTH = 0.05
_MISSING = np.float32(np.inf)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)

Floats = NDArray[np.float32]


def cell_side(resolution: float) -> int:
    """Side of a coarse cell in pixels of `resolution` metres."""
    if not (math.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres per pixel, not {resolution}")
    return max(1, round(CELL / resolution))


def half_widths(resolution: float, largest_object: float) -> list[int]:
    """Half widths in cells of the squares that open the surface: by ones first, then by an eighth more each."""
    if not (math.isfinite(largest_object) and largest_object > 0):
        raise ValueError(f"largest_object must be a positive number of metres, not {largest_object}")
    last = math.ceil(largest_object / (2 * cell_side(resolution) * resolution))
    widths = [1]
    while widths[-1] < last:
        widths.append(min(last, widths[-1] + max(1, widths[-1] // 8)))
    return widths


def halo(resolution: float, largest_object: float = 80.0) -> int:
    """Pixels around a block that `ground_height` can depend on.

    In cells: an opening reaches two half widths and a closing of the pits likewise; pull-push reaches less than
    three squares of its coarsest level; one more each for the fall across a cell, the interpolation to pixels and
    a cell cut by the end of the block.
    """
    cells = 2 * half_widths(resolution, largest_object)[-1] + 2 * _PIT_HALF_WIDTH + 3 * 2**_LEVELS + 3
    return int(cells * cell_side(resolution))


# ------------------------------------------------------------------------------------------ minima of windows


@loop
def _lowest_along_rows(out: Floats, values: Floats, half_width: int) -> None:
    """Minimum of 2 half_width + 1 neighbours in a row, by minima over spans that double."""
    rows, columns = values.shape
    size = 2 * half_width + 1
    line, other = np.full(columns + 2 * half_width, _MISSING), np.full(columns + 2 * half_width, _MISSING)
    for i in range(rows):
        line[:half_width] = _MISSING
        line[half_width : half_width + columns] = values[i]
        line[half_width + columns :] = _MISSING
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
def _lowest_along_columns(out: Floats, values: Floats, half_width: int) -> None:
    """Minimum of 2 half_width + 1 neighbours in a column: van Herk 1992, Gil & Werman 1993, on whole rows."""
    rows, columns = values.shape
    size = 2 * half_width + 1
    # Row i of `after` holds the minimum from row i to the end of its group of `size` rows.
    after = np.empty((size, columns), np.float32)
    before = np.empty(columns, np.float32)
    nothing = np.full(columns, _MISSING)
    for top in range(-half_width, rows, size):
        for k in range(size - 1, -1, -1):
            row = top + k
            here = values[row] if 0 <= row < rows else nothing
            _lower(after[k], here, after[k + 1] if k + 1 < size else nothing)
        before[:] = _MISSING
        for k in range(size):
            centre = top + k + half_width
            if 0 <= centre < rows:
                _lower(out[centre], after[k], before)
            following = top + size + k
            _lower(before, before, values[following] if following < rows else nothing)


def window_lowest(values: Floats, half_width: int) -> Floats:
    """Minimum over the square of 2 half_width + 1 pixels; what lies beyond the block, and infinity, counts for nothing.

    `values` is a float32 block without NaN, shape (rows, columns); the cost does not grow with the square.
    """
    along, out = np.empty_like(values), np.empty_like(values)
    _lowest_along_rows(along, values, half_width)
    _lowest_along_columns(out, along, half_width)
    return out


def window_highest(values: Floats, half_width: int) -> Floats:
    """Maximum over the square of 2 half_width + 1 pixels; see :func:`window_lowest`."""
    return -window_lowest(-values, half_width)


# ------------------------------------------------------------------------------------------ coarse cells


@loop
def _lowest_of_cells(low: Floats, dsm: Floats, side: int, row_shift: int, column_shift: int) -> None:
    """Second lowest height of each cell, so that a stray low pixel does not count; the lowest of less than four."""
    rows, columns = dsm.shape
    for i in range(low.shape[0]):
        top, bottom = max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)
        for j in range(low.shape[1]):
            left, right = max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)
            first, second, count = _MISSING, _MISSING, 0
            for y in range(top, bottom):
                for x in range(left, right):
                    height = dsm[y, x]
                    if abs(height) < _MISSING:
                        count += 1
                        second = min(second, max(first, height))
                        first = min(first, height)
            low[i, j] = second if count >= 4 else first


@rule
def _drop(one: np.float32, other: np.float32) -> np.float32:
    """How far the terrain falls across a cell, from its neighbours on both sides; 0 where one is missing."""
    return abs(one - other) * _HALF if max(one, other) < _MISSING else _ZERO


@loop
def _mean_of_cells(
    mean: Floats, low: Floats, surface: Floats, dsm: Floats, most: np.float32, side: int, row_shift: int,
    column_shift: int,
) -> None:  # fmt: skip
    """Mean of the heights of each ground cell that lie no further above its lowest than the terrain falls across it."""
    rows, columns = dsm.shape
    last_row, last_column = low.shape[0] - 1, low.shape[1] - 1
    for i in range(low.shape[0]):
        top, bottom = max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)
        for j in range(low.shape[1]):
            if mean[i, j] == _MISSING:
                continue
            left, right = max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)
            drop = _drop(surface[max(0, i - 1), j], surface[min(last_row, i + 1), j])
            drop += _drop(surface[i, max(0, j - 1)], surface[i, min(last_column, j + 1)])
            lowest, band = low[i, j], _BAND + min(drop, most)
            total, number = _ZERO, _ZERO
            for y in range(top, bottom):
                for x in range(left, right):
                    above = dsm[y, x] - lowest
                    if -_BAND <= above <= band:
                        total += above
                        number += _ONE
            mean[i, j] = lowest + total / number


def allowed_loss(before: int, width: int, metres: float, slope: float, step: float) -> float:
    """Height in metres that terrain may lose between the openings by two half widths, given in cells.

    A ridge with `slope` on both sides loses slope times the difference of the half widths, a diagonal one sqrt(2)
    times as much.  Onto that comes a terrace, quay or embankment, up to `step`, the lower the narrower it is.
    """
    return min(step, _LEAST_STEP + _STEP_GROWTH * metres * width) + math.sqrt(2) * slope * metres * (width - before)


def _terrain(
    low: Floats, widths: list[int], metres: float, slope: float, step: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """The lowest surface with objects cut down to the last opening, and which cells are no ground."""
    objects = low == _MISSING
    eroded = opened = low
    before = 0
    for width in widths:
        eroded = window_lowest(eroded, width - before)
        after = window_highest(np.where(eroded == _MISSING, -_MISSING, eroded), width)
        objects |= opened > after + np.float32(allowed_loss(before, width, metres, slope, step))
        opened, before = after, width
    surface = np.where(objects, opened, low)
    # A pit is the dual of an object: what a small closing of the ground fills by more than a step.
    closed = window_lowest(window_highest(surface, _PIT_HALF_WIDTH), _PIT_HALF_WIDTH)
    return surface, objects | (surface + np.float32(step) < closed)


# ------------------------------------------------------------------------------------------ interpolation


@loop
def _pull(coarse: Floats, fine: Floats) -> None:
    """Mean of those of each square of four cells that are present."""
    for i in range(coarse.shape[0]):
        for j in range(coarse.shape[1]):
            total, number = _ZERO, _ZERO
            for y in range(2):
                for x in range(2):
                    value = fine[2 * i + y, 2 * j + x]
                    if value < _MISSING:
                        total += value
                        number += _ONE
            coarse[i, j] = total / number if number > _ZERO else _MISSING


@rule
def _corner(index: int, side: int) -> int:
    """The first of the two cells between whose centres position `index` lies, in cells of `side`."""
    return (2 * index + 1 - side) // (2 * side)


@rule
def _share(index: int, side: int, corner: int) -> np.float32:
    """How far position `index` lies on the way from the centre of cell `corner` to the next, 0 to 1."""
    return np.float32(2 * index + 1 - side - 2 * side * corner) / np.float32(2 * side)


@loop
def _spread(
    fine: Floats, wanted: NDArray[np.bool_], coarse: Floats, side: int, row_shift: int, column_shift: int
) -> None:
    """Fill `fine` where wanted by bilinear interpolation between those cells of `coarse` that are present."""
    rows, columns = coarse.shape
    value, weight = np.empty(columns, np.float32), np.empty(columns, np.float32)
    left, right = np.empty(fine.shape[1], np.int64), np.empty(fine.shape[1], np.int64)
    share = np.empty(fine.shape[1], np.float32)
    for j in range(fine.shape[1]):
        x = _corner(j + column_shift, side)
        left[j], right[j], share[j] = max(x, 0), min(x + 1, columns - 1), _share(j + column_shift, side, x)
    for i in range(fine.shape[0]):
        y = _corner(i + row_shift, side)
        down = _share(i + row_shift, side, y)
        above, below = coarse[max(y, 0)], coarse[min(y + 1, rows - 1)]
        for k in range(columns):
            a = _ONE - down if above[k] < _MISSING else _ZERO
            b = down if below[k] < _MISSING else _ZERO
            value[k] = (a * above[k] if a > _ZERO else _ZERO) + (b * below[k] if b > _ZERO else _ZERO)
            weight[k] = a + b
        row, here = fine[i], wanted[i]
        for j in range(row.size):
            a, b = _ONE - share[j], share[j]
            total = a * weight[left[j]] + b * weight[right[j]]
            if here[j] and total > _ZERO:
                row[j] = (a * value[left[j]] + b * value[right[j]]) / total


def _filled(values: Floats, stand_in: Floats) -> Floats:
    """Pull-push: what is missing comes from the mean of the next coarser level, at the top from `stand_in`."""
    levels, spare = [values], stand_in
    for _ in range(_LEVELS):
        shape = (levels[-1].shape[0] // 2, levels[-1].shape[1] // 2)
        coarse, spare_coarse = np.empty(shape, np.float32), np.empty(shape, np.float32)
        _pull(coarse, levels[-1])
        _pull(spare_coarse, spare)
        levels.append(coarse)
        spare = spare_coarse
    filled = np.where(levels[-1] == _MISSING, spare, levels[-1])
    for fine in reversed(levels[:-1]):
        _spread(fine, fine == _MISSING, filled, 2, 0, 0)
        filled = fine
    return filled


def ground_height(
    dsm: NDArray[Any],
    *,
    resolution: float,
    largest_object: float = 80.0,
    slope: float = 0.3,
    step: float = 1.5,
    origin: tuple[int, int] = (0, 0),
) -> NDArray[np.float32]:
    """Height of the bare earth, estimated from a surface model alone.

    Parameters
    ----------
    dsm
        Heights in metres, shape (rows, columns), any real dtype; computed in float32.  What is not finite is nodata
        and takes no part.
    resolution
        Side of a pixel in metres.
    largest_object
        Metres.  Objects whose narrower side is less than this are taken off; wider ones are ground.
    slope
        Steepest slope of terrain on both sides of a ridge, metres per metre.  A plane slope is never cut, however
        steep.
    step
        Highest terrace, quay or embankment that is terrain, in metres; less than the lowest roof.
    origin
        Global row and column of ``dsm[0, 0]``; the coarse cells are anchored to the global grid.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Height of the ground in metres; NaN where `dsm` is nodata.  ``dsm - ground`` is the height above ground.

    Raises
    ------
    ValueError
        For a block that is not two-dimensional and real, or a parameter out of its range.

    Notes
    -----
    Between two opening sizes terrain may lose :func:`allowed_loss`; that is eq. 5 of Zhang et al. (2003) with the
    openings grown in steps so small that the slope's share of it stays below the height of a roof.
    """
    array = np.asarray(dsm)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"dsm must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    if not (math.isfinite(slope) and slope >= 0 and math.isfinite(step) and step >= 0):
        raise ValueError(f"slope and step must be 0 or more, not {slope} and {step}")
    side, widths = cell_side(resolution), half_widths(resolution, largest_object)
    block = np.ascontiguousarray(array, dtype=np.float32)
    if block.size == 0:
        return block.copy()
    # Cells start at the coarsest level of the pyramid, so that the levels are halves of each other.
    square = side << _LEVELS
    row_shift, column_shift = origin[0] % square, origin[1] % square
    shape = (
        -(-(block.shape[0] + row_shift) // square) << _LEVELS,
        -(-(block.shape[1] + column_shift) // square) << _LEVELS,
    )
    low = np.empty(shape, np.float32)
    _lowest_of_cells(low, block, side, row_shift, column_shift)
    surface, objects = _terrain(low, widths, side * resolution, slope, step)
    mean = np.where(objects, _MISSING, low)
    _mean_of_cells(mean, low, surface, block, np.float32(step), side, row_shift, column_shift)
    filled = _filled(mean, surface)
    # Cells of nodata and beyond the raster would only blur what is known at its border.
    filled[low == _MISSING] = _MISSING
    ground = np.full(block.shape, np.nan, np.float32)
    _spread(ground, np.isfinite(block), filled, side, row_shift, column_shift)
    return ground
