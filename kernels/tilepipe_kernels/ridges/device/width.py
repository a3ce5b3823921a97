"""`line_width` on the device: profiles across the lines, a thread a sample, then their edges, a thread a point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.device import gaussian
from tilepipe_kernels.image.gaussian_passes import Floats
from tilepipe_kernels.ridges.points import LinePoints
from tilepipe_kernels.ridges.width import (
    BEYOND,
    bar_between,
    cubic_weights,
    edge_gradient,
    edge_near,
    is_own_edge,
    stronger,
    weighted_sum,
)

MOST_SAMPLES = 1 << 24
"""Samples of the profiles that are kept at once: 128 MiB."""


@cuda.jit(device=True)
def _sample_row(image: Any, row: int, column: int, weights: Any) -> float:
    rows, columns = image.shape
    row, last = min(max(row, 0), rows - 1), columns - 1
    return weighted_sum(
        weights,
        image[row, min(max(column - 1, 0), last)],
        image[row, min(max(column, 0), last)],
        image[row, min(max(column + 1, 0), last)],
        image[row, min(max(column + 2, 0), last)],
    )


@grid
def _profiles(
    count: int, image: Any, first: int, row: Any, col: Any, dx: Any, dy: Any, nx: Any, ny: Any, profiles: Any
) -> None:
    """Cubic interpolation with replicated border, at whole pixels along the normals; points lie side by side."""
    length, points = profiles.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = first + p % points, p // points - length // 2
        x = np.float64(col[i]) + np.float64(dx[i]) + j * np.float64(nx[i])
        y = np.float64(row[i]) + np.float64(dy[i]) + j * np.float64(ny[i])
        at, column = int(math.floor(y)), int(math.floor(x))
        w_x, w_y = cubic_weights(x - column), cubic_weights(y - at)
        profiles[p // points, p % points] = weighted_sum(
            w_y,
            _sample_row(image, at - 1, column, w_x),
            _sample_row(image, at, column, w_x),
            _sample_row(image, at + 1, column, w_x),
            _sample_row(image, at + 2, column, w_x),
        )


@cuda.jit(device=True)
def _gradient(profiles: Any, point: int, j: int, side: int, sign: float) -> float:
    """Gradient halfway between the samples j and j + 1 from the point outward, on the side 1 or -1."""
    at = profiles.shape[0] // 2 + side * j
    return edge_gradient(
        profiles[at - side, point],
        profiles[at, point],
        profiles[at + side, point],
        profiles[at + 2 * side, point],
        sign,
    )


@cuda.jit(device=True)
def _edge(profiles: Any, point: int, side: int, sign: float) -> Any:
    """Distance of the line's edge and gradient there."""
    count = profiles.shape[0] // 2 - 1
    strongest = 0.0
    for j in range(1, count - 1):
        strongest = stronger(strongest, _gradient(profiles, point, j, side, sign))
    before, here = _gradient(profiles, point, 0, side, sign), _gradient(profiles, point, 1, side, sign)
    for j in range(1, count - 1):
        after = _gradient(profiles, point, j + 1, side, sign)
        if is_own_edge(before, here, after, strongest):
            step, value = edge_near(before, here, after)
            return j + 0.5 + step, value
        before, here = here, after
    return math.nan, math.nan


@grid
def _bars(count: int, profiles: Any, first: int, sigma: float, sign: float, values: Any, valid: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        right, right_gradient = _edge(profiles, p, 1, sign)
        left, left_gradient = _edge(profiles, p, -1, sign)
        left, right, shift, contrast, fits = bar_between(left, left_gradient, right, right_gradient, sigma)
        i = first + p
        values[0, i], values[1, i], values[2, i], values[3, i], valid[i] = left, right, shift, contrast, fits


def measure(
    image: Floats, points: LinePoints, sigma: float, sign: float, reach: int
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Columns of `ridges.width.Widths` for points on the device, in a filled float32 image beside them."""
    xp, count, length = namespace(image, points.row), len(points), 2 * (reach + BEYOND) + 1
    values, valid = xp.empty((4, count), xp.float32), xp.empty(count, xp.bool_)
    smooth = gaussian.smooth(image, sigma)
    columns = points.row, points.col, points.dx, points.dy, points.nx, points.ny
    at_once = max(1, MOST_SAMPLES // length)
    for first in range(0, count, at_once):
        profiles = xp.empty((length, min(at_once, count - first)), xp.float64)
        _profiles(profiles.size, smooth, first, *columns, profiles)
        _bars(profiles.shape[1], profiles, first, sigma, sign, values, valid)
    return values[0], values[1], values[2], values[3], valid
