"""`sums` on the device: a thread for every lane, then one for every block."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, to_host
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.sums import BLOCK, LANES


@grid
def _sum_lanes(count: int, lanes: Any, width: int, quantities: int, sums: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        block, quantity = p // quantities, p % quantities
        total = 0.0
        for lane in range(block * width, (block + 1) * width):
            total += lanes[lane, quantity]
        sums[block, quantity] = total


def sum_lanes(lanes: Any, sums: Any) -> None:
    """Add the lanes of every block, float64 (blocks * lanes, quantities), into ``sums``, (blocks, quantities)."""
    blocks, quantities = sums.shape
    _sum_lanes(sums.size, lanes, len(lanes) // max(blocks, 1), quantities, sums)


@grid
def _fill_lanes(count: int, values: Any, lanes: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        low = p // LANES * BLOCK
        total = 0.0
        for k in range(low + p % LANES, min(low + BLOCK, values.size), LANES):
            total += values[k]
        lanes[p, 0] = total


def block_sums(values: Any) -> NDArray[np.float64]:
    """Sums of the blocks of a device array; they come to the host, two thousand times fewer than the values."""
    xp = namespace(values)
    values = xp.ascontiguousarray(values, dtype=xp.float64)
    blocks = -(-values.size // BLOCK)
    lanes, sums = xp.empty((blocks * LANES, 1)), xp.empty((blocks, 1))
    _fill_lanes(blocks * LANES, values, lanes)
    sum_lanes(lanes, sums)
    return to_host(sums)[:, 0]
