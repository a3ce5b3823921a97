"""Points to raster: the value of each cell from the points in and around it, whatever their order.

Positions are integers (`point_tiles`), so distances are exact, ties are real ties, and they are broken by
content (cell in row-major order, then position in the cell, then value), never by the order in which the
points come. Sums are of integers, or of floats in that same canonical order.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.compiled import loop, rule
from tilepipe_kernels.point_tiles import MAXIMUM_SIDE, POINT, SUBCELLS

Method = Literal["nearest", "max", "min", "mean", "idw"]
METHODS: tuple[str, ...] = get_args(Method)

BYTES_PER_POINT = POINT.itemsize + 8
BYTES_PER_CELL = 32
"""Working memory of `grid_points`, its points and result included."""

_HALF = SUBCELLS >> 1
_VALUE_BITS = 32
_VALUE_SHIFT = 1 << 31
_NO_LIMIT = 1 << 62
_MAX, _MIN, _MEAN = 0, 1, 2


def halo(method: Method, reach: float = 0.0, radius: float = 0.0) -> int:
    """Cells that a tile needs on each side, for a void reach and an IDW radius given in cells."""
    if method == "nearest":
        return max(1, math.floor(reach + 0.5))
    return math.floor(reach) + (math.floor(radius + 0.5) if method == "idw" else 0)


@loop
def _sort_by_cell(points: NDArray[Any], columns: int, starts: NDArray[np.int32], keys: NDArray[np.int64]) -> None:
    """Counting sort; ``starts`` holds two more entries than cells and comes zeroed.

    A key holds all of a point but its cell (y, x, value from the highest bit down), so that keys order by
    content.
    """
    for i in range(points.size):
        point = points[i]
        starts[np.int64(point.row) * columns + point.column + 2] += 1
    for cell in range(1, starts.size):
        starts[cell] += starts[cell - 1]
    for i in range(points.size):
        point = points[i]
        cell = np.int64(point.row) * columns + point.column + 1
        y, x = np.int64(point.y) - _HALF, np.int64(point.x)
        keys[starts[cell]] = (y << 48) | (x << _VALUE_BITS) | (np.int64(point.value) + _VALUE_SHIFT)
        starts[cell] += 1


@rule
def _value(key: int) -> int:
    return (key & 0xFFFFFFFF) - _VALUE_SHIFT


@rule
def _squared_distance(key: int, row_step: int, column_step: int) -> int:
    """From a cell's centre to a point some cells away, in half subcells; offsets are odd, so never zero."""
    y = 2 * ((key >> 48) + SUBCELLS * row_step) + 1
    x = 2 * (((key >> _VALUE_BITS) & (SUBCELLS - 1)) - _HALF + SUBCELLS * column_step) + 1
    return y * y + x * x


@rule
def _squared_gap(step: int) -> int:
    """Square of the least offset along an axis from a cell's centre into one ``step`` away, half subcells."""
    gap = max(0, 2 * abs(step) - 1) * SUBCELLS
    return gap * gap


@loop
def _find_filled(filled: NDArray[np.bool_], left: NDArray[np.int32], right: NDArray[np.int32]) -> None:
    """Column of the nearest filled cell at or left of a cell (else -1), at or right of it (else width)."""
    rows, columns = filled.shape
    for row in range(rows):
        last = -1
        for column in range(columns):
            if filled[row, column]:
                last = column
            left[row, column] = last
        last = columns
        for column in range(columns - 1, -1, -1):
            if filled[row, column]:
                last = column
            right[row, column] = last


@loop
def _nearest_in_cell(
    keys: NDArray[np.int64], start: int, stop: int, row_step: int, column_step: int
) -> tuple[int, int]:
    best, best_key = _NO_LIMIT, keys[start]
    for i in range(start, stop):
        distance = _squared_distance(keys[i], row_step, column_step)
        if distance < best or (distance == best and keys[i] < best_key):
            best, best_key = distance, keys[i]
    return best, best_key


@loop
def _nearest_to_filled(
    keys: NDArray[np.int64], starts: NDArray[np.int32], columns: int, row: int, column: int
) -> float:
    """Value of the point nearest to the centre of a cell with points: it lies in this cell or one around."""
    cell = row * columns + column
    best, best_key = _nearest_in_cell(keys, starts[cell], starts[cell + 1], 0, 0)
    if best < _squared_gap(1):
        return float(_value(best_key))
    best_cell = cell
    for row_step in range(-1, 2):
        for column_step in range(-1, 2):
            other = cell + row_step * columns + column_step
            if other == cell or starts[other] == starts[other + 1]:
                continue
            if _squared_gap(row_step) + _squared_gap(column_step) <= best:
                distance, key = _nearest_in_cell(keys, starts[other], starts[other + 1], row_step, column_step)
                if distance < best or (distance == best and other < best_cell):
                    best, best_cell, best_key = distance, other, key
    return float(_value(best_key))


