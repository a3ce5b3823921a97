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

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.image.fill import fill_voids
from tilepipe_kernels.points.nearest import find_filled, grid_nearest
from tilepipe_kernels.points.placed_points import Places, sort_by_cell, sort_within_cells, squared_distance, squared_gap
from tilepipe_kernels.points.point_tiles import MAXIMUM_SIDE, POINT, SUBCELLS

Method = Literal["nearest", "max", "min", "mean", "idw"]
METHODS: tuple[str, ...] = get_args(Method)

BYTES_PER_POINT = POINT.itemsize + 12
BYTES_PER_CELL = 48
"""Working memory of `grid_points`, its points and result included."""

_MAX, _MIN, _MEAN = 0, 1, 2


def halo(method: Method, reach: float = 0.0, radius: float = 0.0) -> int:
    """Cells that a tile needs on each side, for a void reach and an IDW radius given in cells.

    Examples
    --------
    >>> from tilepipe_kernels.points.gridding import halo
    >>> halo("max"), halo("max", reach=3.0), halo("idw", radius=2.5)
    (0, 3, 3)
    """
    if method == "nearest":
        return max(1, math.floor(reach + 0.5))
    return math.floor(reach) + (math.floor(radius + 0.5) if method == "idw" else 0)


@loop
def _inside(points: NDArray[Any], rows: int, columns: int) -> bool:
    """Whether all points lie in the padded tile."""
    row = column = np.int64(-1)
    for i in range(points.size):
        row, column = max(row, np.int64(points[i].row)), max(column, np.int64(points[i].column))
    return bool(row < rows and column < columns)


@loop
def _accumulate(points: NDArray[Any], columns: int, method: int, totals: NDArray[np.int64]) -> None:
    """Number of points and sum, greatest or least value of each cell; integers, so the order does not matter."""
    for i in range(points.size):
        point = points[i]
        cell, value = totals[np.int64(point.row) * columns + point.column], np.int64(point.value)
        if method == _MEAN:
            cell[1] += value
        elif cell[0] == 0 or (value > cell[1] if method == _MAX else value < cell[1]):
            cell[1] = value
        cell[0] += 1


@loop
def _summarise(totals: NDArray[np.int64], method: int, result: NDArray[np.float64]) -> None:
    for cell in range(result.size):
        count, total = totals[cell, 0], totals[cell, 1]
        if count > 0:
            result[cell] = total / count if method == _MEAN else total
        else:
            result[cell] = np.nan


@loop
def _weigh(
    places: Places, values: NDArray[np.int32], starts: NDArray[np.int32], reach: int, limit: int,
    result: NDArray[np.float64],
) -> None:  # fmt: skip
    """Inverse distance weighting, in the order of the cells and of the points in them."""
    rows, columns = result.shape
    for row in range(rows):
        for column in range(columns):
            total = weights = 0.0
            y, x = (2 * row + 1) * SUBCELLS, (2 * column + 1) * SUBCELLS
            for r in range(max(0, row - reach), min(rows, row + reach + 1)):
                for c in range(max(0, column - reach), min(columns, column + reach + 1)):
                    if squared_gap(r - row) + squared_gap(c - column) > limit:
                        continue
                    for i in range(starts[r * columns + c], starts[r * columns + c + 1]):
                        distance = squared_distance(places[i], y, x)
                        if distance <= limit:
                            weight = 1.0 / distance
                            total += weight * values[i]
                            weights += weight
            if weights > 0.0:
                result[row, column] = total / weights


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

    Examples
    --------
    Two points in the first of three cells, one in the second, none in the third.

    >>> import numpy as np
    >>> from tilepipe_kernels.points.gridding import grid_points
    >>> from tilepipe_kernels.points.point_tiles import POINT
    >>> points = np.array([(0, 0, 9, 9, 50), (0, 0, 99, 99, 70), (0, 1, 9, 9, 10)], POINT)
    >>> grid_points(points, (1, 3), method="max").tolist(), grid_points(points, (1, 3), method="mean").tolist()
    ([[70.0, 10.0, nan]], [[60.0, 10.0, nan]])
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
    if not _inside(points, rows, columns):
        raise ValueError("points lie outside the padded tile; cut them with sort_by_tile and the same halo")
    if method == "nearest":
        return _nearest(points, shape, margin, math.floor((reach * 2 * SUBCELLS) ** 2))
    if method == "idw":
        values = _weighted(points, rows, columns, radius)
    else:
        code = {"max": _MAX, "min": _MIN, "mean": _MEAN}[method]
        totals = np.zeros((rows * columns, 2), np.int64)
        _accumulate(points, columns, code, totals)
        values = np.empty((rows, columns))
        _summarise(totals, code, values.reshape(-1))
    core = slice(margin, margin + shape[0]), slice(margin, margin + shape[1])
    if reach >= 1:
        return np.ascontiguousarray(fill_voids(values, reach)[core], np.float64)
    return np.ascontiguousarray(values[core])


def _nearest(points: NDArray[Any], shape: tuple[int, int], margin: int, limit: int) -> NDArray[np.float64]:
    rows, columns = shape[0] + 2 * margin, shape[1] + 2 * margin
    starts, places, values = _sorted(points, rows, columns)
    left, right = np.empty((rows, columns), np.int32), np.empty((rows, columns), np.int32)
    find_filled(starts, left, right)
    result = np.full(shape, np.nan)
    grid_nearest(places, values, starts, left, right, margin, limit, result)
    return result


def _weighted(points: NDArray[Any], rows: int, columns: int, radius: float) -> NDArray[np.float64]:
    starts, places, values = _sorted(points, rows, columns)
    sort_within_cells(starts, places, values)
    result = np.full((rows, columns), np.nan)
    _weigh(places, values, starts, math.ceil(radius), math.floor((radius * 2 * SUBCELLS) ** 2), result)
    return result


def _sorted(points: NDArray[Any], rows: int, columns: int) -> tuple[NDArray[np.int32], Places, NDArray[np.int32]]:
    starts = np.zeros(rows * columns + 2, np.int32)
    places, values = np.empty(points.size, np.int64), np.empty(points.size, np.int32)
    sort_by_cell(points, columns, starts, places, values)
    return starts, places, values
