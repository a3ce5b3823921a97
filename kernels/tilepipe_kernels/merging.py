"""Merging of adjacent regions by the probability that they are one, round by round, on a region adjacency graph.

In a round regions merge with the neighbour they most likely belong to, around pairs that say so of each other, if the
probability is high enough; then means are pooled and the graph is rebuilt.  Regions of a long slope are
therefore compared by their own pooled heights and not link by link, which keeps chains from running downhill.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.compiled import loop

Edges = NDArray[np.int32]


@dataclass(frozen=True)
class Statistics:
    """Pixels of each region: their number, mean, and sum of squared deviations from it; float64, shape (n,)."""

    count: NDArray[np.float64]
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]


@dataclass(frozen=True)
class RegionGraph:
    """Regions and their borders.

    ``edges`` is (m, 2) int32, first less than second, sorted; ``length`` the border of each in pixel sides, int64.
    """

    statistics: Statistics
    edges: Edges
    length: NDArray[np.int64]


@loop
def _best_edges(
    edges: Edges, length: NDArray[np.int64], probability: NDArray[np.float32], least: np.float32, regions: int
) -> NDArray[np.int64]:
    """Most probable edge of each region, -1 if none reaches ``least``; ties: the longer border, then the first."""
    best = np.full(regions, -1, np.int64)
    for edge in range(edges.shape[0]):
        if probability[edge] < least:
            continue
        for side in range(2):
            held = best[edges[edge, side]]
            if held < 0 or (probability[edge], length[edge]) > (probability[held], length[held]):
                best[edges[edge, side]] = edge
    return best


@loop
def _roots(edges: Edges, best: NDArray[np.int64]) -> NDArray[np.int32]:
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
) -> tuple[RegionGraph, NDArray[np.int32], NDArray[np.int64]]:
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
    source
        For each new edge the first old one that it is made of, int64.
    """
    regions = graph.statistics.count.size
    best = _best_edges(graph.edges, graph.length, probability, np.float32(least), regions)
    into = _roots(graph.edges, best)
    kept = into == np.arange(regions, dtype=np.int32)
    number = (np.cumsum(kept, dtype=np.int32) - np.int32(1))[into]
    merged, source = contract(graph, number, int(np.count_nonzero(kept)))
    return merged, number, source


def contract(graph: RegionGraph, number: NDArray[np.int32], regions: int) -> tuple[RegionGraph, NDArray[np.int64]]:
    """Unite regions that get the same number 0 … ``regions`` - 1; borders between united ones vanish.

    Returns the new graph and for each of its edges the first old one that it is made of.
    """
    statistics = pooled(graph.statistics, number, regions)
    lower, upper, source = _apart(graph.edges, number)
    order = _sorted(lower, _sorted(upper, np.arange(lower.size), regions), regions)
    edges, length, source = _united(lower, upper, source, order, graph.length)
    return RegionGraph(statistics, edges, length), source


@loop
def _apart(edges: Edges, number: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """New ends of the edges that do not vanish, the lower and the upper one, and which edges these are."""
    count = 0
    for edge in range(edges.shape[0]):
        count += number[edges[edge, 0]] != number[edges[edge, 1]]
    lower, upper, source = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int64)
    at = 0
    for edge in range(edges.shape[0]):
        a, b = number[edges[edge, 0]], number[edges[edge, 1]]
        if a != b:
            lower[at], upper[at], source[at] = min(a, b), max(a, b), edge
            at += 1
    return lower, upper, source


@loop
def _sorted(keys: NDArray[np.int32], order: NDArray[np.int64], largest: int) -> NDArray[np.int64]:
    """Stable counting sort of an order by keys 0 … ``largest`` - 1."""
    starts = np.zeros(largest + 1, np.int64)
    for key in keys:
        starts[key + 1] += 1
    for key in range(largest):
        starts[key + 1] += starts[key]
    result = np.empty_like(order)
    for item in order:
        result[starts[keys[item]]] = item
        starts[keys[item]] += 1
    return result


