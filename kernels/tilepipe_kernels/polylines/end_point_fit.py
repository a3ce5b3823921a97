"""Polylines simplified by iterative end-point fit (Ramer 1972, Douglas & Peucker 1973), each by itself."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import Int64

Some = TypeVar("Some", bound=Polylines)


@rule
def squared_distance(y: float, x: float, down: float, right: float) -> float:
    """Squared distance of the point (y, x) from the segment between (0, 0) and (down, right)."""
    square = down * down + right * right
    along = y * down + x * right
    if along <= 0 or square == 0:
        return y * y + x * x
    if along >= square:
        return (y - down) ** 2 + (x - right) ** 2
    across = y * right - x * down
    return across * across / square


@loop
def _farthest(
    vertices: NDArray[Any], first: int, last: int, foot: int, top: int, height: float, width: float
) -> tuple[int, float]:
    """Of the vertices between first and last the farthest from the segment foot-top, and its squared distance."""
    down = (vertices[top, 0] - vertices[foot, 0]) * height
    right = (vertices[top, 1] - vertices[foot, 1]) * width
    farthest, largest = first, -1.0
    for k in range(first + 1, last):
        y = (vertices[k, 0] - vertices[foot, 0]) * height
        x = (vertices[k, 1] - vertices[foot, 1]) * width
        distance = squared_distance(y, x, down, right)
        if distance > largest:
            farthest, largest = k, distance
    return farthest, largest


@loop
def keep_vertices(
    redo: Int64,
    offsets: Int64,
    vertices: NDArray[Any],
    tolerances: NDArray[np.float64],
    height: float,
    width: float,
    kept: NDArray[np.bool_],
) -> None:
    """Say for the polylines to redo which vertices are kept: ends always, and those farther off than the tolerance.

    Parameters
    ----------
    redo
        int64: numbers of the polylines.
    offsets, vertices
        Of `Polylines`, with vertices (row, column); a closed one keeps three corners at least.
    tolerances
        Per polyline, in the unit of ``height`` and ``width``; 0 keeps all.
    height, width
        Size of a pixel.
    kept
        Per vertex, changed in place for the polylines to redo.
    """
    for polyline in redo:
        first, last = offsets[polyline], offsets[polyline + 1] - 1
        limit = tolerances[polyline] ** 2
        kept[first : last + 1] = limit == 0
        if limit == 0 or last == first + 1:
            kept[first] = kept[last] = True
            continue
        kept[first] = kept[last] = True
        todo = [(first, last)]
        if vertices[first, 0] == vertices[last, 0] and vertices[first, 1] == vertices[last, 1]:
            # A closed polyline has no chord: its farthest corner gives one, and the corners farthest from that an area.
            middle, _ = _farthest(vertices, first, last, first, last, height, width)
            one, distance = _farthest(vertices, first, middle, first, middle, height, width)
            other, opposite = _farthest(vertices, middle, last, middle, last, height, width)
            kept[middle] = True
            kept[one] |= distance >= opposite / 4
            kept[other] |= opposite >= distance / 4
            todo.pop()
            begin = first
            for k in (one, middle, other, last):
                if kept[k] and k > begin:
                    todo.append((begin, k))
                    begin = k
        while len(todo) > 0:
            begin, end = todo.pop()
            k, distance = _farthest(vertices, begin, end, begin, end, height, width)
            if distance > limit:
                kept[k] = True
                todo.append((begin, k))
                todo.append((k, end))


def fit_polylines(polylines: Some, tolerance: float, pixel_height: float = 1.0, pixel_width: float = 1.0) -> Some:
    """Approximate polylines by segments between some of their vertices.

    Parameters
    ----------
    polylines
        With vertices (row, column).
    tolerance
        Largest distance between a dropped vertex and the segment that replaces it, in the unit of the pixel
        sizes, ≥ 0.
    pixel_height, pixel_width
        Size of a pixel, > 0.

    Returns
    -------
    Polylines
        The same in the same order, with a part of their vertices.

    Raises
    ------
    ValueError
        For a tolerance < 0, pixel sizes that are not > 0, or a polyline of fewer than two vertices.

    Examples
    --------
    A line with a jog of one pixel and a corner of five.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.end_point_fit import fit_polylines
    >>> line = Polylines(np.array([0, 5]), np.array([[0, 0], [0, 5], [1, 5], [1, 10], [6, 10]]))
    >>> fit_polylines(line, tolerance=1.5).vertices.tolist()
    [[0, 0], [1, 10], [6, 10]]
    """
    if not (np.isfinite(tolerance) and tolerance >= 0 and pixel_height > 0 and pixel_width > 0):
        raise ValueError(f"tolerance ({tolerance}) must be ≥ 0 and pixel sizes > 0: give them in the same unit")
    if (polylines.sizes < 2).any():
        raise ValueError("a polyline has fewer than two vertices: leave it out")
    all_of_them, sizes = np.arange(len(polylines)), (float(pixel_height), float(pixel_width))
    kept, tolerances = np.ones(len(polylines.vertices), np.bool_), np.full(len(polylines), float(tolerance))
    keep_vertices(all_of_them, polylines.offsets, polylines.vertices, tolerances, *sizes, kept)
    return polylines.with_vertices(kept)
