"""Separable passes of the Gaussian derivative filters, strip by strip and cell by cell through the cache.

An image block is cut in strips of `STRIP` columns, a strip in cells of `CELL_ROWS` rows.  Per strip the
horizontal pass fills three strip buffers, row by row and only as far as the next cell reaches; the vertical
pass turns them into the five derivatives of one cell, which stay in the first-level cache until they are
used. Cells nobody asks for are skipped in both passes, which cannot change the value of any other pixel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

STRIP = 64
CELL_ROWS = 8
CELL = STRIP * CELL_ROWS
TRUNCATE = 4.0
ZERO, TWO = np.float32(0), np.float32(2)

Floats = NDArray[np.float32]
Four = tuple[np.float32, np.float32, np.float32, np.float32]


class Taps(NamedTuple):
    """One half (offsets 0 … radius) of the three symmetric or antisymmetric kernels, float32."""

    smooth: Floats
    first: Floats
    second: Floats


def kernel_radius(sigma: float) -> int:
    """Radius of the truncated Gaussian kernels in pixels: ``ceil(4 sigma)``."""
    if not (math.isfinite(sigma) and sigma > 0):
        raise ValueError(f"sigma is {sigma}: give the Gaussian scale as a positive number of pixels")
    return math.ceil(TRUNCATE * sigma)


def gaussian_taps(sigma: float) -> Taps:
    """Sample Gaussian, first and second derivative kernels that keep the sum rules of the continuous ones.

    The smoothing kernel sums to 1; the first derivative gives 1 on a ramp ``x``; the second gives 0 on
    constants and ramps and 1 on ``x² / 2``.  The half kernels are to be used as correlations: ``first``
    weighs ``f(x + k) - f(x - k)``, ``second`` weighs ``f(x + k) + f(x - k) - 2 f(x)``.

    Parameters
    ----------
    sigma
        Scale in pixels, positive.

    Returns
    -------
    Taps
        float32 arrays of length ``kernel_radius(sigma) + 1``.

    Examples
    --------
    >>> from tilepipe_kernels.image.gaussian_passes import gaussian_taps
    >>> smooth, first, second = gaussian_taps(1.0)
    >>> smooth.size  # offsets 0 to 4
    5
    >>> round(float(smooth[0] + 2 * smooth[1:].sum()), 6)
    1.0
    """
    radius = kernel_radius(sigma)
    offsets = np.arange(-radius, radius + 1, dtype=np.float64)
    smooth = np.exp(-0.5 * (offsets / sigma) ** 2)
    smooth /= smooth.sum()
    variance = (offsets**2 * smooth).sum()
    first = offsets * smooth / variance
    second = (offsets**2 - variance) * smooth
    second /= (0.5 * offsets**2 * second).sum()
    return Taps(*(kernel[radius:].astype(np.float32) for kernel in (smooth, first, second)))


@rule
def _weighted(weights: Four, values: Four) -> np.float32:
    return (weights[0] * values[0] + weights[1] * values[1]) + (weights[2] * values[2] + weights[3] * values[3])


@rule
def smooth_four(weights: Four, a: Four, b: Four) -> np.float32:
    """Part that four pairs of pixels, after (a) and before (b) the centre, give to the smoothed value."""
    return _weighted(weights, (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]))


@rule
def slope_four(weights: Four, a: Four, b: Four) -> np.float32:
    """Part that four pairs of pixels give to the first derivative."""
    return _weighted(weights, (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]))


@rule
def bend_four(weights: Four, a: Four, b: Four, centre: np.float32) -> np.float32:
    """Part that four pairs of pixels give to the second derivative."""
    twice = TWO * centre
    return _weighted(weights, (a[0] + b[0] - twice, a[1] + b[1] - twice, a[2] + b[2] - twice, a[3] + b[3] - twice))


@rule
def smooth_pair(weight: np.float32, a: np.float32, b: np.float32) -> np.float32:
    """Part of one pair."""
    return weight * (a + b)


@rule
def slope_pair(weight: np.float32, a: np.float32, b: np.float32) -> np.float32:
    """Part of one pair in the first derivative."""
    return weight * (a - b)


@rule
def bend_pair(weight: np.float32, a: np.float32, b: np.float32, centre: np.float32) -> np.float32:
    """Part of one pair in the second derivative."""
    return weight * (a + b - TWO * centre)


@loop
def _four(kernel: Floats, k: int) -> Four:
    return kernel[k], kernel[k + 1], kernel[k + 2], kernel[k + 3]


@loop
def around_row(block: Floats, row: int, column: int, radius: int, padded: Floats) -> Floats:
    """``STRIP + 2 radius`` pixels around a strip's row; border pixels of the block are replicated in ``padded``."""
    rows, columns = block.shape
    row = min(max(row, 0), rows - 1)
    begin = column - radius
    if begin >= 0 and begin + padded.size <= columns:
        return block[row, begin : begin + padded.size]
    for index in range(padded.size):
        padded[index] = block[row, min(max(begin + index, 0), columns - 1)]
    return padded


