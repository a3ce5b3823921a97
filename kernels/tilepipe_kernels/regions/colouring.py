"""Colour classes of a graph: sites of one colour have no edge between them, so they can be updated at once.

Colours are given greedily in node order, each node the lowest that none of its neighbours has yet.  They are a
function of the graph and the order of its nodes alone.  Region adjacency graphs are planar: five or six colours
do in practice.  Graphs of a device stay there, and get the same colours.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device, to_host
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.ragged import offsets_of

MAXIMUM_COLOURS = 64
"""As many as bits of a word."""

Edges = NDArray[np.int32]
Colours = NDArray[np.uint8]
_ONE = np.uint64(1)


class Rows(NamedTuple):
    """A graph in compressed sparse rows, its nodes renumbered by colour.

    Attributes
    ----------
    order
        int32 (n,): the node of each row.
    offsets, neighbours, weights
        int64 (n + 1,), int32 (2 m,), float (2 m,) or empty for weights of one: row k has the rows
        ``neighbours[offsets[k]:offsets[k + 1]]`` beside it; those of earlier colours are below k.
    """

    order: NDArray[np.int32]
    offsets: NDArray[np.int64]
    neighbours: NDArray[np.int32]
    weights: NDArray[Any]


@rule
def key_of(edge: tuple[np.int32, np.int32]) -> np.int64:
    """Both ends of an edge in one word, by which edges are sorted."""
    return (np.int64(edge[0]) << 32) | np.int64(edge[1])


@rule
def is_faulty(edge: tuple[np.int32, np.int32], before: np.int64, nodes: int) -> bool:
    """Whether an edge is out of range, not from lower to upper node, or not above the key of the one before it."""
    return bool(edge[0] < 0 or edge[1] <= edge[0] or edge[1] >= nodes or key_of(edge) <= before)


@loop
def _edge_fault(edges: Edges, nodes: int) -> bool:
    before = np.int64(-1)
    for e in range(edges.shape[0]):
        edge = edges[e, 0], edges[e, 1]
        if is_faulty(edge, before, nodes):
            return True
        before = key_of(edge)
    return False


def in_order(edges: Edges, nodes: int) -> bool:
    """Whether edges go from lower to upper node, are sorted, each once, and join nodes below ``nodes``."""
    if on_device(edges):
        device = device_form(__name__)
        return not device.edge_fault(edges, nodes)
    return not _edge_fault(edges, nodes)


@rule
def lowest_free(taken: np.uint64) -> int:
    """Lowest colour whose bit is not set; MAXIMUM_COLOURS if all are."""
    colour = 0
    while colour < MAXIMUM_COLOURS and (taken >> np.uint64(colour)) & _ONE:
        colour += 1
    return colour


@loop
def _colour(edges: Edges, colours: Colours) -> int:
    """Colour greedily; return the number of colours, or -1 if there are too few."""
    taken = np.zeros(colours.size, np.uint64)
    used = edge = 0
    for node in range(colours.size):
        colour = lowest_free(taken[node])
        if colour == MAXIMUM_COLOURS:
            return -1
        colours[node] = colour
        used = max(used, colour + 1)
        while edge < edges.shape[0] and edges[edge, 0] == node:
            taken[edges[edge, 1]] |= _ONE << np.uint64(colour)
            edge += 1
    return used


def colour_graph(edges: Edges, nodes: int) -> Colours:
    """Colour a graph so that no edge joins two nodes of one colour.

    Parameters
    ----------
    edges
        int32 (m, 2): pairs of nodes, the lower first, sorted.
    nodes
        Number of nodes.

    Returns
    -------
    ndarray of uint8, shape (n,)
        Colours 0, 1, ...: of each node the lowest that no neighbour before it has.

    Raises
    ------
    ValueError
        For a graph that needs more than 64 colours.

    Examples
    --------
    A ring of five regions needs three colours.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.colouring import colour_graph
    >>> colour_graph(np.array([[0, 1], [0, 4], [1, 2], [2, 3], [3, 4]], np.int32), nodes=5).tolist()
    [0, 1, 0, 1, 2]
    """
    if on_device(edges):
        device = device_form(__name__)
        colours: Colours = device.colour(edges, nodes)
        enough = not bool((colours == MAXIMUM_COLOURS).any())
    else:
        colours = np.empty(nodes, np.uint8)
        enough = _colour(edges, colours) >= 0
    if not enough:
        raise ValueError(f"the graph needs more than {MAXIMUM_COLOURS} colours: is it a region adjacency graph?")
    return colours


def order_by_colour(colours: Colours) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """List the nodes by colour, and in node order within each.

    Returns
    -------
    order, bounds
        int32 (n,) and int64 (colours + 1,): class c is ``order[bounds[c]:bounds[c + 1]]``, ascending.  The bounds
        are always the host's, which they tell how many threads a class takes.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.regions.colouring import order_by_colour
    >>> order, bounds = order_by_colour(np.array([0, 1, 0, 1, 2], np.uint8))
    >>> order.tolist(), bounds.tolist()
    ([0, 2, 1, 3, 4], [0, 2, 4, 5])
    """
    xp = namespace(colours)
    order = xp.argsort(colours, kind="stable").astype(xp.int32)
    return order, offsets_of(to_host(xp.bincount(colours)))


@loop
def _fill_rows(
    edges: Edges, weights: NDArray[Any], rank: NDArray[np.int32], offsets: NDArray[np.int64],
    neighbours: NDArray[np.int32], weights_of_rows: NDArray[Any],
) -> None:  # fmt: skip
    """Counting sort of both directions of every edge; ``offsets`` comes zeroed and holds two more than rows."""
    for edge in range(edges.shape[0]):
        offsets[rank[edges[edge, 0]] + 2] += 1
        offsets[rank[edges[edge, 1]] + 2] += 1
    for row in range(1, offsets.size):
        offsets[row] += offsets[row - 1]
    for edge in range(edges.shape[0]):
        a, b = rank[edges[edge, 0]], rank[edges[edge, 1]]
        for _ in range(2):
            at = offsets[a + 1]
            neighbours[at] = b
            if weights.size:
                weights_of_rows[at] = weights[edge]
            offsets[a + 1] = at + 1
            a, b = b, a


def rows_in_order(edges: Edges, weights: NDArray[Any], order: NDArray[np.int32]) -> Rows:
    """Rows of a graph in an order of its nodes; neighbours stand in that of the edges."""
    if on_device(edges, weights, order):
        device = device_form(__name__)
        return device.rows_in_order(edges, weights, order)
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size, dtype=np.int32)
    offsets = np.zeros(order.size + 2, np.int64)
    neighbours = np.empty(2 * len(edges), np.int32)
    of_rows = np.empty(2 * len(weights), weights.dtype)
    _fill_rows(edges, weights, rank, offsets, neighbours, of_rows)
    return Rows(order, offsets[:-1], neighbours, of_rows)
