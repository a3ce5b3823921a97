"""`gaussian_derivatives` on the device: one launch from the image to its derivatives, in the CPU's order of sums.

A block of threads makes the three horizontal sums of a tile in shared memory and from them the five derivatives; wide
kernels, for which a tile would mostly be margin, make the horizontal sums in the memory of the device.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.simulated import simulating
from tilepipe_kernels.image.gaussian_passes import (
    ZERO,
    bend_four,
    bend_pair,
    gaussian_taps,
    kernel_radius,
    slope_four,
    slope_pair,
    smooth_four,
    smooth_pair,
)

# A simulated thread is one of Python.  The columns are those of a warp, so that what it reads is contiguous.
TILE_ROWS, TILE_COLUMNS = (12, 4) if simulating() else (96, 32)
THREAD_ROWS, THREAD_COLUMNS = (1, 2) if simulating() else (8, 32)
TILE_PIXELS = TILE_ROWS * TILE_COLUMNS
TILE_VALUES = 3 * TILE_PIXELS

# Two thirds of a tile are margin then.
LARGEST_RADIUS = TILE_ROWS // 3

NO_DATA = np.float32(np.nan)


@cuda.jit(device=True)
def _pixel(image: Any, start: int, column: int, last: int, border: bool | None) -> np.float32:
    """Pixel of the row that begins at `start`; with a border the row's first and last pixel are replicated."""
    if border is None:
        return image[start + column]
    return image[start + min(max(column, 0), last)]


@cuda.jit(device=True)
def _four(taps: Any, kernel: int, k: int) -> Any:
    return taps[kernel, k], taps[kernel, k + 1], taps[kernel, k + 2], taps[kernel, k + 3]


@cuda.jit(device=True)
def sums_along(image: Any, start: int, column: int, last: int, taps: Any, border: bool | None) -> Any:
    """Horizontal sums at one pixel: smoothed, first and second derivative along the row."""
    radius = taps.shape[1] - 1
    centre = image[start + column]
    smooth, slope, bend = taps[0, 0] * centre, ZERO, ZERO
    k = 1
    while k + 3 <= radius:
        a = (
            _pixel(image, start, column + k, last, border), _pixel(image, start, column + k + 1, last, border),
            _pixel(image, start, column + k + 2, last, border), _pixel(image, start, column + k + 3, last, border),
        )  # fmt: skip
        b = (
            _pixel(image, start, column - k, last, border), _pixel(image, start, column - k - 1, last, border),
            _pixel(image, start, column - k - 2, last, border), _pixel(image, start, column - k - 3, last, border),
        )  # fmt: skip
        smooth += smooth_four(_four(taps, 0, k), a, b)
        slope += slope_four(_four(taps, 1, k), a, b)
        bend += bend_four(_four(taps, 2, k), a, b, centre)
        k += 4
    while k <= radius:
        after = _pixel(image, start, column + k, last, border)
        before = _pixel(image, start, column - k, last, border)
        smooth += smooth_pair(taps[0, k], after, before)
        slope += slope_pair(taps[1, k], after, before)
        bend += bend_pair(taps[2, k], after, before, centre)
        k += 1
    return smooth, slope, bend


@cuda.jit(device=True)
def _four_below(values: Any, at: int, stride: int) -> Any:
    return values[at], values[at + stride], values[at + 2 * stride], values[at + 3 * stride]


@cuda.jit(device=True)
def derivatives_down(sums: Any, plane: int, at: int, stride: int, taps: Any) -> Any:
    """r_x, r_y, r_xx, r_xy, r_yy at one pixel, from the horizontal sums: three planes of rows `stride` apart."""
    radius = taps.shape[1] - 1
    centre_0, centre_1, centre_2 = sums[at], sums[plane + at], sums[2 * plane + at]
    r_x, r_y, r_xx, r_xy, r_yy = taps[0, 0] * centre_1, ZERO, taps[0, 0] * centre_2, ZERO, ZERO
    k = 1
    while k + 3 <= radius:
        down, up = at + k * stride, at - k * stride
        smooth, slope, bend = _four(taps, 0, k), _four(taps, 1, k), _four(taps, 2, k)
        a, b = _four_below(sums, down, stride), _four_below(sums, up, -stride)
        r_y += slope_four(slope, a, b)
        r_yy += bend_four(bend, a, b, centre_0)
        a, b = _four_below(sums, plane + down, stride), _four_below(sums, plane + up, -stride)
        r_x += smooth_four(smooth, a, b)
        r_xy += slope_four(slope, a, b)
        a, b = _four_below(sums, 2 * plane + down, stride), _four_below(sums, 2 * plane + up, -stride)
        r_xx += smooth_four(smooth, a, b)
        k += 4
    while k <= radius:
        down, up = at + k * stride, at - k * stride
        r_y += slope_pair(taps[1, k], sums[down], sums[up])
        r_yy += bend_pair(taps[2, k], sums[down], sums[up], centre_0)
        r_x += smooth_pair(taps[0, k], sums[plane + down], sums[plane + up])
        r_xy += slope_pair(taps[1, k], sums[plane + down], sums[plane + up])
        r_xx += smooth_pair(taps[0, k], sums[2 * plane + down], sums[2 * plane + up])
        k += 1
    return r_x, r_y, r_xx, r_xy, r_yy