@loop
def _united(
    lower: NDArray[np.int32],
    upper: NDArray[np.int32],
    source: NDArray[np.int64],
    order: NDArray[np.int64],
    length: NDArray[np.int64],
) -> tuple[Edges, NDArray[np.int64], NDArray[np.int64]]:
    """Each edge of a sorted list once, with the sum of its borders and the first old edge."""
    edges = np.empty((order.size, 2), np.int32)
    total, first = np.empty(order.size, np.int64), np.empty(order.size, np.int64)
    found = 0
    for item in order:
        a, b = lower[item], upper[item]
        if found == 0 or edges[found - 1, 0] != a or edges[found - 1, 1] != b:
            edges[found, 0], edges[found, 1] = a, b
            total[found], first[found] = 0, source[item]
            found += 1
        total[found - 1] += length[source[item]]
    return edges[:found].copy(), total[:found].copy(), first[:found].copy()


def induced(graph: RegionGraph, kept: NDArray[np.bool_]) -> tuple[RegionGraph, NDArray[np.int64]]:
    """The graph of some of the regions, in their order, and for each of its edges the one that it was."""
    s = graph.statistics
    among = np.flatnonzero(kept[graph.edges].all(axis=1))
    number = np.cumsum(kept, dtype=np.int32) - np.int32(1)
    statistics = Statistics(s.count[kept], s.mean[kept], s.spread[kept])
    return RegionGraph(statistics, number[graph.edges[among]], graph.length[among]), among


def pooled(statistics: Statistics, number: NDArray[np.int32], regions: int) -> Statistics:
    """Count, mean and spread of united regions (Chan, Golub & LeVeque 1983, eq. 2.1), summed in node order."""
    count = _summed(statistics.count, number, regions)
    mean = _summed(statistics.count * statistics.mean, number, regions) / np.maximum(count, 1)
    between = statistics.count * (statistics.mean - mean[number]) ** 2
    return Statistics(count, mean, _summed(statistics.spread + between, number, regions))


def _summed(values: NDArray[np.float64], number: NDArray[np.int32], regions: int) -> NDArray[np.float64]:
    return np.bincount(number, values, regions).astype(np.float64, copy=False)


@loop
def _neighbours(
    edges: Edges, offsets: NDArray[np.int64], neighbours: NDArray[np.int32], edge_of: NDArray[np.int32]
) -> None:
    """Counting sort of both directions of every edge; ``offsets`` comes zeroed and holds two more than regions."""
    for edge in range(edges.shape[0]):
        offsets[edges[edge, 0] + 2] += 1
        offsets[edges[edge, 1] + 2] += 1
    for region in range(1, offsets.size):
        offsets[region] += offsets[region - 1]
    for side in range(2):
        # lower neighbours first, each group in order, so that all neighbours of a region are sorted
        for edge in range(edges.shape[0]):
            region, other = edges[edge, 1 - side], edges[edge, side]
            at = offsets[region + 1]
            neighbours[at], edge_of[at] = other, edge
            offsets[region + 1] = at + 1


def neighbour_lists(edges: Edges, regions: int) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Both directions of sorted edges by region.

    Parameters
    ----------
    edges
        int32, shape (m, 2), first less than second, sorted lexicographically.
    regions
        Number of regions.

    Returns
    -------
    offsets, neighbours, edge_of
        Region ``i`` has ``neighbours[offsets[i]:offsets[i + 1]]`` (int32, ascending) by the edges ``edge_of[...]``.
    """
    offsets = np.zeros(regions + 2, np.int64)
    neighbours, edge_of = np.empty(2 * len(edges), np.int32), np.empty(2 * len(edges), np.int32)
    _neighbours(edges, offsets, neighbours, edge_of)
    return offsets[:-1], neighbours, edge_of