# All passes below take four taps a sweep, so that one load and store of the sums serves four taps; in `up`
# and `left` the taps lie in reverse order.


@loop
def _row_pass(padded: Floats, taps: Taps, h_0: Floats, h_1: Floats, h_2: Floats) -> None:
    """Horizontal pass over one row of a strip: smoothed, first and second derivative along the row."""
    radius = taps.smooth.size - 1
    centre = padded[radius:]
    for i in range(STRIP):
        h_0[i], h_1[i], h_2[i] = taps.smooth[0] * centre[i], ZERO, ZERO
    k = 1
    while k + 3 <= radius:
        left, right = padded[radius - k - 3 :], padded[radius + k :]
        smooth, first, second = _four(taps.smooth, k), _four(taps.first, k), _four(taps.second, k)
        for i in range(STRIP):
            a = right[i], right[i + 1], right[i + 2], right[i + 3]
            b = left[i + 3], left[i + 2], left[i + 1], left[i]
            h_0[i] += smooth_four(smooth, a, b)
            h_1[i] += slope_four(first, a, b)
            h_2[i] += bend_four(second, a, b, centre[i])
        k += 4
    while k <= radius:
        left, right = padded[radius - k :], padded[radius + k :]
        for i in range(STRIP):
            h_0[i] += smooth_pair(taps.smooth[k], right[i], left[i])
            h_1[i] += slope_pair(taps.first[k], right[i], left[i])
            h_2[i] += bend_pair(taps.second[k], right[i], left[i], centre[i])
        k += 1


@loop
def smooth_row(padded: Floats, taps: Floats, out: Floats) -> None:
    """Horizontal pass over one row of a strip, smoothing only."""
    radius = taps.size - 1
    centre = padded[radius:]
    for i in range(STRIP):
        out[i] = taps[0] * centre[i]
    for k in range(1, radius + 1):
        left, right, weight = padded[radius - k :], padded[radius + k :], taps[k]
        for i in range(STRIP):
            out[i] += smooth_pair(weight, right[i], left[i])


@loop
def smooth_cell(buffer: Floats, start: int, taps: Floats, out: Floats) -> None:
    """Smooth one cell down the columns; ``out`` holds the cell's rows one after the other."""
    radius = taps.size - 1
    centre = buffer[start:]
    for i in range(CELL):
        out[i] = taps[0] * centre[i]
    k = 1
    while k + 3 <= radius:
        up, down = buffer[start - (k + 3) * STRIP :], buffer[start + k * STRIP :]
        smooth = _four(taps, k)
        for i in range(CELL):
            a = down[i], down[i + STRIP], down[i + 2 * STRIP], down[i + 3 * STRIP]
            b = up[i + 3 * STRIP], up[i + 2 * STRIP], up[i + STRIP], up[i]
            out[i] += smooth_four(smooth, a, b)
        k += 4
    while k <= radius:
        up, down, weight = buffer[start - k * STRIP :], buffer[start + k * STRIP :], taps[k]
        for i in range(CELL):
            out[i] += smooth_pair(weight, down[i], up[i])
        k += 1


