"""`fill` on the device: every void looks along its row, whose columns know their nearest values."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.device.distance import column_offsets
from tilepipe_kernels.image.fill import is_nearer

__all__ = ["column_offsets", "fill"]


@grid
def _fill(count: int, values: Any, vertical: Any, columns: int, limit: int, filled: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        filled[p] = values[p]
        if vertical[p] == 0:
            continue
        j = p % columns
        best, row, column = np.int64(limit + 1), np.int64(0), np.int64(0)
        step = np.int64(0)
        while step * step <= best and step * step <= limit:
            for side in range(2 if step > 0 else 1):
                across = step if side else -step
                if 0 <= j + across < columns:
                    down = np.int64(vertical[p + across])
                    if is_nearer(down, across, best, row, column):
                        best, row, column = down * down + across * across, down, across
            step += 1
        if best <= limit:
            filled[p] = values[p + row * columns + column]


def fill(values: Any, vertical: Any, limit: int) -> Any:
    """Values with voids filled, see `fill.fill_voids`."""
    xp = namespace(values, vertical)
    filled = xp.empty(values.shape, values.dtype)
    flat = xp.ascontiguousarray(values).reshape(-1)
    _fill(values.size, flat, vertical.reshape(-1), values.shape[1], limit, filled.reshape(-1))
    return filled
