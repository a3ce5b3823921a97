"""Brute-force gridding: every cell looks at every point."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

SUBCELLS = 65536


def _squared_distance(row: int, column: int, point: tuple[int, int, int]) -> Fraction:
    """In cells, from the centre of a cell to the middle of the point's subcell."""
    y = Fraction(2 * point[0] + 1, 2 * SUBCELLS) - row - Fraction(1, 2)
    x = Fraction(2 * point[1] + 1, 2 * SUBCELLS) - column - Fraction(1, 2)
    return y * y + x * x


def _content(point: tuple[int, int, int]) -> tuple[int, ...]:
    y, x, value = point
    return y // SUBCELLS, x // SUBCELLS, y % SUBCELLS, x % SUBCELLS, value


def _own_value(points: list[tuple[int, int, int]], row: int, column: int, method: str, radius: float) -> float:
    inside = [value for y, x, value in points if (y // SUBCELLS, x // SUBCELLS) == (row, column)]
    if method == "idw":
        near = [(_squared_distance(row, column, point), point) for point in points]
        near = [(distance, point) for distance, point in near if distance <= Fraction(radius) ** 2]
        weights = [1.0 / float(distance) for distance, _ in near]
        total = math.fsum(w * point[2] for w, (_, point) in zip(weights, near, strict=True))
        return total / math.fsum(weights) if near else math.nan
    if not inside:
        return math.nan
    if method == "nearest":
        return min((_squared_distance(row, column, point), _content(point), point[2]) for point in points)[2]
    return {"max": max(inside), "min": min(inside), "mean": sum(inside) / len(inside)}[method]


def grid(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    values: NDArray[np.int32],
    shape: tuple[int, int],
    method: str,
    reach: float,
    radius: float,
) -> NDArray[np.float64]:
    """Raster whose first cell is the global cell (0, 0); arguments as those of the kernels."""
    points = list(zip(rows.tolist(), columns.tolist(), values.tolist(), strict=True))
    own = np.array([[_own_value(points, r, c, method, radius) for c in range(shape[1])] for r in range(shape[0])])
    result = own.copy()
    filled = np.argwhere(~np.isnan(own)).tolist()
    for r, c in np.argwhere(np.isnan(own)).tolist():
        if method == "nearest":
            found = [(_squared_distance(r, c, point), _content(point), point[2]) for point in points]
        else:
            found = [(Fraction((r - i) ** 2 + (c - j) ** 2), (i, j), own[i, j]) for i, j in filled]
        if found and reach > 0 and min(found)[0] <= Fraction(reach) ** 2:
            result[r, c] = min(found)[2]
    return result
