"""`relief` on the device: whole numbers summed by atomics, which have no order.

A thread adds up a strip of one column as long as the label stays the same, so that there are few atomics.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.heights.region_means import measured_bits, ticks_above

_STRIP = 16
_NOTHING = np.int64(0)


@grid
def _sum_bits(count: int, total: Any, known: Any, labels: Any, bits: Any) -> None:
    rows, columns = labels.shape
    for strip in range(cuda.grid(1), count, cuda.gridsize(1)):
        j, top = strip % columns, strip // columns * _STRIP
        bottom = min(top + _STRIP, rows)
        label, here, number = labels[top, j], _NOTHING, _NOTHING
        for i in range(top, bottom):
            if labels[i, j] != label:
                cuda.atomic.add(total, label, here)
                cuda.atomic.add(known, label, number)
                label, here, number = labels[i, j], _NOTHING, _NOTHING
            value, one = measured_bits(bits[i, j])
            here += value
            number += one
        cuda.atomic.add(total, label, here)
        cuda.atomic.add(known, label, number)


@grid
def _sum_above(count: int, total: Any, labels: Any, ticks: Any, ground: Any, scale: float) -> None:
    rows, columns = labels.shape
    for strip in range(cuda.grid(1), count, cuda.gridsize(1)):
        j, top = strip % columns, strip // columns * _STRIP
        bottom = min(top + _STRIP, rows)
        label, here = labels[top, j], _NOTHING
        for i in range(top, bottom):
            if labels[i, j] != label:
                cuda.atomic.add(total, label, here)
                label, here = labels[i, j], _NOTHING
            if label > 0:
                here += ticks_above(ticks[i, j], ground[i, j], scale)
        cuda.atomic.add(total, label, here)


def _strips(labels: Any) -> int:
    rows, columns = labels.shape
    return int(-(-rows // _STRIP) * columns)


def sum_bits(labels: Any, bits: Any, count: int) -> tuple[Any, Any]:
    """Sums of the bits that are measures and their number, int64 (count + 1,), on the device."""
    xp = namespace(labels, bits)
    total, known = xp.zeros(count + 1, xp.int64), xp.zeros(count + 1, xp.int64)
    _sum_bits(_strips(labels), total, known, labels, bits)
    return total, known


def sum_above(labels: Any, ticks: Any, ground: Any, scale: float, count: int) -> Any:
    """Sum of the ticks above the ground, int64 (count + 1,), on the device."""
    total = namespace(labels, ticks, ground).zeros(count + 1, np.int64)
    _sum_above(_strips(labels), total, labels, ticks, ground, scale)
    return total
