"""Colour classes of a graph: sites of one colour have no edge between them, so they can be updated at once.

Colours are given greedily in node order, each node the lowest that none of its neighbours has yet.  They are a
function of the graph and the order of its nodes alone.  Region adjacency graphs are planar: five or six colours
do in practice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import loop

MAXIMUM_COLOURS = 255
"""Colours are uint8, and 255 stands for none."""

Offsets = NDArray[np.int64]
Neighbours = NDArray[np.int32]
Colours = NDArray[np.uint8]


@loop
def _colour(offsets: Offsets, neighbours: Neighbours, colours: Colours) -> int:
    """Colour greedily; return the number of colours, or -1 if there are too few."""
    colours[:] = MAXIMUM_COLOURS
    last_seen = np.full(MAXIMUM_COLOURS + 1, -1, np.int64)
    used = 0
    for node in range(colours.size):
        for k in range(offsets[node], offsets[node + 1]):
            last_seen[colours[neighbours[k]]] = node
        colour = 0
        while colour < MAXIMUM_COLOURS and last_seen[colour] == node:
            colour += 1
        if colour == MAXIMUM_COLOURS:
            return -1
        colours[node] = colour
        used = max(used, colour + 1)
    return used


def colour_graph(offsets: Offsets, neighbours: Neighbours) -> Colours:
    """Colour a graph so that no edge joins two nodes of one colour.

    Parameters
    ----------
    offsets, neighbours
        Symmetric graph in compressed sparse rows: int64 (n + 1,) and int32 (2 m,), no loops.

    Returns
    -------
    ndarray of uint8, shape (n,)
        Colours 0, 1, ...: of each node the lowest that no neighbour before it has.

    Raises
    ------
    ValueError
        For a graph that needs more than 255 colours.
    """
    colours = np.empty(len(offsets) - 1, np.uint8)
    if _colour(offsets, neighbours, colours) < 0:
        raise ValueError(f"the graph needs more than {MAXIMUM_COLOURS} colours: is it a region adjacency graph?")
    return colours


def order_by_colour(colours: Colours) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """List the nodes by colour, and in node order within each.

    Returns
    -------
    order, bounds
        int32 (n,) and int64 (colours + 1,): class c is ``order[bounds[c]:bounds[c + 1]]``, ascending.
    """
    order = np.argsort(colours, kind="stable").astype(np.int32)
    return order, np.concatenate([[0], np.cumsum(np.bincount(colours))]).astype(np.int64)


@loop
def count_components(offsets: Offsets, neighbours: Neighbours, marked: NDArray[np.bool_]) -> tuple[int, int]:
    """Count the connected components, and those among them without any marked node.

    Parameters
    ----------
    offsets, neighbours
        Graph as for `colour_graph`.
    marked
        bool, shape (n,).
    """
    seen = np.zeros(marked.size, np.bool_)
    queue = np.empty(marked.size, np.int32)
    components = without_mark = 0
    for start in range(marked.size):
        if seen[start]:
            continue
        seen[start] = True
        queue[0] = start
        read, written = 0, 1
        found = False
        while read < written:
            node = queue[read]
            read += 1
            found |= marked[node]
            for k in range(offsets[node], offsets[node + 1]):
                other = neighbours[k]
                if not seen[other]:
                    seen[other] = True
                    queue[written] = other
                    written += 1
        components += 1
        without_mark += not found
    return components, without_mark