@loop
def _smooth_and_slope_cell(buffer: Floats, start: int, taps: Taps, out: Floats) -> None:
    """Smoothed (``out[:CELL]``) and first derivative (``out[CELL:]``) down the columns of one cell."""
    radius = taps.smooth.size - 1
    centre = buffer[start:]
    for i in range(CELL):
        out[i], out[i + CELL] = taps.smooth[0] * centre[i], ZERO
    k = 1
    while k + 3 <= radius:
        up, down = buffer[start - (k + 3) * STRIP :], buffer[start + k * STRIP :]
        smooth, first = _four(taps.smooth, k), _four(taps.first, k)
        for i in range(CELL):
            a = down[i], down[i + STRIP], down[i + 2 * STRIP], down[i + 3 * STRIP]
            b = up[i + 3 * STRIP], up[i + 2 * STRIP], up[i + STRIP], up[i]
            out[i] += smooth_four(smooth, a, b)
            out[i + CELL] += slope_four(first, a, b)
        k += 4
    while k <= radius:
        up, down = buffer[start - k * STRIP :], buffer[start + k * STRIP :]
        weight, slope = taps.smooth[k], taps.first[k]
        for i in range(CELL):
            out[i] += smooth_pair(weight, down[i], up[i])
            out[i + CELL] += slope_pair(slope, down[i], up[i])
        k += 1


@loop
def _slope_and_curvature_cell(buffer: Floats, start: int, taps: Taps, out: Floats) -> None:
    """First (``out[:CELL]``) and second derivative (``out[CELL:]``) down the columns of one cell."""
    radius = taps.first.size - 1
    centre = buffer[start:]
    for i in range(CELL):
        out[i], out[i + CELL] = ZERO, ZERO
    k = 1
    while k + 3 <= radius:
        up, down = buffer[start - (k + 3) * STRIP :], buffer[start + k * STRIP :]
        first, second = _four(taps.first, k), _four(taps.second, k)
        for i in range(CELL):
            a = down[i], down[i + STRIP], down[i + 2 * STRIP], down[i + 3 * STRIP]
            b = up[i + 3 * STRIP], up[i + 2 * STRIP], up[i + STRIP], up[i]
            out[i] += slope_four(first, a, b)
            out[i + CELL] += bend_four(second, a, b, centre[i])
        k += 4
    while k <= radius:
        up, down = buffer[start - k * STRIP :], buffer[start + k * STRIP :]
        slope, curvature = taps.first[k], taps.second[k]
        for i in range(CELL):
            out[i] += slope_pair(slope, down[i], up[i])
            out[i + CELL] += bend_pair(curvature, down[i], up[i], centre[i])
        k += 1


@loop
def fill_strip(block: Floats, column: int, taps: Taps, begin: int, end: int, buffers: Floats) -> None:
    """Horizontal pass over rows ``begin … end - 1``, also outside the block, of the strip at ``column``.

    ``buffers`` is (3, (rows + 2 radius) · STRIP); row ``r`` of the block lies at ``(r + radius) · STRIP``.
    """
    radius = taps.smooth.size - 1
    padded = np.empty(STRIP + 2 * radius, np.float32)
    for row in range(begin, end):
        at = (row + radius) * STRIP
        around = around_row(block, row, column, radius, padded)
        _row_pass(around, taps, buffers[0, at:], buffers[1, at:], buffers[2, at:])


@loop
def cell_derivatives(buffers: Floats, row: int, taps: Taps, out: Floats) -> None:
    """Vertical pass over the cell that starts at ``row``: r_y, r_yy, r_x, r_xy, r_xx, a CELL each."""
    start = (row + taps.smooth.size - 1) * STRIP
    _slope_and_curvature_cell(buffers[0], start, taps, out)
    _smooth_and_slope_cell(buffers[1], start, taps, out[2 * CELL :])
    smooth_cell(buffers[2], start, taps.smooth, out[4 * CELL :])


def strip_buffer(rows: int, radius: int, images: int) -> Floats:
    """Uninitialised strip buffers for a block of ``rows`` rows, shape (images, pixels)."""
    cells = -(-rows // CELL_ROWS)
    return np.empty((images, (cells * CELL_ROWS + 2 * radius) * STRIP), np.float32)
