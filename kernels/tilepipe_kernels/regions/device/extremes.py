"""`extremes` on the device: lowest and highest values by integer atomics, which have no order."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda


@grid
def _lower_and_raise(count: int, lowest: Any, highest: Any, labels: Any, values: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        label = labels[p]
        if label == 0:
            continue
        value = values[p]
        # a look beforehand spares most of the atomics; they decide
        if value < lowest[label - 1]:
            cuda.atomic.min(lowest, label - 1, value)
        if value > highest[label - 1]:
            cuda.atomic.max(highest, label - 1, value)


def label_extremes(labels: Any, values: Any, count: int) -> tuple[Any, Any]:
    """Lowest and highest value of each label of device arrays, as of `extremes.label_extremes`."""
    xp = namespace(labels, values)
    if values.dtype not in (np.int32, np.int64):
        raise ValueError(f"on a device values must be int32 or int64, not {values.dtype}: convert them")
    limits = np.iinfo(values.dtype)
    lowest = xp.full(count, limits.max, dtype=values.dtype)
    highest = xp.full(count, limits.min, dtype=values.dtype)
    flat = xp.ascontiguousarray(labels).reshape(-1), xp.ascontiguousarray(values).reshape(-1)
    _lower_and_raise(flat[0].size, lowest, highest, *flat)
    return lowest, highest
