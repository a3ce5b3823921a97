"""Local shape of a surface of heights, which tells roofs from trees: planarity and bend.

A roof is planar around most of its pixels and straight in one direction even along its ridges and edges; a crown is
neither.  Heights are whole ticks, so every sum is exact and the measures do not depend on where a block ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.heights.ground import window_lowest

MISSING = -(2**31)
"""Tick of a pixel without a height."""

WINDOW = 2.5
"""Side of the window in metres: less than a dormer or the crown of a small tree."""

LARGEST_HALF_WIDTH = 6
LARGEST_TICK = 2**24
_FEWEST = 6
_TICKS_PER_METRE = 1000.0
_UNKNOWN_BEND = 2**31 - 1
NOWHERE = np.float32(np.inf)
"""Stands for the deviation of a window that has no plane."""

Floats = NDArray[np.float32]
Ticks = NDArray[np.int32]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceShape:
    """Shape of the surface around each pixel, float32 of the block's shape, NaN where it cannot be told.

    Attributes
    ----------
    planarity
        Standard deviation in metres of the heights about their best plane, the least of all windows that hold the
        pixel: at the edge of a roof that of a window that lies on the roof.
    bend
        Least, over the row, the column and the two diagonals, of the size of the second difference in metres,
        between the pixel and those half a window before and behind it: 0 along a ridge, an edge or a plane.
    """

    planarity: Floats
    bend: Floats


def half_width_at(resolution: float) -> int:
    """Half width in pixels of a window of `WINDOW` metres at `resolution` metres per pixel.

    Raises
    ------
    ValueError
        For a resolution that is not positive.

    Examples
    --------
    >>> from tilepipe_kernels.heights.surface_shape import half_width_at
    >>> half_width_at(0.5), half_width_at(1.0)
    (2, 1)
    """
    if not (math.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres per pixel, not {resolution}")
    return min(LARGEST_HALF_WIDTH, max(1, round((WINDOW / resolution - 1) / 2)))


def halo(half_width: int = 2) -> int:
    """Pixels around a block that `surface_shape` can depend on: the windows that hold a pixel reach two half widths.

    Examples
    --------
    >>> from tilepipe_kernels.heights.surface_shape import halo
    >>> halo(half_width=2)
    4
    """
    return 2 * half_width


# ------------------------------------------------------------------------------------------ plane of a window


@rule
def plane_deviation(n: int, x: int, y: int, z: int, xx: int, xy: int, yy: int, xz: int, yz: int, zz: int) -> float:
    """Standard deviation about the least-squares plane, from sums over n points.

    The moments about the mean, times n, are whole numbers and exact; NaN for points on a line or fewer than six.
    """
    cxx, cxy, cyy = n * xx - x * x, n * xy - x * y, n * yy - y * y
    determinant = float(cxx * cyy - cxy * cxy)
    if n < _FEWEST or determinant <= 0.0:
        return np.nan
    a, b, c = float(cxx), float(cxy), float(cyy)
    p, q = float(n * xz - x * z), float(n * yz - y * z)
    right, down = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    squares = (float(n * zz - z * z) - (right * p + down * q)) / n
    return math.sqrt(max(squares, 0.0) / (n - 3))


@rule
def plane_deviation_metres(
    n: int, x: int, y: int, z: int, xx: int, xy: int, yy: int, xz: int, yz: int, zz: int
) -> np.float32:
    """`plane_deviation` in metres, `NOWHERE` where it is not known."""
    deviation = np.float32(plane_deviation(n, x, y, z, xx, xy, yy, xz, yz, zz) / _TICKS_PER_METRE)
    return deviation if deviation < NOWHERE else NOWHERE


@loop
def _add_row(sums: Counts, row: Ticks, down: int, sign: int) -> None:
    """Add (or take) a row `down` rows below the centre to the sums n, y, z, yy, yz, zz of each column."""
    for j in range(row.size):
        present = np.int64(sign) if row[j] != MISSING else np.int64(0)
        height = np.int64(row[j])
        z = present * height
        sums[0, j] += present
        sums[1, j] += present * down
        sums[2, j] += z
        sums[3, j] += present * down * down
        sums[4, j] += z * down
        sums[5, j] += z * height


@loop
def _move_down(sums: Counts) -> None:
    """Count rows from a centre one further down: y becomes y - 1."""
    for j in range(sums.shape[1]):
        sums[3, j] += sums[0, j] - 2 * sums[1, j]
        sums[1, j] -= sums[0, j]
        sums[4, j] -= sums[2, j]


@loop
def _fit_row(deviation: Floats, row: Ticks, sums: Counts, half_width: int) -> None:
    """Plane of the window around each pixel of a row; `sums` has `half_width` empty columns on both sides."""
    n = x = y = z = xx = xy = yy = xz = yz = zz = np.int64(0)
    r = half_width
    for j in range(-2 * r, row.size):
        # Entering at x = r; what was there has moved one to the left, and out below -r.
        if j > 0:
            k = j - 1
            n, x, xx = n - sums[0, k], x + r * sums[0, k], xx - r * r * sums[0, k]
            y, xy, yy = y - sums[1, k], xy + r * sums[1, k], yy - sums[3, k]
            z, xz, yz, zz = z - sums[2, k], xz + r * sums[2, k], yz - sums[4, k], zz - sums[5, k]
        xx += n - 2 * x
        x -= n
        xy -= y
        xz -= z
        k = j + 2 * r
        n, x, xx = n + sums[0, k], x + r * sums[0, k], xx + r * r * sums[0, k]
        y, xy, yy = y + sums[1, k], xy + r * sums[1, k], yy + sums[3, k]
        z, xz, yz, zz = z + sums[2, k], xz + r * sums[2, k], yz + sums[4, k], zz + sums[5, k]
        if j >= 0 and row[j] != MISSING:
            deviation[j] = plane_deviation_metres(n, x, y, z, xx, xy, yy, xz, yz, zz)


@loop
def _fit(deviation: Floats, ticks: Ticks, half_width: int) -> None:
    rows, columns = ticks.shape
    sums = np.zeros((6, columns + 2 * half_width), np.int64)
    inner = sums[:, half_width : half_width + columns]
    for i in range(-half_width, rows):
        if i - 1 - half_width >= 0:
            _add_row(inner, ticks[i - 1 - half_width], -half_width, -1)
        _move_down(inner)
        if i + half_width < rows:
            _add_row(inner, ticks[i + half_width], half_width, 1)
        if i >= 0:
            _fit_row(deviation[i], ticks[i], sums, half_width)


# ------------------------------------------------------------------------------------------ bend


@rule
def second_difference(before: np.int32, here: np.int32, behind: np.int32) -> int:
    """Size of the second difference of three ticks; more than any real one where a neighbour is missing."""
    size = abs(np.int64(before) + np.int64(behind) - 2 * np.int64(here))
    return int(size if (before != MISSING) & (behind != MISSING) else np.int64(_UNKNOWN_BEND))


@rule
def least_bend(
    here: np.int32, west: np.int32, east: np.int32, north: np.int32, south: np.int32,
    northwest: np.int32, southeast: np.int32, northeast: np.int32, southwest: np.int32,
) -> np.float32:  # fmt: skip
    """Least second difference in metres over row, column and diagonals; NaN where none is known."""
    straight = min(second_difference(west, here, east), second_difference(north, here, south))
    diagonal = min(second_difference(northwest, here, southeast), second_difference(northeast, here, southwest))
    least = min(straight, diagonal)
    known = (here != MISSING) & (least != _UNKNOWN_BEND)
    return np.float32(least) / np.float32(_TICKS_PER_METRE) if known else np.float32(np.nan)


@loop
def _bend_row(
    bend: Floats, here: Ticks, west: Ticks, east: Ticks, north: Ticks, south: Ticks,
    northwest: Ticks, southeast: Ticks, northeast: Ticks, southwest: Ticks,
) -> None:  # fmt: skip
    for j in range(bend.size):
        bend[j] = least_bend(
            here[j], west[j], east[j], north[j], south[j], northwest[j], southeast[j], northeast[j], southwest[j]
        )


@loop
def _bend(bend: Floats, padded: Ticks, lag: int) -> None:
    """Bend at every pixel; `padded` holds the block and `lag` missing pixels on every side."""
    rows, columns = bend.shape
    for i in range(rows):
        above, here, below = padded[i], padded[i + lag], padded[i + 2 * lag]
        _bend_row(
            bend[i], here[lag : lag + columns], here[:columns], here[2 * lag :], above[lag : lag + columns],
            below[lag : lag + columns], above[:columns], below[2 * lag :], above[2 * lag :], below[:columns],
        )  # fmt: skip


# ------------------------------------------------------------------------------------------ all measures


def surface_shape(ticks: NDArray[np.int32], *, half_width: int = 2) -> SurfaceShape:
    """Shape of the surface around each pixel.

    Parameters
    ----------
    ticks
        Heights in millimetres, int32, shape (rows, columns), of a size below 2²⁴; `MISSING` is nodata and takes no
        part.
    half_width
        The window has 2 half_width + 1 pixels a side; 1 to 6.

    Returns
    -------
    SurfaceShape
        Arrays of a device stay there.

    Raises
    ------
    ValueError
        For ticks that are not two-dimensional int32 or too large, or a window out of range.

    Examples
    --------
    A pitched roof is planar and straight, a crown (here noise of 1 m) neither.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.random import normals
    >>> from tilepipe_kernels.heights.surface_shape import surface_shape
    >>> roof = np.tile(1000 * np.array([3, 4, 5, 6, 7, 6, 5, 4, 3]), (9, 1)).astype(np.int32)
    >>> crown = (1000 * normals(np.arange(81).reshape(9, 9), seed=0)).astype(np.int32)
    >>> for ticks in (roof, crown):
    ...     shape = surface_shape(ticks)
    ...     print(f"planarity {np.nanmedian(shape.planarity):.1f} m, bend {np.nanmedian(shape.bend):.1f} m")
    planarity 0.0 m, bend 0.0 m
    planarity 0.9 m, bend 1.0 m
    """
    xp = namespace(ticks)
    array = xp.ascontiguousarray(ticks)
    if array.ndim != 2 or array.dtype != np.int32:
        raise ValueError(f"ticks must be a two-dimensional int32 array, not {array.dtype} of shape {array.shape}")
    if not 1 <= half_width <= LARGEST_HALF_WIDTH:
        raise ValueError(f"half_width must be 1 to {LARGEST_HALF_WIDTH} pixels, not {half_width}")
    present = array != MISSING
    # on a device this is the one scalar read before the work: sums of what is too large would not be exact
    if array.size and int(xp.max(xp.abs(xp.where(present, array, np.int32(0))))) >= LARGEST_TICK:
        raise ValueError(f"ticks must lie within {LARGEST_TICK}; subtract a reference height")
    padded = xp.pad(array, half_width, constant_values=MISSING)
    if on_device(array):
        deviation, bend = device_form(__name__).measure(padded, array.shape, half_width)
    else:
        deviation, bend = np.full(array.shape, NOWHERE), np.empty(array.shape, np.float32)
        _fit(deviation, array, half_width)
        _bend(bend, padded, half_width)
    planarity = window_lowest(deviation, half_width)
    return SurfaceShape(xp.where(present & (planarity < NOWHERE), planarity, np.float32(np.nan)), bend)
