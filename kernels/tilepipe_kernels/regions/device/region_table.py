"""`region_table` on the device: a thread for each piece of a run adds up what it is made of, in whole numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.regions.region_table import contact_key, grey_units

_PIECE = 32
"""Longest piece of a run that one thread walks."""


@grid
def _measure(
    size: int, labels: Any, values: Any, rows: int, columns: int, top_border: int, bottom_border: int,
    left_border: int, right_border: int, units: np.float32, count: Any, first: Any, horizontal: Any, vertical: Any,
    grey: Any, top: Any, left: Any, bottom: Any, right: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), size, cuda.gridsize(1)):
        label = labels[p]
        j = p % columns
        begins = j == 0 or labels[p - 1] != label
        if label == 0 or not (begins or j % _PIECE == 0):
            continue
        i = p // columns
        k = label - 1
        cracks = sides = total = length = 0
        at = p
        while True:
            total += grey_units(values[at], units)
            length += 1
            if i > 0:
                cracks += labels[at - columns] != label
            else:
                cracks += top_border
            if i + 1 < rows:
                cracks += labels[at + columns] != label
            else:
                cracks += bottom_border
            last = j + length == columns
            if last or labels[at + 1] != label:
                sides += right_border if last else 1
                break
            if (j + length) % _PIECE == 0:
                break
            at += 1
        if begins:
            sides += left_border if j == 0 else 1
        cuda.atomic.add(count, k, length)
        cuda.atomic.add(grey, k, total)
        cuda.atomic.add(horizontal, k, cracks)
        cuda.atomic.add(vertical, k, sides)
        cuda.atomic.min(first, k, p)
        cuda.atomic.min(top, k, i)
        cuda.atomic.max(bottom, k, i)
        cuda.atomic.min(left, k, j)
        cuda.atomic.max(right, k, j + length - 1)


def measure(labels: Any, values: Any, count: int, borders: tuple[bool, bool, bool, bool], units: np.float32) -> Any:
    """The nine columns of a `region_table.RegionTable`."""
    xp = namespace(labels, values)
    rows, columns = labels.shape
    # count, first, horizontal, vertical, grey, top, left, bottom, right
    starts = (0, labels.size, 0, 0, 0, rows, columns, -1, -1)
    table = [xp.full(count, start, xp.int64) for start in starts]
    flags = (int(border) for border in borders)
    _measure(labels.size, labels.reshape(-1), values.reshape(-1), rows, columns, *flags, units, *table)
    return table


@grid
def _contact_keys(count: int, labels: Any, flagged: Any, rows: int, columns: int, keys: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        a = labels[p]
        below = labels[p + columns] if p // columns + 1 < rows else a
        after = labels[p + 1] if p % columns + 1 < columns else a
        keys[2 * p] = contact_key(a, below, 0) if below != a and flagged[a] and flagged[below] else 0
        keys[2 * p + 1] = contact_key(a, after, 1) if after != a and flagged[a] and flagged[after] else 0


def contact_keys(labels: Any, flagged: Any) -> Any:
    """Keys of all sides between two different flagged labels; entry 0 of ``flagged`` is False."""
    xp = namespace(labels, flagged)
    keys = xp.empty(2 * labels.size, xp.int64)
    _contact_keys(labels.size, labels.reshape(-1), flagged, *labels.shape, keys)
    return keys[keys != 0]
