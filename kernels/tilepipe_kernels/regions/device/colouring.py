"""`colouring` on the device."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.simulated import simulating
from tilepipe_kernels.regions.colouring import Rows, is_faulty, key_of, lowest_free
from tilepipe_kernels.regions.device.incidence import incidence

_ONE = np.uint64(1)
_THREADS = 512


@grid
def _find_fault(count: int, edges: Any, nodes: int, found: Any) -> None:
    for e in range(cuda.grid(1), count, cuda.gridsize(1)):
        before = np.int64(-1)
        if e > 0:
            before = key_of((edges[e - 1, 0], edges[e - 1, 1]))
        if is_faulty((edges[e, 0], edges[e, 1]), before, nodes):
            found[0] = True


def edge_fault(edges: Any, nodes: int) -> bool:
    """Whether device edges are in disorder; the host reads the answer."""
    found = namespace(edges).zeros(1, bool)
    _find_fault(len(edges), edges, nodes, found)
    return bool(found[0])


@grid
def _colour(edges: Any, offsets: Any, incident: Any, waiting: Any, queue: Any, tail: Any, colours: Any) -> None:
    """Colour level by level: nodes whose lower neighbours all have colours, then those that these have freed.

    One block of threads, which can wait for each other: the levels are many and short.  Who comes first into the
    queue is chance, but the colours are not.
    """
    first, last = 0, tail[0]
    cuda.syncthreads()
    while first < last:
        for k in range(first + cuda.threadIdx.x, last, cuda.blockDim.x):
            node = queue[k]
            taken = np.uint64(0)
            for at in range(offsets[node], offsets[node + 1]):
                if edges[incident[at], 1] == node:
                    taken |= _ONE << np.uint64(colours[edges[incident[at], 0]])
            colours[node] = lowest_free(taken)
            for at in range(offsets[node], offsets[node + 1]):
                upper = edges[incident[at], 1]
                if upper != node and cuda.atomic.sub(waiting, upper, 1) == 1:
                    queue[cuda.atomic.add(tail, 0, 1)] = upper
        cuda.syncthreads()
        first, last = last, tail[0]
        cuda.syncthreads()


def colour(edges: Any, nodes: int) -> Any:
    """Colours of a device graph, as of `colouring.colour_graph`; 64 where they do not suffice."""
    xp = namespace(edges)
    offsets, incident = incidence(edges, nodes)
    waiting = xp.bincount(xp.ascontiguousarray(edges[:, 1]), minlength=nodes).astype(xp.int32)
    # by the stable order the nodes that wait for none come first; the device counts them and the host never knows
    queue = xp.argsort(waiting, kind="stable").astype(xp.int32)
    tail = xp.sum(waiting == 0, dtype=xp.int32).reshape(1)
    colours = xp.zeros(nodes, xp.uint8)
    threads = 3 if simulating() else _THREADS
    _colour.blocks((1,), (threads,), edges, offsets, incident, waiting, queue, tail, colours)
    return colours


@grid
def _fill_rows(
    count: int, edges: Any, weights: Any, weighted: bool, offsets: Any, incident: Any, order: Any, rank: Any,
    starts: Any, neighbours: Any, weights_of_rows: Any,
) -> None:  # fmt: skip
    for row in range(cuda.grid(1), count, cuda.gridsize(1)):
        node = order[row]
        to = starts[row]
        for at in range(offsets[node], offsets[node + 1]):
            edge = incident[at]
            neighbours[to] = rank[edges[edge, 0] + edges[edge, 1] - node]
            if weighted:
                weights_of_rows[to] = weights[edge]
            to += 1


def rows_in_order(edges: Any, weights: Any, order: Any) -> Rows:
    """Rows of a device graph, as of `colouring.rows_in_order`."""
    xp = namespace(edges)
    nodes = order.size
    offsets, incident = incidence(edges, nodes)
    rank = xp.empty_like(order)
    rank[order] = xp.arange(nodes, dtype=order.dtype)
    degree = (offsets[1:] - offsets[:-1])[order]
    starts = xp.concatenate((xp.zeros(1, xp.int64), xp.cumsum(degree, dtype=xp.int64)))
    neighbours = xp.empty(2 * len(edges), xp.int32)
    of_rows = xp.empty(2 * len(weights), weights.dtype)
    _fill_rows(
        nodes, edges, weights, len(weights) > 0, offsets, incident, order, rank, starts, neighbours, of_rows
    )  # fmt: skip
    return Rows(order, starts, neighbours, of_rows)
