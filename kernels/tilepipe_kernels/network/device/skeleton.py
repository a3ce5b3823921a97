"""`skeleton` on the device: the pixels of a subfield are deleted at once, as its rule allows."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace, to_host
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.network.neighbours import IS_REMOVABLE, IS_SIMPLE, LINKS, neighbour_code
from tilepipe_kernels.network.skeleton import ANCHOR, BACKGROUND, CLEANING_SWEEPS, SUBFIELDS, axis_side, subfield


@cuda.jit(device=True)
def _code(state: Any, p: int, stride: int) -> int:
    """`neighbour_code` of a position of the padded state."""
    north, south = p - stride, p + stride
    return neighbour_code(
        state[north - 1], state[north], state[north + 1], state[p + 1], state[south + 1], state[south],
        state[south - 1], state[p - 1],
    )  # fmt: skip


@grid
def _mark_anchors(
    count: int, squared: Any, row_offset: Any, column_offset: Any, rows: int, columns: int, apart_squared: Any,
    state: Any,
) -> None:  # fmt: skip
    far = apart_squared.size - 1
    for pair in range(cuda.grid(1), count, cuda.gridsize(1)):
        p, down = pair // 2, pair % 2
        i, j = p // columns, p % columns
        here = squared[p]
        if here == far or i + down == rows or j + 1 - down == columns:
            continue
        q = p + columns if down else p + 1
        there = squared[q]
        if here + there == 0 or there == far:
            continue
        apart = apart_squared[min(here, there)]
        side = axis_side(
            int(row_offset[p]), int(column_offset[p]), int(row_offset[q]), int(column_offset[q]), down, 1 - down, apart
        )
        at = (i + 1) * (columns + 2) + j + 1
        if side == 1 and here > 0:
            state[at] = ANCHOR
        elif side == 2 and there > 0:
            state[at + columns + 2 if down else at + 1] = ANCHOR


@grid
def _buckets(
    count: int, state: Any, squared: Any, columns: int, layer_of: Any, layers: int, row_parity: int,
    column_parity: int, buckets: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        there = state[(i + 1) * (columns + 2) + j + 1]
        buckets[p] = -1
        if there != BACKGROUND and squared[p] != layer_of.size - 1:
            layer = 0 if there == ANCHOR else layer_of[squared[p]]
            buckets[p] = subfield(i + row_parity, j + column_parity) * layers + layer


@grid
def _peel(count: int, state: Any, stride: int, pixels: Any, deletable: Any) -> None:
    for k in range(cuda.grid(1), count, cuda.gridsize(1)):
        p = pixels[k]
        if state[p] != BACKGROUND and deletable[_code(state, p, stride)]:
            state[p] = BACKGROUND


def thin(
    state: Any, squared: Any, features: tuple[Any, Any], apart_squared: Any, layer_of: Any, parity: tuple[int, int]
) -> None:
    """Mark anchors in a padded state and peel it, layer by layer; tables come from the host."""
    xp = namespace(state, squared)
    rows, columns = squared.shape
    flat, stride = state.reshape(-1), state.shape[1]
    _mark_anchors(
        2 * squared.size, squared.reshape(-1), features[0].reshape(-1), features[1].reshape(-1), rows, columns,
        xp.asarray(apart_squared), flat,
    )  # fmt: skip
    layers = int(layer_of.max()) + 1
    buckets = xp.empty(squared.size, xp.int32)
    _buckets(
        squared.size, flat, squared.reshape(-1), columns, xp.asarray(layer_of), layers, *parity, buckets,
    )  # fmt: skip
    inside = xp.flatnonzero(buckets >= 0)
    buckets = buckets[inside]
    order = xp.argsort(buckets)
    place = inside[order]
    pixels = ((place // columns + 1) * stride + place % columns + 1).astype(xp.int32)
    # the one transfer of the thinning: where each layer of each subfield begins, a few hundred numbers
    starts = [0, *to_host(xp.cumsum(xp.bincount(buckets, minlength=SUBFIELDS * layers))).tolist()]
    simple, removable = xp.asarray(IS_SIMPLE), xp.asarray(IS_REMOVABLE)

    def peel(first: int, end: int, deletable: Any) -> None:
        _peel(end - first, flat, stride, pixels[first:end], deletable)

    for layer in range(1, layers):
        for field in range(SUBFIELDS):
            begin = field * layers
            # what earlier layers have kept is tried again; a pixel of the own layer needs only be simple
            peel(starts[begin + 1], starts[begin + layer], removable)
            peel(starts[begin + layer], starts[begin + layer + 1], simple)
    for _ in range(CLEANING_SWEEPS):
        for field in range(SUBFIELDS):
            peel(starts[field * layers], starts[(field + 1) * layers], removable)


@grid
def _link(count: int, state: Any, columns: int, table: Any, links: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        at = (p // columns + 1) * (columns + 2) + p % columns + 1
        links[p] = table[_code(state, at, columns + 2)] if state[at] != 0 else 0


def link(state: Any, links: Any) -> None:
    """Look up the links of every pixel of a padded skeleton."""
    xp = namespace(state, links)
    _link(links.size, state.reshape(-1), links.shape[1], xp.asarray(LINKS), links.reshape(-1))
