"""`levels` on the device: every value adds one to its bin."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.histogram import BINS, bin_of


@grid
def _count(count: int, bits: Any, values: Any, counts: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if values[p] == values[p]:
            cuda.atomic.add(counts, bin_of(bits[p], values[p]), 1)


def histogram(block: Any) -> Any:
    """See `image.histogram.histogram`."""
    xp = namespace(block)
    values = xp.ascontiguousarray(block, dtype=xp.float32).reshape(-1)
    counts = xp.zeros(BINS, xp.int64)
    _count(values.size, values.view(xp.uint32), values, counts)
    return counts
