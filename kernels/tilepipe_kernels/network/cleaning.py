"""How a street graph is cleaned: hysteresis, contraction of junctions, pruning and the length filter.

Every step decides from integers (links, degrees, pixels) or from order-free reductions, so it cannot see
the tiling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.components import connected_components
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.network.street_graph import Bool, Graph, canonical, dissolve, keep

OnBorder = Callable[[Int64], Bool]


@dataclass(frozen=True)
class Cleaning:
    """What is done to the joined lines, in this order; lengths in pixels, 0 or None leaves a step out.

    Attributes
    ----------
    high
        Response that a line must reach somewhere (upper hysteresis threshold).
    through_junctions
        Whether hysteresis follows lines through junctions (else each edge must reach ``high``).
    contraction
        Junctions that edges up to this length hold together become one.
    maximum_gap, maximum_angle
        Longest bridge across a gap, and the widest angle in degrees between a line's end and its bridge.
    direction_steps
        Links over which the direction of a line's end is taken.
    minimum_branch
        Dangling branches shorter than this are pruned.
    minimum_length
        Connected components with less total length than this are dropped.
    """

    high: float | None = None
    through_junctions: bool = True
    contraction: float = 0.0
    maximum_gap: float = 0.0
    maximum_angle: float = 30.0
    direction_steps: int = 10
    minimum_branch: float = 0.0
    minimum_length: float = 0.0

    def __post_init__(self) -> None:
        for name in ("contraction", "maximum_gap", "minimum_branch", "minimum_length"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise ValueError(f"{name} must be a length of at least 0 pixels, got {value}")
        if not 0 < self.maximum_angle < 90:
            raise ValueError(f"maximum_angle must lie between 0 and 90 degrees, got {self.maximum_angle}")
        if self.direction_steps < 1:
            raise ValueError(f"direction_steps must be at least 1, got {self.direction_steps}")


def raster_border(shape: tuple[int, int], margin: int = 0) -> OnBorder:
    """Tell which pixels lie within ``margin`` pixels of the outermost rows and columns of a raster.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.cleaning import raster_border
    >>> raster_border((100, 50))(np.array([7, 50, 75])).tolist()  # in row 0, in column 0, inside
    [True, True, False]
    """
    rows, columns = shape

    def on_border(pixels: Int64) -> Bool:
        row, column = np.divmod(pixels, columns)
        inside = (row > margin) & (row < rows - 1 - margin) & (column > margin) & (column < columns - 1 - margin)
        return ~inside

    return on_border


def nowhere(pixels: Int64) -> Bool:
    """No pixel lies on a border."""
    return np.zeros(len(pixels), bool)


def hysteresis(graph: Graph, strength: NDArray[np.float32], high: float, through_junctions: bool = True) -> Graph:
    """Keep the lines that hold a point of at least ``high``.

    Steger (1998, section 2.4) starts a line at a strong point and follows it while points are at least
    ``low``; the pixel graph holds only such points, so a line is what can be reached from a strong point.

    Parameters
    ----------
    graph
        n edges.
    strength
        float32, shape (n,): greatest response of each edge.
    high
        Threshold, in the unit of the response.
    through_junctions
        Whether a line is followed into every branch of a junction (whole connected components are kept), or
        each edge needs a strong point of its own.
    """
    strong = strength >= np.float32(high)
    if not through_junctions:
        return keep(graph, strong)
    component = _components(graph)
    return keep(graph, np.isin(component, component[strong]))


def contract(graph: Graph, distance: float) -> Graph:
    """Contract clusters of junctions held together by edges of at most ``distance`` pixels to one node each.

    The node is named by its lowest pixel and lies at the mean of its members. An edge left inside a cluster
    is dropped when it has fewer than four points, since it encloses nothing; other edges within become
    loops.
    """
    nodes, degree, index = graph.degrees()
    junction = (degree[index] >= 3).reshape(-1, 2).all(axis=1)
    short = junction & (graph.start != graph.end) & (graph.length <= distance)
    if not short.any():
        return graph
    ends = index.reshape(-1, 2)
    label = connected_components(len(nodes), ends[short])
    _, lowest, size = np.unique(label, return_index=True, return_counts=True)
    node = nodes[lowest][label]
    inside = (node[ends[:, 0]] == node[ends[:, 1]]) & (graph.start != graph.end)
    merged = size[label] > 1
    # members of an earlier contraction follow their node; a node that is gone has none
    place = np.minimum(np.searchsorted(nodes, graph.member_node), len(nodes) - 1)
    known = nodes[place] == graph.member_node
    members = np.concatenate([nodes[merged], graph.member_pixel[known]])
    owners = np.concatenate([node[merged], node[place[known]]])
    positions = np.concatenate([graph.node_positions(len(nodes), index)[merged], graph.member_position[known]])
    pairs, first = np.unique(np.stack([owners, members], axis=1), axis=0, return_index=True)
    moved = replace(
        graph,
        start=node[ends[:, 0]],
        end=node[ends[:, 1]],
        member_node=pairs[:, 0].copy(),
        member_pixel=pairs[:, 1].copy(),
        member_position=positions[first],
    )
    return dissolve(canonical(keep(moved, ~short & ~(inside & (graph.points < 4)))))


def drop_twins(graph: Graph, longest: float) -> Graph:
    """Of edges between the same two nodes that are of one length within a pixel, keep the first.

    Two bridges over one gap make such twins; edges longer than ``longest`` pixels are no bridges and stay.
    """
    length = graph.length
    order = np.lexsort((graph.key, length, graph.end, graph.start))
    start, end, ordered = graph.start[order], graph.end[order], length[order]
    twin = np.zeros(len(graph), bool)
    twin[order[1:]] = (start[1:] == start[:-1]) & (end[1:] == end[:-1]) & (np.diff(ordered) <= 1)
    dropped = twin & (length <= longest) & (graph.start != graph.end)
    return dissolve(keep(graph, ~dropped)) if dropped.any() else graph


def prune(graph: Graph, minimum: float, on_border: OnBorder = nowhere) -> Graph:
    """Remove terminal branches shorter than ``minimum`` pixels until none is left.

    A terminal branch hangs on a junction by one end and dangles at the other, away from the border. A round
    removes all short ones at once, except that a junction whose edges are all short terminal branches keeps
    its longest (the first of equals); then nodes left with two edges dissolve.
    """
    while True:
        nodes, degree, index = graph.degrees()
        short = terminal_branches(graph, on_border) & (graph.length < minimum)
        if not short.any():
            return graph
        junction_end = 2 * np.arange(len(graph)) + (degree[index[::2]] < degree[index[1::2]])
        junction = index[junction_end[short]]
        branches = np.flatnonzero(short)
        # Longest last at each junction; among equals the first edge is the last entry.
        order = np.lexsort((-branches, graph.length[branches], junction))
        longest = np.append(junction[order][1:] != junction[order][:-1], True)
        doomed = np.bincount(junction, minlength=len(nodes)) == degree
        spared = branches[order][longest & doomed[junction[order]]]
        short[spared] = False
        graph = dissolve(keep(graph, ~short))


def terminal_branches(graph: Graph, on_border: OnBorder = nowhere) -> Bool:
    """Edges that dangle at one end, away from the border, and hang on a junction by the other; shape (n,)."""
    nodes, degree, index = graph.degrees()
    dangling = ((degree == 1) & ~on_border(nodes))[index].reshape(-1, 2)
    junction = (degree >= 3)[index].reshape(-1, 2)
    return (dangling & junction[:, ::-1]).any(axis=1)


def drop_short_components(graph: Graph, minimum: float) -> Graph:
    """Drop the connected components whose edges sum up to less than ``minimum`` pixels."""
    if not len(graph):
        return graph
    component = _components(graph)
    # Sums of integers in float64 are exact below 2**53.
    axial, diagonal = (np.bincount(component, weights) for weights in (graph.axial, graph.diagonal))
    total = axial + np.sqrt(2.0) * diagonal
    return keep(graph, total[component] >= minimum)


def _components(graph: Graph) -> Int64:
    """Component label of each edge; labels only tell components apart."""
    nodes, _, index = graph.degrees()
    ends = index.reshape(-1, 2)
    return connected_components(len(nodes), ends)[ends[:, 0]]