@cuda.jit(device=True)
def fill_tile(
    tile: Any, image: Any, top: int, left: int, rows: int, columns: int, taps: Any, y: int, x: int
) -> None:  # fmt: skip
    """Horizontal sums of the tile whose first result is the pixel (top, left), by the thread (y, x)."""
    radius = taps.shape[1] - 1
    inside = left >= radius and left + TILE_COLUMNS + radius <= columns
    for i in range(y, min(TILE_ROWS, rows - top + 2 * radius), THREAD_ROWS):
        start = min(max(top + i - radius, 0), rows - 1) * columns
        for j in range(x, min(TILE_COLUMNS, columns - left), THREAD_COLUMNS):
            if inside:
                smooth, slope, bend = sums_along(image, start, left + j, columns - 1, taps, None)
            else:
                smooth, slope, bend = sums_along(image, start, left + j, columns - 1, taps, True)
            at = i * TILE_COLUMNS + j
            tile[at], tile[TILE_PIXELS + at], tile[2 * TILE_PIXELS + at] = smooth, slope, bend


@grid
def _derivatives(image: Any, rows: int, columns: int, taps: Any, images: Any) -> None:
    tile = cuda.shared.array(TILE_VALUES, np.float32)
    radius = taps.shape[1] - 1
    top, left = cuda.blockIdx.y * (TILE_ROWS - 2 * radius), cuda.blockIdx.x * TILE_COLUMNS
    y, x = cuda.threadIdx.y, cuda.threadIdx.x
    fill_tile(tile, image, top, left, rows, columns, taps, y, x)
    cuda.syncthreads()
    for i in range(y, min(TILE_ROWS - 2 * radius, rows - top), THREAD_ROWS):
        for j in range(x, min(TILE_COLUMNS, columns - left), THREAD_COLUMNS):
            at = (i + radius) * TILE_COLUMNS + j
            r_x, r_y, r_xx, r_xy, r_yy = derivatives_down(tile, TILE_PIXELS, at, TILE_COLUMNS, taps)
            pixel = (top + i) * columns + left + j
            images[0, pixel], images[1, pixel], images[2, pixel] = r_x, r_y, r_xx
            images[3, pixel], images[4, pixel] = r_xy, r_yy


