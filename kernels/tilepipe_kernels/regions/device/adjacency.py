"""`adjacency` on the device: the first crack of each straight run follows it to its end, and runs are sorted."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.regions.adjacency import Contacts, continued, parted

_OUTSIDE = np.int32(0)


@grid
def _mark_starts(count: int, starts: Any, labels: Any, columns: int) -> None:
    """Mark the cracks, right of a pixel and (second half) below it, that continue none before them."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        here, last_column, last_row = labels[p], p % columns == columns - 1, p >= count - columns
        right = _OUTSIDE if last_column else labels[p + 1]
        below = _OUTSIDE if last_row else labels[p + columns]
        if parted(here, right):
            goes_on = p >= columns and continued(here, right, labels[p - columns], labels[p - columns + 1])
            starts[p] = not goes_on
        if parted(here, below):
            goes_on = p % columns > 0 and continued(here, below, labels[p - 1], labels[p + columns - 1])
            starts[count + p] = not goes_on


@grid
def _follow_runs(count: int, pairs: Any, lengths: Any, starts: Any, labels: Any, columns: int, regions: int) -> None:
    """Pair of regions of each run, as one number, and the cracks in it."""
    size = labels.size
    for run in range(cuda.grid(1), count, cuda.gridsize(1)):
        crack = starts[run]
        vertical = crack < size
        p = crack if vertical else crack - size
        across, step = (1, columns) if vertical else (columns, 1)
        # a vertical run ends at the last row, a horizontal one at the end of its row
        left = size - p if vertical else columns - p % columns
        a, b = labels[p], labels[p + across]
        length = np.int32(1)
        while step * length < left:
            q = p + step * length
            if not continued(labels[q], labels[q + across], a, b):
                break
            length += np.int32(1)
        pairs[run] = np.int64(min(a, b)) * (regions + 1) + max(a, b)
        lengths[run] = length


@grid
def _add_lengths(count: int, totals: Any, contact: Any, lengths: Any) -> None:
    for run in range(cuda.grid(1), count, cuda.gridsize(1)):
        cuda.atomic.add(totals, contact[run], lengths[run])


def label_range(labels: Any) -> tuple[int, int]:
    """Lowest and highest label of a device array, not above and not below 0."""
    if labels.size == 0:
        return 0, 0
    xp = namespace(labels)
    # the scalars that are read before the work: labels are indices in what follows
    return min(int(xp.min(labels)), 0), max(int(xp.max(labels)), 0)


def contacts(labels: Any, count: int) -> Contacts:
    """Contacts of an int32 device array, as of `adjacency.contacts`."""
    xp = namespace(labels)
    flat, columns = labels.reshape(-1), labels.shape[1]
    marks = xp.zeros(2 * flat.size, xp.bool_)
    _mark_starts(flat.size, marks, flat, columns)
    # how many runs there are, and how many pairs of regions, is read for the size of their tables
    starts = xp.flatnonzero(marks)
    if starts.size == 0:
        return Contacts(xp.empty((0, 2), xp.int32), xp.empty(0, xp.int32))
    pairs, lengths = xp.empty(starts.size, xp.int64), xp.empty(starts.size, xp.int32)
    _follow_runs(starts.size, pairs, lengths, starts, flat, columns, count)
    pairs, contact = xp.unique(pairs, return_inverse=True)
    totals = xp.zeros(pairs.size, xp.int32)
    _add_lengths(starts.size, totals, contact, lengths)
    return Contacts(xp.stack([pairs // (count + 1), pairs % (count + 1)], axis=1).astype(xp.int32), totals)
