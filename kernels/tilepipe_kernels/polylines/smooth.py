"""Crack lines made smooth: polylines through the middles of their cracks, evened out and simplified."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.simplify import simplify_polylines

LONG_SIDE = 3
"""Cracks of a side that is no step of a staircase."""

PASSES = 8
"""Passes of smoothing: a Gaussian of two cracks."""

FARTHEST = 0.25
"""Farthest that smoothing moves a middle, in pixels: two lines around one pixel then keep apart."""

STEPS = 16
"""Steps of a pixel to which the points are rounded, so that crossings are decided exactly."""

CELL = 8
"""Pixels on a side of the cells by which segments that may meet are found."""


@rule
def _cracks(vertices: NDArray[np.int32], k: int) -> int:
    """Cracks from one corner of a line to the next; one of the two differences is 0."""
    cracks: int = abs(vertices[k + 1, 0] - vertices[k, 0]) + abs(vertices[k + 1, 1] - vertices[k, 1])
    return cracks


@loop
def _count_points(offsets: NDArray[np.int64], vertices: NDArray[np.int32], starts: NDArray[np.int64]) -> None:
    """Where the points of each line start: its cracks, and its ends."""
    for line in range(offsets.size - 1):
        cracks = 0
        for k in range(offsets[line], offsets[line + 1] - 1):
            cracks += _cracks(vertices, k)
        starts[line + 1] = starts[line] + cracks + 2


@loop
def _place_points(
    offsets: NDArray[np.int64],
    vertices: NDArray[np.int32],
    starts: NDArray[np.int64],
    points: NDArray[np.float64],
    free: NDArray[np.bool_],
) -> None:
    """Middles of the cracks between the ends of each line; those beside a corner of two long sides are not free."""
    for line in range(offsets.size - 1):
        first, last = offsets[line], offsets[line + 1] - 1
        at = starts[line] + 1
        points[at - 1] = vertices[first]
        for k in range(first, last):
            cracks = _cracks(vertices, k)
            for crack in range(cracks):
                share = (crack + 0.5) / cracks
                for axis in range(2):
                    points[at, axis] = vertices[k, axis] + share * (vertices[k + 1, axis] - vertices[k, axis])
                free[at] = True
                at += 1
            if k + 1 < last and min(cracks, _cracks(vertices, k + 1)) >= LONG_SIDE:
                # the corner stands for both of its cracks, on which the line then bends
                points[at - 1] = vertices[k + 1]
                free[at - 1] = False
        points[at] = vertices[last]


@loop
def _smooth(starts: NDArray[np.int64], points: NDArray[np.float64], free: NDArray[np.bool_]) -> None:
    """Move free points to the mean of themselves and both neighbours again and again, but never far."""
    for line in range(starts.size - 1):
        first, last = starts[line], starts[line + 1]
        origin, before = points[first:last].copy(), points[first:last].copy()
        for _ in range(PASSES):
            for k in range(1, last - first - 1):
                if not free[first + k]:
                    continue
                down = 0.25 * (before[k - 1, 0] + before[k + 1, 0]) + 0.5 * before[k, 0] - origin[k, 0]
                right = 0.25 * (before[k - 1, 1] + before[k + 1, 1]) + 0.5 * before[k, 1] - origin[k, 1]
                far = math.sqrt(down * down + right * right)
                share = FARTHEST / far if far > FARTHEST else 1.0
                points[first + k, 0], points[first + k, 1] = origin[k, 0] + share * down, origin[k, 1] + share * right
            before[:] = points[first:last]


@loop
def _round(
    starts: NDArray[np.int64], points: NDArray[np.float64], offsets: NDArray[np.int64], steps: NDArray[np.int32]
) -> None:
    """Points in whole steps of a pixel; those of a line that fall on one another are one."""
    at = 0
    for line in range(starts.size - 1):
        for k in range(starts[line], starts[line + 1]):
            row, column = np.int32(np.rint(points[k, 0] * STEPS)), np.int32(np.rint(points[k, 1] * STEPS))
            if k > starts[line] and row == steps[at - 1, 0] and column == steps[at - 1, 1]:
                continue
            steps[at, 0], steps[at, 1] = row, column
            at += 1
        offsets[line + 1] = at


def smoothed(lines: Polylines, tolerance: float) -> Polylines:
    """Smooth polylines near crack lines.

    Ends stay where they are, and so do corners between two sides of three cracks or more.  The middles move by less
    than half the distance of the next line, and simplification lets no line come into conflict with another.  With a
    tolerance of 0.15 all is within half a pixel of the cracks.

    Parameters
    ----------
    lines
        Along the cracks of a raster, such as `CrackLines`.
    tolerance
        Of the simplification, in pixels; 0 = none.

    Returns
    -------
    Polylines
        The same in the same order, with vertices (row, column) in pixels, float64.
    """
    starts = np.zeros(len(lines) + 1, np.int64)
    _count_points(lines.offsets, lines.vertices, starts)
    points, free = np.empty((int(starts[-1]), 2)), np.zeros(int(starts[-1]), np.bool_)
    _place_points(lines.offsets, lines.vertices, starts, points, free)
    _smooth(starts, points, free)
    offsets, steps = np.zeros_like(starts), np.empty(points.shape, np.int32)
    _round(starts, points, offsets, steps)
    del points, free
    rounded = Polylines(offsets, steps[: offsets[-1]])
    if tolerance > 0:
        rounded = simplify_polylines(rounded, tolerance, 1 / STEPS, 1 / STEPS, cell=CELL * STEPS)
    return Polylines(rounded.offsets, rounded.vertices / STEPS)
