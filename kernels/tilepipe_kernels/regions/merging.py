"""Merging of adjacent regions by the probability that they are one, round by round, on a region adjacency graph.

In a round regions merge with the neighbour they most likely belong to, around pairs that say so of each other, if the
probability is high enough; then means are pooled and the graph is rebuilt.  Regions of a long slope are
therefore compared by their own pooled heights and not link by link, which keeps chains from running downhill.

A graph of a device is merged there, to the same regions; the host reads their number after each round.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.union_find import flatten, unite
from tilepipe_kernels.regions.contraction import (
    Edges,
    Float64,
    Lengths,
    RegionGraph,
    contract,
    number_groups,
)


@rule
def is_surer(probability: np.float32, length: np.int32, held: np.float32, held_length: np.int32) -> bool:
    """Whether an edge comes before the one held so far: by probability, then by the longer border."""
    return (probability, length) > (held, held_length)


@rule
def is_nearer(step: float, length: np.int32, held: float, held_length: np.int32) -> bool:
    """Whether the other side of an edge is more like a region than that held so far; ties: the longer border."""
    return (step, -length) < (held, -held_length)


@loop
def _best_edges(
    edges: Edges, length: Lengths, probability: NDArray[np.float32], least: np.float32, regions: int
) -> NDArray[np.int32]:
    """Most probable edge of each region, -1 if none reaches ``least``; ties: the longer border, then the first."""
    best = np.full(regions, -1, np.int32)
    for edge in range(edges.shape[0]):
        if probability[edge] < least:
            continue
        for side in range(2):
            held = best[edges[edge, side]]
            if held < 0 or is_surer(probability[edge], length[edge], probability[held], length[held]):
                best[edges[edge, side]] = edge
    return best


@loop
def _roots(edges: Edges, best: NDArray[np.int32]) -> NDArray[np.int32]:
    """The lowest region of a group: a mutual pair and all whose best is one of the pair; else the region itself."""
    root = np.arange(best.size).astype(np.int32)
    for region in range(best.size):
        edge = best[region]
        if edge >= 0 and edges[edge, 1] == region and best[edges[edge, 0]] == edge:
            root[region] = edges[edge, 0]
    into = root.copy()
    for region in range(best.size):
        edge = best[region]
        if edge < 0 or root[region] != region:
            continue
        other = edges[edge, 0] + edges[edge, 1] - region
        mutual = best[other]
        if root[other] != other or best[edges[mutual, 0] + edges[mutual, 1] - other] == mutual:
            into[region] = root[other]
    lowest = np.full(best.size, best.size, np.int32)
    for region in range(best.size):
        lowest[into[region]] = min(lowest[into[region]], region)
    for region in range(best.size):
        into[region] = lowest[into[region]]
    return into


def merge_best(
    graph: RegionGraph, probability: NDArray[np.float32], least: float
) -> tuple[RegionGraph, NDArray[np.int32]]:
    """Merge the regions that are each other's most probable partner, and those whose partner is one of such a pair.

    Every round therefore takes along a good part of all regions that can merge, but no chain of more than three.

    Parameters
    ----------
    graph
        Regions and borders.
    probability
        Probability that the two sides of each edge are one, float32, shape (m,).
    least
        Smallest probability that merges.

    Returns
    -------
    graph
        The merged regions, ordered by their lowest member.
    number
        New number of every old region, int32, shape (n,).

    Examples
    --------
    Of a row of four regions the first two are most likely one; the third does not reach the least probability.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.contraction import RegionGraph, Statistics
    >>> from tilepipe_kernels.regions.merging import merge_best
    >>> statistics = Statistics(np.full(4, 9.0), np.array([6.0, 6.1, 8.0, 12.0]), np.zeros(4))
    >>> graph = RegionGraph(statistics, np.array([[0, 1], [1, 2], [2, 3]], np.int32), np.full(3, 5, np.int32))
    >>> merge_best(graph, np.array([0.9, 0.3, 0.1], np.float32), least=0.5)[1].tolist()
    [0, 0, 1, 2]
    """
    regions = graph.statistics.count.size
    if on_device(graph.edges, probability):
        device = device_form(__name__)
        return contract(graph, *device.numbered(device.best_groups(graph, probability, np.float32(least))))
    lowest = _roots(
        graph.edges, _best_edges(graph.edges, graph.length, probability, np.float32(least), regions)
    )  # fmt: skip
    return contract(graph, *number_groups(lowest))


@loop
def _most_similar(edges: Edges, length: Lengths, mean: Float64, small: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Root of each region in the forest where small ones hang on the neighbour of the most similar height.

    Ties: the longer border, then the lower neighbour.
    """
    best = np.full(small.size, -1, np.int64)
    for edge in range(edges.shape[0]):
        step = abs(mean[edges[edge, 0]] - mean[edges[edge, 1]])
        for side in range(2):
            region = edges[edge, side]
            if not small[region]:
                continue
            held = best[region]
            if held >= 0:
                before = abs(mean[edges[held, 0]] - mean[edges[held, 1]])
                # edges come by ascending neighbour, so that the first of equals is that of the lowest
                if not is_nearer(step, length[edge], before, length[held]):
                    continue
            best[region] = edge
    root = np.arange(small.size).astype(np.int32)
    for region in range(small.size):
        if best[region] >= 0:
            unite(root, edges[best[region], 0], edges[best[region], 1])
    flatten(root)
    return root


def join_small(graph: RegionGraph, least: float) -> tuple[RegionGraph, NDArray[np.int32]]:
    """Join regions of fewer than ``least`` pixels to the neighbour of the most similar height, until none is left.

    Regions without neighbours stay.  Of equally similar neighbours the one with the longer border counts, then the
    one of the lower number.  Returns the graph and the new number of every old region.

    Examples
    --------
    A region of two pixels joins the neighbour of the most similar height.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.contraction import RegionGraph, Statistics
    >>> from tilepipe_kernels.regions.merging import join_small
    >>> statistics = Statistics(np.array([90.0, 2.0, 90.0]), np.array([6.0, 11.0, 12.0]), np.zeros(3))
    >>> graph = RegionGraph(statistics, np.array([[0, 1], [1, 2]], np.int32), np.array([5, 5], np.int32))
    >>> join_small(graph, least=4)[1].tolist()
    [0, 1, 1]
    """
    xp = namespace(graph.edges)
    region: NDArray[np.int32] = xp.arange(graph.statistics.count.size, dtype=xp.int32)
    while True:
        s = graph.statistics
        small = s.count < least
        if on_device(small):
            device = device_form(__name__)
            joined, number = contract(graph, *device.numbered(device.most_similar(graph, small)))
        else:
            joined, number = contract(graph, *number_groups(_most_similar(graph.edges, graph.length, s.mean, small)))
        if joined is graph:
            return graph, region
        graph, region = joined, number[region]