@loop
def _nearest_to_void(
    keys: NDArray[np.int64],
    starts: NDArray[np.int32],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    row: int,
    column: int,
    limit: int,
) -> float:
    """Value of the point nearest to a cell's centre, at most ``limit`` away, else NaN.

    The limit is a squared distance in half subcells.  Rows are searched outwards, and in each row the filled
    cells outwards, while they can hold a point as near as the best so far.
    """
    rows, columns = left.shape
    best, best_row, best_column, best_key = limit, rows, columns, 0
    step = 0
    while step <= rows and _squared_gap(step) <= best:
        for r in range(row - step, row + step + 1, max(1, 2 * step)):
            if r < 0 or r >= rows:
                continue
            for side in range(2):
                if side == 0:
                    c = left[r, column]
                else:
                    c = right[r, column + 1] if column + 1 < columns else columns
                while 0 <= c < columns and _squared_gap(r - row) + _squared_gap(c - column) <= best:
                    cell = r * columns + c
                    distance, key = _nearest_in_cell(keys, starts[cell], starts[cell + 1], r - row, c - column)
                    if distance < best or (distance == best and (r < best_row or (r == best_row and c < best_column))):
                        best, best_row, best_column, best_key = distance, r, c, key
                    if side == 0:
                        c = left[r, c - 1] if c > 0 else -1
                    else:
                        c = right[r, c + 1] if c + 1 < columns else columns
        step += 1
    return float(_value(best_key)) if best_row < rows else np.nan


@loop
def _grid_nearest(
    keys: NDArray[np.int64],
    starts: NDArray[np.int32],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    margin: int,
    limit: int,
    result: NDArray[np.float64],
) -> None:
    columns = result.shape[1] + 2 * margin
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            r, c = row + margin, column + margin
            if starts[r * columns + c] < starts[r * columns + c + 1]:
                result[row, column] = _nearest_to_filled(keys, starts, columns, r, c)
            elif limit > 0:
                result[row, column] = _nearest_to_void(keys, starts, left, right, r, c, limit)


@loop
def _summarise(keys: NDArray[np.int64], starts: NDArray[np.int32], method: int, result: NDArray[np.float64]) -> None:
    """Greatest, least or mean value of the points in each cell; the mean's sum is of integers, so exact."""
    rows, columns = result.shape
    for row in range(rows):
        for column in range(columns):
            start, stop = starts[row * columns + column], starts[row * columns + column + 1]
            if start == stop:
                continue
            total = lowest = highest = _value(keys[start])
            for i in range(start + 1, stop):
                value = _value(keys[i])
                total += value
                lowest, highest = min(lowest, value), max(highest, value)
            if method == _MAX:
                result[row, column] = highest
            elif method == _MIN:
                result[row, column] = lowest
            else:
                result[row, column] = total / (stop - start)


@loop
def _weigh(
    keys: NDArray[np.int64], starts: NDArray[np.int32], reach: int, limit: int, result: NDArray[np.float64]
) -> None:
    """Inverse distance weighting; keys of a cell are sorted first, so that sums run in canonical order."""
    rows, columns = result.shape
    for cell in range(rows * columns):
        if starts[cell + 1] - starts[cell] > 1:
            keys[starts[cell] : starts[cell + 1]].sort()
    for row in range(rows):
        for column in range(columns):
            total = weights = 0.0
            for r in range(max(0, row - reach), min(rows, row + reach + 1)):
                for c in range(max(0, column - reach), min(columns, column + reach + 1)):
                    if _squared_gap(r - row) + _squared_gap(c - column) > limit:
                        continue
                    for i in range(starts[r * columns + c], starts[r * columns + c + 1]):
                        distance = _squared_distance(keys[i], r - row, c - column)
                        if distance <= limit:
                            weight = 1.0 / distance
                            total += weight * _value(keys[i])
                            weights += weight
            if weights > 0.0:
                result[row, column] = total / weights