@grid
def _all_sums_along(count: int, image: Any, rows: int, columns: int, taps: Any, sums: Any) -> None:
    """Horizontal sums of all rows, and of as many outside the block as the kernels reach."""
    radius = taps.shape[1] - 1
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        start = min(max(p // columns - radius, 0), rows - 1) * columns
        smooth, slope, bend = sums_along(image, start, p % columns, columns - 1, taps, True)
        sums[p], sums[count + p], sums[2 * count + p] = smooth, slope, bend


@grid
def _all_derivatives_down(count: int, sums: Any, columns: int, taps: Any, images: Any) -> None:
    radius = taps.shape[1] - 1
    plane = sums.size // 3
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        r_x, r_y, r_xx, r_xy, r_yy = derivatives_down(sums, plane, p + radius * columns, columns, taps)
        images[0, p], images[1, p], images[2, p], images[3, p], images[4, p] = r_x, r_y, r_xx, r_xy, r_yy


@grid
def _smooth_along(count: int, image: Any, rows: int, columns: int, smooth: Any, sums: Any) -> None:
    """Smoothed along all rows, and as many outside the block as the kernel reaches; one pair after the other."""
    radius = smooth.size - 1
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        start, column = min(max(p // columns - radius, 0), rows - 1) * columns, p % columns
        total = smooth[0] * image[start + column]
        for k in range(1, radius + 1):
            after = _pixel(image, start, column + k, columns - 1, True)
            total += smooth_pair(smooth[k], after, _pixel(image, start, column - k, columns - 1, True))
        sums[p] = total


@grid
def _smooth_down(count: int, sums: Any, columns: int, smooth: Any, image: Any) -> None:
    radius = smooth.size - 1
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        at = p + radius * columns
        total = smooth[0] * sums[at]
        k = 1
        while k + 3 <= radius:
            a = _four_below(sums, at + k * columns, columns)
            b = _four_below(sums, at - k * columns, -columns)
            total += smooth_four((smooth[k], smooth[k + 1], smooth[k + 2], smooth[k + 3]), a, b)
            k += 4
        while k <= radius:
            total += smooth_pair(smooth[k], sums[at + k * columns], sums[at - k * columns])
            k += 1
        image[p] = total


@cuda.jit(device=True)
def _known(image: Any, at: int, belongs: bool) -> Any:
    """Value and weight of a pixel; none of a missing one, or of one that lies elsewhere."""
    value = image[at] if belongs else NO_DATA
    return (np.float64(value), 1.0) if math.isfinite(value) else (0.0, 0.0)


@grid
def _known_along(count: int, image: Any, columns: int, smooth: Any, sums: Any, weights: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        column = p % columns
        value, weight = _known(image, p, True)
        total, known = smooth[0] * value, smooth[0] * weight
        for k in range(smooth.size - 1, 0, -1):
            left, left_weight = _known(image, p - k, column >= k)
            right, right_weight = _known(image, p + k, column + k < columns)
            total += smooth_pair(smooth[k], left, right)
            known += smooth_pair(smooth[k], left_weight, right_weight)
        sums[p], weights[p] = total, known


@cuda.jit(device=True)
def _inside(values: Any, at: int) -> Any:
    return values[at] if at >= 0 and at < values.size else 0.0


@grid
def _fill(count: int, image: Any, columns: int, smooth: Any, sums: Any, weights: Any, filled: Any) -> None:
    """The mean of the known pixels around each missing one, missing where there is none."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if math.isfinite(image[p]):
            filled[p] = image[p]
            continue
        total, known = smooth[0] * sums[p], smooth[0] * weights[p]
        for k in range(smooth.size - 1, 0, -1):
            up, down = p - k * columns, p + k * columns
            total += smooth_pair(smooth[k], _inside(sums, up), _inside(sums, down))
            known += smooth_pair(smooth[k], _inside(weights, up), _inside(weights, down))
        filled[p] = np.float32(total / known) if known > 0.0 else NO_DATA


def device_taps(image: Any, sigma: float) -> Any:
    """The three kernels of `gaussian_passes.gaussian_taps` beside a device array, one each row."""
    return namespace(image).asarray(np.stack(gaussian_taps(sigma)))


def tiles(rows: int, columns: int, radius: int) -> tuple[int, int]:
    """Number of tiles along columns and along rows, as a launch wants them."""
    return -(-columns // TILE_COLUMNS), -(-rows // (TILE_ROWS - 2 * radius))


def derivatives(image: Any, sigma: float) -> Any:
    """r_x, r_y, r_xx, r_xy, r_yy of a float32 device array: one array of shape (5, rows, columns)."""
    xp, (rows, columns), radius = namespace(image), image.shape, kernel_radius(sigma)
    flat, taps, images = image.reshape(-1), device_taps(image, sigma), xp.empty((5, image.size), xp.float32)
    if radius <= LARGEST_RADIUS:
        threads = THREAD_COLUMNS, THREAD_ROWS
        _derivatives.blocks(tiles(rows, columns, radius), threads, flat, rows, columns, taps, images)
    else:
        count = (rows + 2 * radius) * columns
        sums = xp.empty(3 * count, xp.float32)
        _all_sums_along(count, flat, rows, columns, taps, sums)
        _all_derivatives_down(image.size, sums, columns, taps, images)
    return images.reshape(5, rows, columns)


def smooth(image: Any, sigma: float) -> Any:
    """`image.gaussian.gaussian_smooth` of a whole float32 device array."""
    xp, (rows, columns) = namespace(image), image.shape
    taps = device_taps(image, sigma)[0]
    sums, smoothed = xp.empty((rows + 2 * kernel_radius(sigma)) * columns, xp.float32), xp.empty(image.size, xp.float32)
    _smooth_along(sums.size, image.reshape(-1), rows, columns, taps, sums)
    _smooth_down(image.size, sums, columns, taps, smoothed)
    return smoothed.reshape(rows, columns)


def fill(image: Any, sigma: float) -> Any:
    """`image.gaussian.fill_nodata` of a float32 device array: what is missing filled."""
    xp, columns = namespace(image), image.shape[1]
    taps = device_taps(image, sigma)[0].astype(xp.float64)
    flat, filled = image.reshape(-1), xp.empty(image.size, xp.float32)
    sums, weights = xp.empty(image.size, xp.float64), xp.empty(image.size, xp.float64)
    _known_along(image.size, flat, columns, taps, sums, weights)
    _fill(image.size, flat, columns, taps, sums, weights, filled)
    return filled.reshape(image.shape)
