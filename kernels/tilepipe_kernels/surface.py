"""Local shape of a surface of heights, which tells roofs from trees: roughness, slope, depth and bend.

A roof is planar around most of its pixels and straight in one direction even along its ridges and edges; a crown is
neither.  Heights are whole ticks, so every sum is exact and the measures do not depend on where a block ends; sums
over regions are whole numbers too and add up over tiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .ground import window_highest, window_lowest

MISSING = -(2**31)
"""Tick of a pixel without a height."""

LARGEST_HALF_WIDTH = 6
LARGEST_TICK = 2**24
_FEWEST = 6
_TICKS_PER_METRE = 1000.0
_UNKNOWN_BEND = 2**31 - 1
_NOWHERE = np.float32(np.inf)

Floats = NDArray[np.float32]
Ticks = NDArray[np.int32]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceShape:
    """Shape of the surface around each pixel, float32 of the block's shape, NaN where it cannot be told.

    Attributes
    ----------
    roughness
        Standard deviation in metres of the heights in the window about their best plane.
    planarity
        The least `roughness` of all windows that hold the pixel, in metres: at the edge of a roof that of a window
        that lies on the roof.
    slope
        Slope of the best plane, metres per metre.
    depth
        Highest minus lowest height in the window, in metres: how far a gap in a crown lets one see down.
    bend
        Least, over the row, the column and the two diagonals, of the size of the second difference in metres,
        between the pixel and those half a window before and behind it: 0 along a ridge, an edge or a plane.
    """

    roughness: Floats
    planarity: Floats
    slope: Floats
    depth: Floats
    bend: Floats


def halo(half_width: int = 2) -> int:
    """Pixels around a block that `surface_shape` can depend on: the windows that hold a pixel reach two half widths."""
    return 2 * half_width


# ------------------------------------------------------------------------------------------ plane of a window


@rule
def plane_fit(
    n: int, x: int, y: int, z: int, xx: int, xy: int, yy: int, xz: int, yz: int, zz: int
) -> tuple[float, float]:
    """Standard deviation about the least-squares plane, and its steepest slope, from sums over n points.

    The moments about the mean, times n, are whole numbers and exact; NaN for points on a line or fewer than six.
    """
    cxx, cxy, cyy = n * xx - x * x, n * xy - x * y, n * yy - y * y
    determinant = float(cxx * cyy - cxy * cxy)
    if n < _FEWEST or determinant <= 0.0:
        return np.nan, np.nan
    a, b, c = float(cxx), float(cxy), float(cyy)
    p, q = float(n * xz - x * z), float(n * yz - y * z)
    right, down = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    squares = (float(n * zz - z * z) - (right * p + down * q)) / n
    return math.sqrt(max(squares, 0.0) / (n - 3)), math.sqrt(right * right + down * down)


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
def _fit_row(roughness: Floats, slope: Floats, row: Ticks, sums: Counts, half_width: int, run: float) -> None:
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
            deviation, gradient = plane_fit(n, x, y, z, xx, xy, yy, xz, yz, zz)
            roughness[j] = deviation / _TICKS_PER_METRE
            slope[j] = gradient / run


@loop
def _fit(roughness: Floats, slope: Floats, ticks: Ticks, half_width: int, run: float) -> None:
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
            _fit_row(roughness[i], slope[i], ticks[i], sums, half_width, run)


# ------------------------------------------------------------------------------------------ bend


@rule
def second_difference(before: int, here: int, behind: int) -> int:
    """Size of the second difference of three ticks; more than any real one where a neighbour is missing."""
    size = abs(np.int64(before) + np.int64(behind) - 2 * np.int64(here))
    return int(size if (before != MISSING) & (behind != MISSING) else np.int64(_UNKNOWN_BEND))


@loop
def _bend_row(
    bend: Floats, here: Ticks, west: Ticks, east: Ticks, north: Ticks, south: Ticks,
    northwest: Ticks, southeast: Ticks, northeast: Ticks, southwest: Ticks,
) -> None:  # fmt: skip
    for j in range(bend.size):
        tick = here[j]
        straight = min(second_difference(west[j], tick, east[j]), second_difference(north[j], tick, south[j]))
        diagonal = min(
            second_difference(northwest[j], tick, southeast[j]), second_difference(northeast[j], tick, southwest[j])
        )
        least = min(straight, diagonal)
        known = (tick != MISSING) & (least != _UNKNOWN_BEND)
        bend[j] = np.float32(least) / np.float32(_TICKS_PER_METRE) if known else np.float32(np.nan)


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


def surface_shape(ticks: NDArray[np.int32], *, resolution: float, half_width: int = 2) -> SurfaceShape:
    """Shape of the surface around each pixel.

    Parameters
    ----------
    ticks
        Heights in millimetres, int32, shape (rows, columns), of a size below 2²⁴; `MISSING` is nodata and takes no
        part.
    resolution
        Side of a pixel in metres.
    half_width
        The window has 2 half_width + 1 pixels a side; 1 to 6.

    Raises
    ------
    ValueError
        For ticks that are not two-dimensional int32 or too large, a window or resolution out of range.
    """
    array = np.ascontiguousarray(ticks)
    if array.ndim != 2 or array.dtype != np.int32:
        raise ValueError(f"ticks must be a two-dimensional int32 array, not {array.dtype} of shape {array.shape}")
    if not 1 <= half_width <= LARGEST_HALF_WIDTH:
        raise ValueError(f"half_width must be 1 to {LARGEST_HALF_WIDTH} pixels, not {half_width}")
    if not (math.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres per pixel, not {resolution}")
    present = array != MISSING
    if array.size and (array.max() >= LARGEST_TICK or array.min(where=present, initial=0) <= -LARGEST_TICK):
        raise ValueError(f"ticks must lie within {LARGEST_TICK}; subtract a reference height")
    roughness, slope = np.full(array.shape, np.nan, np.float32), np.full(array.shape, np.nan, np.float32)
    _fit(roughness, slope, array, half_width, resolution * _TICKS_PER_METRE)
    known = np.where(np.isnan(roughness), _NOWHERE, roughness)
    planarity = window_lowest(known, half_width)
    # Ticks this small are exact in float32.
    heights = array.astype(np.float32)
    highest = window_highest(np.where(present, heights, -_NOWHERE), half_width)
    lowest = window_lowest(np.where(present, heights, _NOWHERE), half_width)
    bend = np.empty(array.shape, np.float32)
    _bend(bend, np.pad(array, half_width, constant_values=MISSING), half_width)
    nowhere = np.float32(np.nan)
    return SurfaceShape(
        roughness,
        np.where(present & (planarity < _NOWHERE), planarity, nowhere),
        slope,
        np.where(present, (highest - lowest) / np.float32(_TICKS_PER_METRE), nowhere),
        bend,
    )


# ------------------------------------------------------------------------------------------ regions

CAPS = {"height": 1000.0, "roughness": 1.0, "planarity": 1.0, "slope": 3.0, "depth": 10.0, "bend": 0.5}
"""A larger measure of a pixel counts as this much in the sums of its region, so that a chimney does not rule a roof."""


@dataclass(frozen=True)
class RegionFeatures:
    """Sums over the regions 1..n of one block, one int64 element per region, so that parts add up.

    Attributes
    ----------
    count
        Number of pixels.
    sums
        For each name of `CAPS` the sum over the pixels that know the measure of ``rint(1000 min(measure, cap))``.
    known
        For each name of `CAPS` the number of those pixels.
    """

    count: Counts
    sums: dict[str, Counts]
    known: dict[str, Counts]

    def mean(self, name: str) -> NDArray[np.float64]:
        """Mean of a capped measure per region, in its own unit; NaN where no pixel knows it."""
        known = self.known[name]
        mean: NDArray[np.float64] = np.full(known.shape, np.nan)
        np.divide(self.sums[name], 1000.0 * known, out=mean, where=known > 0)
        return mean


@loop
def _add_up(total: Counts, known: Counts, labels: NDArray[np.int32], values: Floats, cap: float) -> None:
    for i in range(labels.shape[0]):
        row, measures = labels[i], values[i]
        for j in range(row.size):
            value = np.float64(measures[j])
            if row[j] > 0 and abs(value) < np.inf:
                total[row[j] - 1] += np.int64(np.rint(1000.0 * min(max(value, -cap), cap)))
                known[row[j] - 1] += 1


def region_features(
    labels: NDArray[np.int32], height: NDArray[np.float32], shape: SurfaceShape, count: int
) -> RegionFeatures:
    """Add up the shape of the surface over regions.

    Parameters
    ----------
    labels
        int32, shape (rows, columns): 1..count, 0 belongs to no region.
    height
        Height above ground in metres, float32, same shape; NaN is nodata.
    shape
        What `surface_shape` gave for the same pixels.
    count
        Number of regions.

    Raises
    ------
    ValueError
        For shapes that differ or labels out of range.
    """
    labels = np.ascontiguousarray(labels, dtype=np.int32)
    measures = {"height": height, "roughness": shape.roughness, "planarity": shape.planarity}
    measures |= {"slope": shape.slope, "depth": shape.depth, "bend": shape.bend}
    if labels.ndim != 2 or any(values.shape != labels.shape for values in measures.values()):
        raise ValueError(f"labels, height and shape must have one shape (rows, columns), not {labels.shape} and others")
    if labels.size and not (labels.min() >= 0 and labels.max() <= count):
        raise ValueError(f"labels must lie in 0..{count}")
    sums = {name: np.zeros(count, np.int64) for name in CAPS}
    known = {name: np.zeros(count, np.int64) for name in CAPS}
    for name, values in measures.items():
        _add_up(sums[name], known[name], labels, np.ascontiguousarray(values, np.float32), CAPS[name])
    return RegionFeatures(np.bincount(labels.ravel(), minlength=count + 1)[1:].astype(np.int64), sums, known)
