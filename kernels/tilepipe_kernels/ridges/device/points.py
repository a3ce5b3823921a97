"""`line_points` on the device: one launch from the image to its points, in any order, which are then sorted."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.device import gaussian
from tilepipe_kernels.image.device.gaussian import (
    LARGEST_RADIUS,
    THREAD_COLUMNS,
    THREAD_ROWS,
    TILE_COLUMNS,
    TILE_PIXELS,
    TILE_ROWS,
    TILE_VALUES,
    derivatives_down,
    fill_tile,
)
from tilepipe_kernels.image.gaussian_passes import ZERO, kernel_radius
from tilepipe_kernels.ridges.points import ridge_at

# Of the pixels of mere noise 1 in 5 holds a point; room for more is made when they are known to be more.
EXPECTED_SHARE = 0.25


@cuda.jit(device=True)
def _keep(
    pixel: int, r_x: np.float32, r_y: np.float32, r_xx: np.float32, r_xy: np.float32, r_yy: np.float32,
    sign: np.float32, low: np.float32, counter: Any, sites: Any, values: Any,
) -> None:  # fmt: skip
    """Write the point of a pixel, if it holds one, to the next free place; count it in any case."""
    response, d_x, d_y, n_x, n_y = ridge_at(sign * r_x, sign * r_y, sign * r_xx, sign * r_xy, sign * r_yy)
    if response > ZERO and response >= low:
        place = cuda.atomic.add(counter, 0, 1)
        if place < sites.size:
            sites[place] = pixel
            values[0, place], values[1, place] = d_x, d_y
            values[2, place], values[3, place] = n_x, n_y
            values[4, place] = response


@grid
def _find(
    image: Any, mask: Any, rows: int, columns: int, taps: Any, sign: np.float32, low: np.float32, counter: Any,
    sites: Any, values: Any,
) -> None:  # fmt: skip
    tile = cuda.shared.array(TILE_VALUES, np.float32)
    radius = taps.shape[1] - 1
    top, left = cuda.blockIdx.y * (TILE_ROWS - 2 * radius), cuda.blockIdx.x * TILE_COLUMNS
    height, width = min(TILE_ROWS - 2 * radius, rows - top), min(TILE_COLUMNS, columns - left)
    y, x = cuda.threadIdx.y, cuda.threadIdx.x
    wanted = 0
    for i in range(y, height, THREAD_ROWS):
        for j in range(x, width, THREAD_COLUMNS):
            wanted |= mask[(top + i) * columns + left + j] != 0
    if not cuda.syncthreads_or(wanted):
        return
    fill_tile(tile, image, top, left, rows, columns, taps, y, x)
    cuda.syncthreads()
    for i in range(y, height, THREAD_ROWS):
        for j in range(x, width, THREAD_COLUMNS):
            pixel = (top + i) * columns + left + j
            if mask[pixel] != 0:
                at = (i + radius) * TILE_COLUMNS + j
                r_x, r_y, r_xx, r_xy, r_yy = derivatives_down(tile, TILE_PIXELS, at, TILE_COLUMNS, taps)
                _keep(pixel, r_x, r_y, r_xx, r_xy, r_yy, sign, low, counter, sites, values)


@grid
def _find_in_derivatives(
    count: int, images: Any, mask: Any, sign: np.float32, low: np.float32, counter: Any, sites: Any, values: Any
) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if mask[p] != 0:
            r_x, r_y, r_xx, r_xy, r_yy = images[0, p], images[1, p], images[2, p], images[3, p], images[4, p]
            _keep(p, r_x, r_y, r_xx, r_xy, r_yy, sign, low, counter, sites, values)


def find(image: Any, mask: Any, sigma: float, sign: np.float32, low: np.float32) -> tuple[Any, ...]:
    """Columns of `LinePoints` of a float32 device array, where the uint8 mask is not zero."""
    xp, (rows, columns), radius = namespace(image, mask), image.shape, kernel_radius(sigma)
    flat_mask = mask.reshape(-1)
    if radius <= LARGEST_RADIUS:
        flat, taps = image.reshape(-1), gaussian.device_taps(image, sigma)
        blocks, threads = gaussian.tiles(rows, columns, radius), (THREAD_COLUMNS, THREAD_ROWS)

        def launch(*places: Any) -> None:
            _find.blocks(blocks, threads, flat, flat_mask, rows, columns, taps, sign, low, *places)

    else:
        images = gaussian.derivatives(image, sigma).reshape(5, -1)

        def launch(*places: Any) -> None:
            _find_in_derivatives(image.size, images, flat_mask, sign, low, *places)

    room = int(EXPECTED_SHARE * image.size) + 1
    while True:
        counter = xp.zeros(1, xp.int32)
        sites, values = xp.empty(room, xp.int64), xp.empty((5, room), xp.float32)
        launch(counter, sites, values)
        # the number of points has to be known, for it is the length of what is given back
        found = int(counter[0])
        if found <= room:
            break
        room = found
    order = xp.argsort(sites[:found]) if found else xp.zeros(0, xp.int64)
    sites, values = sites[order], values[:, order]
    return (sites // columns).astype(xp.int32), (sites % columns).astype(xp.int32), *values
