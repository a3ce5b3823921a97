"""The checkerboard sampler of `car_model.pixel_grid` on the device: a thread for every lane of a row."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.car_model.chain import Variances
from tilepipe_kernels.car_model.pixel_grid import ROW_LANES, columns_of_colour, draw_pixel, roughness_at
from tilepipe_kernels.car_model.sweeps import NODE_STREAM
from tilepipe_kernels.core.arrays import namespace, to_host
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.sums import sum_lanes
from tilepipe_kernels.core.random import normal


@grid
def _update(
    count: int, heights: Any, present: Any, colour: int, smooth: float, fit: float, seed: np.uint64,
    sweep: np.uint64, x: Any, lanes: Any,
) -> None:  # fmt: skip
    columns = heights.shape[1]
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i = p // ROW_LANES
        parity = (i + colour) & 1
        rough = 0.0
        misfits = 0.0
        for k in range(p % ROW_LANES, columns_of_colour(columns, parity), ROW_LANES):
            j = 2 * k + parity + 1
            if not present[i + 1, j]:
                continue
            valid = (
                float(present[i, j]), float(present[i + 1, j - 1]), float(present[i + 1, j + 1]),
                float(present[i + 2, j]),
            )  # fmt: skip
            near = x[i, j], x[i + 1, j - 1], x[i + 1, j + 1], x[i + 2, j]
            height = heights[i, j - 1]
            noise = normal(seed, np.uint64(i * columns + j - 1), sweep, NODE_STREAM)
            value = draw_pixel(height, valid, near, smooth, fit, noise)
            x[i + 1, j] = value
            misfits += (value - height) * (value - height)
            if colour:
                rough += roughness_at(value, valid, near)
        lanes[p, 0] = rough
        lanes[p, 1] = misfits


class Grid:
    """State of one chain on the device."""

    def __init__(self, heights: Any, valid: Any, seed: np.uint64) -> None:
        xp = namespace(heights)
        self.heights, self.valid, self.seed = heights, valid, seed
        self.present, self.x = xp.pad(valid.astype(xp.uint8), 1), xp.pad(xp.where(valid, heights, 0.0), 1)
        self.shift, self.square = xp.zeros(heights.shape), xp.zeros(heights.shape)
        self.lanes, self.sums = xp.empty((len(heights) * ROW_LANES, 2)), xp.empty((2, len(heights), 2))

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all pixels; return roughness and misfit.

        The host adds the sums of the rows, for it draws the variances.
        """
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)
        for colour in (0, 1):
            _update(
                len(self.lanes), self.heights, self.present, colour, smooth, fit, self.seed, at, self.x, self.lanes
            )  # fmt: skip
            sum_lanes(self.lanes, self.sums[colour])
        sums = to_host(self.sums)
        roughness, misfit = (sums[0] + sums[1]).sum(axis=0)
        return float(roughness), float(misfit)

    def keep(self) -> None:
        """Add the heights to the sums of their moments."""
        xp = namespace(self.x)
        d = xp.where(self.valid, self.x[1:-1, 1:-1] - self.heights, 0.0)
        self.shift += d
        self.square += d * d
