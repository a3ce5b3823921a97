"""`morphology` on the device: discs gathered by every pixel; holes by union-find and their bounding boxes."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.union_find import flatten, unite


@grid
def _dilate(count: int, mask: Any, rows: int, columns: int, half_widths: Any, dilated: Any) -> None:
    reach = half_widths.size - 1
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        found = 0
        for y in range(max(0, i - reach), min(rows, i + reach + 1)):
            width = half_widths[abs(y - i)]
            for x in range(max(0, j - width), min(columns, j + width + 1)):
                found |= mask[y * columns + x]
        dilated[p] = found


def dilate(mask: Any, half_widths: Any) -> Any:
    """Union of the mask, uint8, shifted by every offset of a disc, as uint8; the disc comes from the host."""
    xp = namespace(mask)
    dilated = xp.empty(mask.shape, xp.uint8)
    flat = xp.ascontiguousarray(mask).reshape(-1)
    _dilate(mask.size, flat, *mask.shape, xp.asarray(half_widths), dilated.reshape(-1))
    return dilated


@grid
def _unite_background(count: int, parent: Any, mask: Any, columns: int) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if mask[p] == 0:
            if p % columns > 0 and mask[p - 1] == 0:
                unite(parent, p, p - 1)
            if p >= columns and mask[p - columns] == 0:
                unite(parent, p, p - columns)


@grid
def _bound(count: int, parent: Any, mask: Any, columns: int, bottom: Any, left: Any, right: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if mask[p] == 0:
            root = parent[p]
            # most pixels lie inside what is known of their part: a look is cheaper than an atomic write
            if bottom[root] < p // columns:
                cuda.atomic.max(bottom, root, p // columns)
            if left[root] > p % columns:
                cuda.atomic.min(left, root, p % columns)
            if right[root] < p % columns:
                cuda.atomic.max(right, root, p % columns)


@grid
def _fill(
    count: int, parent: Any, mask: Any, rows: int, columns: int, size: int, bottom: Any, left: Any, right: Any,
    filled: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        value = mask[p]
        if value == 0:
            root = parent[p]
            # a root is the first pixel of its part, so its row is the top
            top = root // columns
            inside = top > 0 and left[root] > 0 and bottom[root] < rows - 1 and right[root] < columns - 1
            fits = bottom[root] - top < size and right[root] - left[root] < size
            value = 1 if inside and fits else 0
        filled[p] = value


def fill_specks(mask: Any, size: int) -> Any:
    """See `morphology.fill_specks`; the mask is uint8, 0 or 1."""
    xp = namespace(mask)
    rows, columns = mask.shape
    flat = xp.ascontiguousarray(mask).reshape(-1)
    parent = xp.arange(flat.size, dtype=xp.int32)
    _unite_background(flat.size, parent, flat, columns)
    flatten(flat.size, parent)
    bottom, right = xp.full(flat.size, -1, xp.int32), xp.full(flat.size, -1, xp.int32)
    left = xp.full(flat.size, columns, xp.int32)
    _bound(flat.size, parent, flat, columns, bottom, left, right)
    filled = xp.empty(mask.shape, xp.uint8)
    _fill(flat.size, parent, flat, rows, columns, size, bottom, left, right, filled.reshape(-1))
    return filled
