"""`growing` on the device: every rectangle is a node, joined ones are united."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.union_find import flatten, unite
from tilepipe_kernels.regions.growing import joined


@grid
def _unite_joined(
    count: int, parent: Any, values: Any, columns: int, lowest: np.float32, highest: np.float32, tolerance: np.float32
) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        value = values[p]
        if not (value >= lowest and value <= highest):
            continue
        if p % columns > 0:
            before = values[p - 1]
            if before >= lowest and before <= highest and joined(before, value, tolerance):
                unite(parent, p, p - 1)
        if p >= columns:
            above = values[p - columns]
            if above >= lowest and above <= highest and joined(above, value, tolerance):
                unite(parent, p, p - columns)


def grow(values: Any, lowest: np.float32, highest: np.float32, tolerance: np.float32) -> Any:
    """Labels of a float32 device array, as of `growing.grow_regions`."""
    xp = namespace(values)
    flat = values.reshape(-1)
    parent = xp.arange(flat.size, dtype=xp.int32)
    _unite_joined(flat.size, parent, flat, values.shape[1], lowest, highest, tolerance)
    flatten(flat.size, parent)
    belongs = (flat >= lowest) & (flat <= highest)
    # a root is the first rectangle of its region, so that counting roots numbers regions in row-major order
    number = xp.cumsum(belongs & (parent == xp.arange(flat.size, dtype=xp.int32)), dtype=xp.int32)
    return xp.where(belongs, number[parent], xp.int32(0)).reshape(values.shape)
