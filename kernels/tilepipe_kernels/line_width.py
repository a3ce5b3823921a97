"""Width, true centre and contrast of a line at each of its points, from the edges found along the normal.

Steger 1998, Sections 2.3 and 3.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .gaussian_derivatives import as_block, fill_nodata, gaussian_smooth
from .gaussian_passes import CELL_ROWS, STRIP, Floats, kernel_radius
from .line_model import bar_contrast, bar_from_edges
from .line_points import LinePoints

# Farthest pixel from a sample that its cubic interpolation reads, and samples beyond the last edge for
# differences.
SAMPLE_REACH = 2
BEYOND = 3
# A weaker maximum in front of the strongest one is the line's own edge unless it is less than this share of
# it.
OWN_EDGE_SHARE = 0.5


@dataclass(frozen=True)
class Widths:
    """Width attributes aligned with the line points, float32 arrays and one bool array.

    Attributes
    ----------
    left, right
        Distance in pixels to the edge against and along the normal.  Where `valid`: from the true centre to
        the true edges, hence equal.  Elsewhere: from the point to the edge as seen at this scale; NaN where
        none was found.
    shift
        Pixels along the normal from the point to the true centre of the line; 0 where not valid.
    contrast
        Grey difference between the line and its farther side (the side that differs more); NaN where not
        valid.
    valid
        Whether both edges were found and fit a bar.
    """

    left: Floats
    right: Floats
    shift: Floats
    contrast: Floats
    valid: NDArray[np.bool_]


@rule
def _cubic_weights(f: float) -> tuple[float, float, float, float]:
    """Weights of the samples at -1, 0, 1, 2 for the value at f in [0, 1): third order (Keys 1981)."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@loop
def _sample(image: Floats, y: float, x: float) -> float:
    """Cubic interpolation with replicated border."""
    rows, columns = image.shape
    row, column = math.floor(y), math.floor(x)
    w_x = _cubic_weights(x - column)
    w_y = _cubic_weights(y - row)
    value = 0.0
    for i in range(4):
        line = image[min(max(row + i - 1, 0), rows - 1)]
        total = 0.0
        for j in range(4):
            total += w_x[j] * line[min(max(column + j - 1, 0), columns - 1)]
        value += w_y[i] * total
    return value


@loop
def _edge(outward: NDArray[np.float64], sign: float) -> tuple[float, float]:
    """Distance of the line's edge and gradient there; ``outward`` holds the profile at -1, 0, 1, … pixels."""
    count = outward.size - 3
    gradient = np.empty(count, np.float64)
    strongest = 0.0
    for j in range(count):
        near, far = outward[j + 2] - outward[j + 1], outward[j + 3] - outward[j]
        gradient[j] = sign * (27.0 * near - far) / 24.0
        if 0 < j < count - 1:
            strongest = max(strongest, gradient[j])
    for j in range(1, count - 1):
        before, here, after = gradient[j - 1], gradient[j], gradient[j + 1]
        if here > 0 and here >= OWN_EDGE_SHARE * strongest and here > before and here >= after:
            bend = before - 2.0 * here + after
            step = 0.5 * (before - after) / bend
            return j + 0.5 + step, here - 0.25 * (before - after) * step
    return math.nan, math.nan


@loop
def _width_loop(
    image: Floats,
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    geometry: tuple[Floats, Floats, Floats, Floats],
    sigma: float,
    sign: float,
    reach: int,
    out: Floats,
    valid: NDArray[np.bool_],
) -> None:
    dx, dy, nx, ny = geometry
    half = reach + BEYOND
    profile = np.empty(2 * half + 1, np.float64)
    backward = profile[::-1]
    for i in range(row.size):
        x, y, n_x, n_y = float(col[i]) + dx[i], float(row[i]) + dy[i], float(nx[i]), float(ny[i])
        for j in range(-half, half + 1):
            profile[j + half] = _sample(image, y + j * n_y, x + j * n_x)
        right, right_gradient = _edge(profile[half - 1 :], sign)
        left, left_gradient = _edge(backward[half - 1 :], sign)
        out[0, i], out[1, i], out[2, i], out[3, i] = left, right, 0.0, math.nan
        valid[i] = False
        if math.isnan(left + right):
            continue
        log_ratio = math.log(right_gradient / left_gradient)
        half_width, offset, near = bar_from_edges((left + right) / sigma, -abs(log_ratio))
        if math.isnan(half_width):
            continue
        out[0, i] = out[1, i] = half_width * sigma
        out[2, i] = offset * sigma * (1.0 if log_ratio > 0.0 else -1.0)
        out[3, i] = bar_contrast(max(left_gradient, right_gradient) * sigma, half_width, near)
        valid[i] = True


@loop
def _cells_around(
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    reach: int,
    rows: int,
    columns: int,
    active: NDArray[np.uint8],
) -> None:
    for i in range(row.size):
        for strip in range(max(col[i] - reach, 0) // STRIP, min(col[i] + reach, columns - 1) // STRIP + 1):
            for cell in range(max(row[i] - reach, 0) // CELL_ROWS, min(row[i] + reach, rows - 1) // CELL_ROWS + 1):
                active[strip, cell] = 1


def _search_reach(sigma: float, maximum_width: float) -> int:
    """Pixels from a point to the farthest edge sought; smoothing moves edges out by up to sigma."""
    if not maximum_width > 0:
        raise ValueError(f"maximum_width is {maximum_width}: give the widest line in pixels, a positive number")
    return math.ceil(0.5 * maximum_width + sigma)


def line_widths(
    block: NDArray[Any], points: LinePoints, sigma: float, *, maximum_width: float, dark: bool = True
) -> Widths:
    """Find the edges beside each line point and correct width, position and contrast for the smoothing.

    On either side, along the normal, the edge is the nearest distinct maximum of the gradient of the smoothed
    image. From the distance between the edges and the ratio of their gradients follow the width and the
    asymmetry of the bar that looks so at this scale, and from these the bias of the ridge (Steger 1998,
    Sections 2.3, 3.4).

    Parameters
    ----------
    block
        Image (rows, columns) in which the points were found; NaN = nodata.
    points
        Line points of this block at this scale.
    sigma
        Gaussian scale in pixels.
    maximum_width
        Full width of the widest line in pixels; edges are sought up to half of it plus sigma.
    dark
        Whether the lines are darker than their sides.

    Returns
    -------
    Widths
        Aligned with the points.
    """
    reach = _search_reach(sigma, maximum_width)
    image, _ = fill_nodata(as_block(block), sigma)
    rows, columns = image.shape
    active = np.zeros((-(-columns // STRIP), -(-rows // CELL_ROWS)), np.uint8)
    _cells_around(points.row, points.col, reach + BEYOND + SAMPLE_REACH + 1, rows, columns, active)
    smooth = gaussian_smooth(image, sigma, active)
    values, valid = np.empty((4, len(points)), np.float32), np.empty(len(points), np.bool_)
    geometry = points.dx, points.dy, points.nx, points.ny
    sign = 1.0 if dark else -1.0
    _width_loop(smooth, points.row, points.col, geometry, float(sigma), sign, reach, values, valid)
    return Widths(values[0], values[1], values[2], values[3], valid)


def halo(sigma: float, maximum_width: float) -> int:
    """Pixels around a point on which its width depends: search, interpolation, twice the kernel radius."""
    return _search_reach(sigma, maximum_width) + BEYOND + SAMPLE_REACH + 1 + 2 * kernel_radius(sigma)
