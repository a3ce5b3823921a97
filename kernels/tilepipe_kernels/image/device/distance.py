"""`distance` on the device: columns in bands of rows, then every pixel looks along its row."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.distance import (
    FEATURE_BITS,
    column_step,
    feature_key,
    feature_offsets,
    nearer_offset,
    shifted_key,
)

_BAND = 256
"""Rows that one thread walks; those of the cap before them tell it all that it must know."""


@grid
def _column_offsets(count: int, mask: Any, rows: int, columns: int, far: Any, offsets: Any) -> None:
    for thread in range(cuda.grid(1), count, cuda.gridsize(1)):
        j, first = thread % columns, thread // columns * _BAND
        last = min(first + _BAND, rows)
        nearest = far
        for i in range(max(0, first - far), last):
            nearest = column_step(nearest, far, mask[i * columns + j])
            if i >= first:
                offsets[i * columns + j] = -nearest
        nearest = far
        for i in range(min(rows, last + far) - 1, first - 1, -1):
            nearest = column_step(nearest, far, mask[i * columns + j])
            if i < last:
                offsets[i * columns + j] = nearer_offset(offsets[i * columns + j], nearest)


def column_offsets(mask: Any, far: np.int16) -> Any:
    """See `distance.column_offsets`."""
    xp = namespace(mask)
    rows, columns = mask.shape
    offsets = xp.empty((rows, columns), xp.int16)
    flat = xp.ascontiguousarray(mask).reshape(-1)
    _column_offsets(-(-rows // _BAND) * columns, flat, rows, columns, far, offsets.reshape(-1))
    return offsets


@grid
def _row_features(
    count: int, vertical: Any, columns: int, cap: int, squared: Any, row_offset: Any, column_offset: Any
) -> None:
    far = np.int64(cap * cap + 1) << FEATURE_BITS
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        squared[p] = row_offset[p] = column_offset[p] = 0
        if vertical[p] == 0:
            continue
        j = p % columns
        best = min(feature_key(vertical[p]), far)
        reach = np.int64(1)
        while (reach * reach) << FEATURE_BITS <= best:
            if j >= reach:
                best = min(best, shifted_key(feature_key(vertical[p - reach]), reach, -reach))
            if j + reach < columns:
                best = min(best, shifted_key(feature_key(vertical[p + reach]), reach, reach))
            reach += 1
        squared[p] = best >> FEATURE_BITS
        if best != far:
            row_offset[p], column_offset[p] = feature_offsets(best)


def nearest_background(mask: Any, cap: int) -> tuple[Any, Any, Any]:
    """See `distance.nearest_background`; the mask is uint8, 0 or 1."""
    xp = namespace(mask)
    vertical = column_offsets(mask, np.int16(cap + 1))
    squared = xp.empty(mask.shape, xp.int32)
    row_offset, column_offset = xp.empty(mask.shape, xp.int16), xp.empty(mask.shape, xp.int16)
    _row_features(
        mask.size, vertical.reshape(-1), mask.shape[1], cap, squared.reshape(-1), row_offset.reshape(-1),
        column_offset.reshape(-1),
    )  # fmt: skip
    return squared, row_offset, column_offset
