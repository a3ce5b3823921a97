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
Lengths = NDArray[np.int32]
Float64 = NDArray[np.float64]

_LENGTH = np.int64(0xFFFFFFFF)
_FEW = 32
"""Neighbours up to which insertion sorts them fastest."""


@dataclass(frozen=True)
class Statistics:
    """Pixels of each region: their number, mean, and sum of squared deviations from it; float64, shape (n,)."""

    count: Float64
    mean: Float64
    spread: Float64


@dataclass(frozen=True)
class RegionGraph:
    """Regions and their borders.

    ``edges`` is (m, 2) int32, first less than second, sorted; ``length`` the border of each in pixel sides, int32.
    """

    statistics: Statistics
    edges: Edges
    length: Lengths


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
            if held < 0 or (probability[edge], length[edge]) > (probability[held], length[held]):
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
    """
    regions = graph.statistics.count.size
    lowest = _roots(
        graph.edges, _best_edges(graph.edges, graph.length, probability, np.float32(least), regions)
    )  # fmt: skip
    return contract(graph, *_numbered(lowest))


@loop
def _numbered(lowest: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """Number groups, which are named by their lowest member, in order."""
    number = np.empty_like(lowest)
    groups = 0
    for region in range(lowest.size):
        if lowest[region] == region:
            number[region] = groups
            groups += 1
        else:
            number[region] = number[lowest[region]]
    return number, groups


def contract(graph: RegionGraph, number: NDArray[np.int32], regions: int) -> tuple[RegionGraph, NDArray[np.int32]]:
    """Unite regions that get the same number 0 … ``regions`` - 1; borders between united ones vanish."""
    if regions == number.size:
        return graph, number
    edges, length = _united(graph.edges, graph.length, number, regions)
    return RegionGraph(pooled(graph.statistics, number, regions), edges, length), number


@loop
def _united(edges: Edges, length: Lengths, number: NDArray[np.int32], regions: int) -> tuple[Edges, Lengths]:
    """New edges, sorted, each once, with the sum of its borders: counting sort by lower end, then rows by the upper."""
    starts = np.zeros(regions + 2, np.int32)
    for edge in range(edges.shape[0]):
        a, b = number[np.uint32(edges[edge, 0])], number[np.uint32(edges[edge, 1])]
        starts[np.uint32(min(a, b) + 2)] += a != b
    for region in range(1, starts.size):
        starts[region] += starts[region - 1]
    row = np.empty(starts[regions + 1], np.int64)  # upper end and length in one word
    for edge in range(edges.shape[0]):
        a, b = number[np.uint32(edges[edge, 0])], number[np.uint32(edges[edge, 1])]
        if a != b:
            low = np.uint32(min(a, b) + 1)
            row[np.uint32(starts[low])] = (np.int64(max(a, b)) << 32) | np.int64(length[edge])
            starts[low] += 1
    found = 0
    for region in range(regions):
        first, last = starts[region], starts[region + 1]
        _sort(row[first:last])
        starts[region] = begin = found
        for at in range(first, last):
            if found > begin and row[found - 1] >> 32 == row[at] >> 32:
                row[found - 1] += row[at] & _LENGTH
            else:
                row[found] = row[at]
                found += 1
    united, total = np.empty((found, 2), np.int32), np.empty(found, np.int32)
    starts[regions] = found
    for region in range(regions):
        for at in range(starts[region], starts[region + 1]):
            united[at, 0], united[at, 1] = region, row[at] >> 32
            total[at] = row[at] & _LENGTH
    return united, total


@loop
def _sort(row: NDArray[np.int64]) -> None:
    if row.size > _FEW:
        row.sort()
        return
    for at in range(1, row.size):
        value, place = row[at], at
        while place > 0 and row[place - 1] > value:
            row[place] = row[place - 1]
            place -= 1
        row[place] = value


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
                if (step, -length[edge]) >= (before, -length[held]):
                    continue
            best[region] = edge
    root = np.arange(small.size).astype(np.int32)
    for region in range(small.size):
        if best[region] < 0:
            continue
        a, b = edges[best[region], 0], edges[best[region], 1]
        while root[a] != a:
            root[a] = root[root[a]]
            a = root[a]
        while root[b] != b:
            root[b] = root[root[b]]
            b = root[b]
        root[max(a, b)] = min(a, b)
    for region in range(small.size):
        root[region] = root[root[region]]
    return root


def join_small(graph: RegionGraph, least: float) -> tuple[RegionGraph, NDArray[np.int32]]:
    """Join regions of fewer than ``least`` pixels to the neighbour of the most similar height, until none is left.

    Regions without neighbours stay.  Of equally similar neighbours the one with the longer border counts, then the
    one of the lower number.  Returns the graph and the new number of every old region.
    """
    region = np.arange(graph.statistics.count.size, dtype=np.int32)
    while True:
        s = graph.statistics
        joined, number = contract(graph, *_numbered(_most_similar(graph.edges, graph.length, s.mean, s.count < least)))
        if joined is graph:
            return graph, region
        graph, region = joined, number[region]


def pooled(statistics: Statistics, number: NDArray[np.int32], regions: int) -> Statistics:
    """Count, mean and spread of united regions (Chan, Golub & LeVeque 1983, eq. 2.1), summed in node order."""
    return Statistics(*_pooled(statistics.count, statistics.mean, statistics.spread, number, regions))


@loop
def _pooled(
    count: Float64, mean: Float64, spread: Float64, number: NDArray[np.int32], regions: int
) -> tuple[Float64, Float64, Float64]:
    pixels, means, spreads = np.zeros(regions), np.zeros(regions), np.zeros(regions)
    for old in range(count.size):
        new = np.uint32(number[old])
        pixels[new] += count[old]
        means[new] += count[old] * mean[old]
    for region in range(regions):
        means[region] /= max(pixels[region], 1.0)
    for old in range(count.size):
        new = np.uint32(number[old])
        spreads[new] += spread[old] + count[old] * (mean[old] - means[new]) ** 2
    return pixels, means, spreads
