"""Sums of floats in one order, so that they are the same bits on every machine and on every device.

Values are summed in blocks of 2048 and each block in 256 lanes, lane l adding the values l, l + 256, ...; then a
block adds its lanes in order.  A device gives every lane a thread, a CPU goes through the values as they lie.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop

BLOCK = 2048
"""Values of one partial sum: small enough for the caches, large enough to be handed to a thread of a CPU."""

LANES = 256
"""Lanes of a block; neighbours in memory are summed by neighbouring threads of a device."""

Float64 = NDArray[np.float64]


@loop
def sum_of_lanes(first: Float64, second: Float64, used: int) -> tuple[float, float]:
    """Add the lanes of two quantities in order, of which some are used, and clear them for the next block.

    Two sums at once, for each addition waits for the one before it.
    """
    one = other = 0.0
    for lane in range(min(used, first.size)):
        one += first[lane]
        other += second[lane]
        first[lane] = second[lane] = 0.0
    return one, other


@loop
def _block_sums(values: Float64, sums: Float64) -> None:
    lanes, none = np.zeros(LANES), np.zeros(LANES)
    for block in range(sums.size):
        low = block * BLOCK
        for k in range(min(BLOCK, values.size - low)):
            lanes[k % LANES] += values[low + k]
        sums[block], _ = sum_of_lanes(lanes, none, LANES)


def ordered_sum(values: NDArray[Any]) -> float:
    """Sum of real values, shape (n,), in float64 and in an order that depends on n alone; read by the host.

    Examples
    --------
    The last bits of a sum depend on its order, which is the same on every machine.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.sums import ordered_sum
    >>> ordered_sum(np.array([1e16, 1.0, -1e16, 1.0]))
    1.0
    """
    if on_device(values):
        device = device_form(__name__)
        return float(device.block_sums(values).sum())
    sums = np.empty(-(-values.size // BLOCK))
    _block_sums(np.ascontiguousarray(values, np.float64), sums)
    return float(sums.sum())