@loop
def _fill_voids(
    values: NDArray[np.float64],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    margin: int,
    limit: float,
    result: NDArray[np.float64],
) -> None:
    """A cell's own value, else that of the nearest filled cell (of equally near, the first in row-major)."""
    rows, columns = values.shape
    for row in range(margin, rows - margin):
        for column in range(margin, columns - margin):
            best, best_row, best_column = limit, rows, columns
            step = 0
            while step <= rows and step * step <= best:
                for r in range(row - step, row + step + 1, max(1, 2 * step)):
                    if r < 0 or r >= rows:
                        continue
                    for c in (left[r, column], right[r, column]):
                        distance = float((r - row) * (r - row) + (c - column) * (c - column))
                        if 0 <= c < columns and (
                            distance < best
                            or (distance == best and (r < best_row or (r == best_row and c < best_column)))
                        ):
                            best, best_row, best_column = distance, r, c
                step += 1
            if best_row < rows:
                result[row - margin, column - margin] = values[best_row, best_column]


def grid_points(
    points: NDArray[Any],
    shape: tuple[int, int],
    *,
    method: Method,
    reach: float = 0.0,
    radius: float = 0.0,
) -> NDArray[np.float64]:
    """Grid the points of one padded tile.

    Parameters
    ----------
    points
        Records of dtype `POINT` with cells counted from the padded tile's corner, in any order.
    shape
        Rows and columns of the tile's core; the margin around it is ``halo(method, reach, radius)`` cells
        wide.
    method
        ``nearest``: value of the point nearest to the cell's centre, be it in this cell or another.
        ``max``, ``min``, ``mean``: of the points in the cell.
        ``idw``: mean of the points at most ``radius`` from the cell's centre, weighted by 1 / squared
        distance (Shepard 1968, power 2, made local by the radius).
    reach
        In cells.  A cell without a value of its own (without a point in it; for ``idw``, within the radius)
        takes, for ``nearest``, the value of the point nearest to its centre, for the others that of the
        nearest cell that has one (between centres), if not farther than this.  Beyond it stays void; 0 fills
        nothing.
    radius
        In cells, for ``idw`` only.

    Returns
    -------
    ndarray of float64, shape ``shape``
        Values in ticks, NaN where void.

    Raises
    ------
    ValueError
        For an unknown method, points that are not `POINT` records or that lie outside the padded tile, a
        negative or not finite reach, or an IDW radius that is not positive.
    """
    if method not in METHODS:
        raise ValueError(f"unknown gridding method {method!r}; choose one of {', '.join(METHODS)}")
    if points.dtype != POINT or points.ndim != 1:
        raise ValueError("points must be a one-dimensional array of point_tiles.POINT records")
    if not (0 <= reach < MAXIMUM_SIDE):
        raise ValueError(f"the void reach must be 0 or more cells, and finite, not {reach}")
    if method == "idw" and not (0 < radius < MAXIMUM_SIDE):
        raise ValueError(f"the IDW radius must be a positive number of cells, not {radius}")
    margin = halo(method, reach, radius)
    rows, columns = shape[0] + 2 * margin, shape[1] + 2 * margin
    if points.size and (int(points["row"].max()) >= rows or int(points["column"].max()) >= columns):
        raise ValueError("points lie outside the padded tile; cut them with sort_by_tile and the same halo")

    starts = np.zeros(rows * columns + 2, np.int32)
    keys = np.empty(points.size, np.int64)
    _sort_by_cell(points, columns, starts, keys)
    result = np.full(shape, np.nan)
    if method == "nearest":
        filled = (starts[1:-1] > starts[:-2]).reshape(rows, columns)
        left, right = _filled_columns(filled if reach > 0 else filled[:0])
        _grid_nearest(keys, starts, left, right, margin, math.floor((reach * 2 * SUBCELLS) ** 2), result)
        return result
    values = np.full((rows, columns), np.nan) if margin else result
    if method == "idw":
        _weigh(keys, starts, math.ceil(radius), math.floor((radius * 2 * SUBCELLS) ** 2), values)
    else:
        _summarise(keys, starts, {"max": _MAX, "min": _MIN, "mean": _MEAN}[method], values)
    if reach >= 1:
        left, right = _filled_columns(~np.isnan(values))
        _fill_voids(values, left, right, margin, reach * reach, result)
        return result
    return np.ascontiguousarray(values[margin : margin + shape[0], margin : margin + shape[1]])


def _filled_columns(filled: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    left, right = np.empty(filled.shape, np.int32), np.empty(filled.shape, np.int32)
    _find_filled(filled, left, right)
    return left, right
