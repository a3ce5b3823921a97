"""Width, true centre and contrast of a line at each of its points, from the edges found along the normal.

Steger 1998, Sections 2.3 and 3.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image.gaussian import as_block, fill_nodata, gaussian_smooth
from tilepipe_kernels.image.gaussian_passes import CELL_ROWS, STRIP, Floats, kernel_radius
from tilepipe_kernels.ridges.bar_profile import bar_contrast, bar_from_edges
from tilepipe_kernels.ridges.points import LinePoints

# Farthest pixel from a sample that its cubic interpolation reads, and samples beyond the last edge for
# differences.
SAMPLE_REACH = 2
BEYOND = 3
# A weaker maximum in front of the strongest one is the line's own edge unless it is less than this share of
# it.
OWN_EDGE_SHARE = 0.5


Four = tuple[float, float, float, float]


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
def cubic_weights(f: float) -> Four:
    """Weights of the samples at -1, 0, 1, 2 for the value at f in [0, 1): third order (Keys 1981)."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@rule
def weighted_sum(weights: Four, a: float, b: float, c: float, d: float) -> float:
    """Cubic interpolation along one axis."""
    return weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d


@rule
def edge_gradient(a: float, b: float, c: float, d: float, sign: float) -> float:
    """Gradient in the middle of four samples a pixel apart, positive where the line's side differs as `sign` says."""
    return sign * (27.0 * (c - b) - (d - a)) / 24.0


@rule
def stronger(strongest: float, gradient: float) -> float:
    """Larger of two gradients; the first where the second is missing."""
    return gradient if gradient > strongest else strongest


@rule
def is_own_edge(before: float, here: float, after: float, strongest: float) -> bool:
    """Whether a gradient is a maximum along the normal, and strong enough to be the line's own edge."""
    return here > 0 and here >= OWN_EDGE_SHARE * strongest and here > before and here >= after


@rule
def edge_near(before: float, here: float, after: float) -> tuple[float, float]:
    """Place of the parabola's maximum through three gradients, in pixels from the middle one, and its value."""
    bend = before - 2.0 * here + after
    step = 0.5 * (before - after) / bend
    return step, here - 0.25 * (before - after) * step


@rule
def bar_between(
    left: float, left_gradient: float, right: float, right_gradient: float, sigma: float
) -> tuple[float, float, float, float, bool]:
    """Distances to the edges left and right, shift to the centre, contrast, and whether a bar fits; see `Widths`."""
    if math.isnan(left + right):
        return left, right, 0.0, math.nan, False
    log_ratio = math.log(right_gradient / left_gradient)
    half_width, offset, near = bar_from_edges((left + right) / sigma, -abs(log_ratio))
    if math.isnan(half_width):
        return left, right, 0.0, math.nan, False
    shift = offset * sigma * (1.0 if log_ratio > 0.0 else -1.0)
    contrast = bar_contrast(max(left_gradient, right_gradient) * sigma, half_width, near)
    return half_width * sigma, half_width * sigma, shift, contrast, True


@loop
def _sample(image: Floats, y: float, x: float) -> float:
    """Cubic interpolation with replicated border."""
    rows, columns = image.shape
    row, column = math.floor(y), math.floor(x)
    w_x, w_y = cubic_weights(x - column), cubic_weights(y - row)
    j_0, j_1 = min(max(column - 1, 0), columns - 1), min(max(column, 0), columns - 1)
    j_2, j_3 = min(max(column + 1, 0), columns - 1), min(max(column + 2, 0), columns - 1)
    a, b = image[min(max(row - 1, 0), rows - 1)], image[min(max(row, 0), rows - 1)]
    c, d = image[min(max(row + 1, 0), rows - 1)], image[min(max(row + 2, 0), rows - 1)]
    return weighted_sum(
        w_y,
        weighted_sum(w_x, a[j_0], a[j_1], a[j_2], a[j_3]),
        weighted_sum(w_x, b[j_0], b[j_1], b[j_2], b[j_3]),
        weighted_sum(w_x, c[j_0], c[j_1], c[j_2], c[j_3]),
        weighted_sum(w_x, d[j_0], d[j_1], d[j_2], d[j_3]),
    )


@loop
def _edge(outward: NDArray[np.float64], sign: float) -> tuple[float, float]:
    """Distance of the line's edge and gradient there; ``outward`` holds the profile at -1, 0, 1, … pixels."""
    count = outward.size - 3
    gradient = np.empty(count, np.float64)
    strongest = 0.0
    for j in range(count):
        gradient[j] = edge_gradient(outward[j], outward[j + 1], outward[j + 2], outward[j + 3], sign)
        if 0 < j < count - 1:
            strongest = stronger(strongest, gradient[j])
    for j in range(1, count - 1):
        if is_own_edge(gradient[j - 1], gradient[j], gradient[j + 1], strongest):
            step, value = edge_near(gradient[j - 1], gradient[j], gradient[j + 1])
            return j + 0.5 + step, value
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
        bar = bar_between(left, left_gradient, right, right_gradient, sigma)
        out[0, i], out[1, i], out[2, i], out[3, i], valid[i] = bar


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
        Aligned with the points; on the device where the block and the points lie on one.  There logarithms and
        exponentials differ in their last bits: widths agree to 1e-5 pixels.

    Examples
    --------
    A dark street five pixels wide and 100 grey levels darker than its sides.

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.points import line_points
    >>> from tilepipe_kernels.ridges.width import line_widths
    >>> image = np.full((31, 12), 200.0)
    >>> image[13:18] = 100
    >>> widths = line_widths(image, line_points(image, sigma=2.0, low=1.0), sigma=2.0, maximum_width=10)
    >>> round(float(np.median(widths.left + widths.right)), 1), abs(round(float(np.median(widths.contrast))))
    (5.1, 101)
    """
    reach = _search_reach(sigma, maximum_width)
    image, _ = fill_nodata(as_block(block), sigma)
    if on_device(image, points.row):
        return Widths(*device_form(__name__).measure(image, points, float(sigma), 1.0 if dark else -1.0, reach))
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
    """Pixels around a point on which its width depends: search, interpolation, twice the kernel radius.

    Examples
    --------
    >>> from tilepipe_kernels.ridges.width import halo
    >>> halo(3.5, maximum_width=20)
    48
    """
    return _search_reach(sigma, maximum_width) + BEYOND + SAMPLE_REACH + 1 + 2 * kernel_radius(sigma)
