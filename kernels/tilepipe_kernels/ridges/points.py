"""Sub-pixel line points of one Gaussian scale: where the first directional derivative across a line vanishes.

Steger, "An Unbiased Detector of Curvilinear Structures", IEEE PAMI 20(2), 1998, Section 3.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image.gaussian import as_block, fill_nodata
from tilepipe_kernels.image.gaussian_passes import (
    CELL,
    CELL_ROWS,
    STRIP,
    Floats,
    Taps,
    cell_derivatives,
    fill_strip,
    gaussian_taps,
    kernel_radius,
    strip_buffer,
)

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)

# Two neighbouring pixels may each place a line just inside the other; without the margin it would break.
REACH = np.float32(0.6)


@dataclass(frozen=True)
class LinePoints:
    """Line points in row-major order; arrays of equal length, all on the host or all on a device.

    Attributes
    ----------
    row, col
        Pixel of the point in the block, int32.
    dx, dy
        Sub-pixel position minus pixel centre along columns and rows, float32 in [-0.6, 0.6] pixels.
    nx, ny
        Unit normal of the line, float32, with ``nx > 0``, or ``nx == 0`` and ``ny > 0``.
    response
        Magnitude of the second derivative along the normal, float32, grey per pixel².
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    dx: Floats
    dy: Floats
    nx: Floats
    ny: Floats
    response: Floats

    def __len__(self) -> int:
        return int(self.row.size)

    def take(self, selection: Any) -> LinePoints:
        """Return the points that a slice, bool mask or increasing index array selects."""
        return LinePoints(**{name: values[selection] for name, values in vars(self).items()})


@rule
def ridge_at(
    r_x: np.float32, r_y: np.float32, r_xx: np.float32, r_xy: np.float32, r_yy: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Dark-line point of one site: (response, dx, dy, nx, ny); response 0 where the site holds none.

    The Hessian's eigenvalue largest in magnitude must be positive (a valley); its eigenvector is the normal
    ``n``. ``n' H n`` in the denominator of Steger's t (Eq. 17) is that eigenvalue.
    """
    mean = HALF * (r_xx + r_yy)
    half = HALF * (r_xx - r_yy)
    root = np.float32(math.sqrt(half * half + r_xy * r_xy))
    curvature = mean + root
    # Of the two forms of the eigenvector, the one that adds numbers of equal sign: no cancellation.
    steep = half < ZERO
    a = abs(r_xy) if steep else half + root
    b = root - half if steep else r_xy
    b = -b if steep and r_xy < ZERO else b
    length = np.float32(math.sqrt(a * a + b * b))
    exists = mean >= ZERO and length > ZERO
    inverse = ONE / (length if exists else ONE)
    n_x, n_y = a * inverse, b * inverse
    t = -(r_x * n_x + r_y * n_y) / (curvature if exists else ONE)
    d_x, d_y = t * n_x, t * n_y
    inside = exists and abs(d_x) <= REACH and abs(d_y) <= REACH
    return (curvature if inside else ZERO), d_x, d_y, n_x, n_y


@loop
def _cell_responses(cell: Floats, sign: np.float32, low: np.float32, response: Floats) -> np.int32:
    """Responses of a cell's sites, 0 where there is none of at least ``low``; returns how many there are."""
    found = np.int32(0)
    for i in range(CELL):
        r_y, r_yy, r_x = sign * cell[i], sign * cell[i + CELL], sign * cell[i + 2 * CELL]
        r_xy, r_xx = sign * cell[i + 3 * CELL], sign * cell[i + 4 * CELL]
        value = ridge_at(r_x, r_y, r_xx, r_xy, r_yy)[0]
        passes = value >= low
        response[i] = value if passes else ZERO
        found += np.int32(1) if passes else np.int32(0)
    return found


@loop
def _points_strip(
    block: Floats,
    mask: NDArray[np.uint8],
    column: int,
    taps: Taps,
    sign: np.float32,
    low: np.float32,
    buffers: Floats,
    places: NDArray[np.int32],
    values: Floats,
) -> int:
    """Find the points of one strip in row-major order; returns their number."""
    rows, columns = block.shape
    radius = taps.smooth.size - 1
    width = min(STRIP, columns - column)
    cell, response = np.empty(5 * CELL, np.float32), np.empty(CELL, np.float32)
    count, done = 0, -radius
    for row in range(0, rows, CELL_ROWS):
        stop = min(row + CELL_ROWS, rows)
        if not _any_in_cell(mask, row, stop, column, width):
            continue
        fill_strip(block, column, taps, max(done, row - radius), row + CELL_ROWS + radius, buffers)
        done = row + CELL_ROWS + radius
        cell_derivatives(buffers, row, taps, cell)
        if _cell_responses(cell, sign, low, response) == 0:
            continue
        for r in range(row, stop):
            for c in range(width):
                i = (r - row) * STRIP + c
                if response[i] > ZERO and mask[r, column + c] != 0:
                    r_y, r_yy, r_x = sign * cell[i], sign * cell[i + CELL], sign * cell[i + 2 * CELL]
                    r_xy, r_xx = sign * cell[i + 3 * CELL], sign * cell[i + 4 * CELL]
                    curvature, d_x, d_y, n_x, n_y = ridge_at(r_x, r_y, r_xx, r_xy, r_yy)
                    places[0, count], places[1, count] = r, column + c
                    values[0, count], values[1, count] = d_x, d_y
                    values[2, count], values[3, count] = n_x, n_y
                    values[4, count] = curvature
                    count += 1
    return count


@loop
def _any_in_cell(mask: NDArray[np.uint8], row: int, stop: int, column: int, width: int) -> bool:
    """Whether the mask has a nonzero pixel in a cell."""
    for r in range(row, stop):
        line = mask[r, column : column + width]
        some = np.uint8(0)
        for c in range(width):
            some |= line[c]
        if some != 0:
            return True
    return False


def line_points(
    block: NDArray[Any], sigma: float, *, low: float, mask: NDArray[Any] | None = None, dark: bool = True
) -> LinePoints:
    """Line points of an image at one scale (Steger 1998, Section 3.2).

    A pixel holds a point when its Hessian's eigenvalue largest in magnitude has the sign of the line, and the
    zero of the first directional derivative along the normal lies in the pixel or at most 0.1 pixels outside.

    Parameters
    ----------
    block
        Image (rows, columns) of real numbers; NaN = nodata, filled smoothly before filtering, never a point.
    sigma
        Gaussian scale in pixels; at least half the line width / sqrt(3), see `sigma_for_width`.
    low
        Smallest second directional derivative of a point, grey per pixel², positive.
    mask
        Points are accepted only where it is nonzero; bool or integers, shape of the block.  None: everywhere.
    dark
        True for lines darker than both sides, False for brighter ones.

    Returns
    -------
    LinePoints
        Sorted row-major; on the device where the block (and the mask) lies on one.  There they are the same to
        the bit, except that what is filled for nodata may be rounded otherwise.

    Raises
    ------
    ValueError
        If the block is no image, sigma or low not positive, or the mask of another shape.

    Examples
    --------
    A dark line one pixel wide in row 8 of a bright image: a point in each of its columns.

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.points import line_points
    >>> image = np.full((17, 20), 200.0)
    >>> image[8] = 100
    >>> points = line_points(image, sigma=1.2, low=5.0)
    >>> np.unique(points.row).tolist(), points.row.size, float(abs(points.dy).max()) < 1e-3
    ([8], 20, True)
    """
    if not low > 0:
        raise ValueError(f"low is {low}: give a positive threshold in grey per pixel²")
    image, valid = fill_nodata(as_block(block), sigma)
    rows, columns = image.shape
    accepted = _as_mask(mask, image)
    if valid is not None:
        accepted = accepted & valid.view(np.uint8)
    if on_device(image):
        sign = np.float32(1 if dark else -1)
        return LinePoints(*device_form(__name__).find(image, accepted, sigma, sign, np.float32(low)))
    buffers = strip_buffer(rows, kernel_radius(sigma), 3)
    # The most points a strip can have: the untouched part of these arrays never becomes real memory.
    places, values = np.empty((2, rows * STRIP), np.int32), np.empty((5, rows * STRIP), np.float32)
    taps, sign = gaussian_taps(sigma), np.float32(1 if dark else -1)
    found: list[tuple[NDArray[np.int32], Floats]] = []
    for column in range(0, columns, STRIP):
        count = _points_strip(image, accepted, column, taps, sign, np.float32(low), buffers, places, values)
        found.append((places[:, :count].copy(), values[:, :count].copy()))
    all_places = np.concatenate([strip[0] for strip in found], axis=1)
    all_values = np.concatenate([strip[1] for strip in found], axis=1)
    order = np.argsort(all_places[0], kind="stable")
    return LinePoints(*all_places[:, order], *all_values[:, order])


def _as_mask(mask: NDArray[Any] | None, image: Floats) -> NDArray[np.uint8]:
    if mask is None:
        everywhere: NDArray[np.uint8] = namespace(image).ones(image.shape, np.uint8)
        return everywhere
    array = mask if on_device(mask) else np.asarray(mask)
    xp = namespace(image, array)
    if array.shape != image.shape:
        raise ValueError(f"mask has shape {array.shape}, block {image.shape}: they must be equal")
    if array.dtype not in (np.bool_, np.uint8):
        array = array != 0
    accepted: NDArray[np.uint8] = xp.ascontiguousarray(array).view(np.uint8)
    return accepted


def halo(sigma: float) -> int:
    """Pixels around a block on which its points depend: kernel radius, twice for the filling of nodata.

    Examples
    --------
    >>> from tilepipe_kernels.ridges.points import halo
    >>> halo(3.5)
    28
    """
    return 2 * kernel_radius(sigma)
