"""Graph of regions, and what becomes of it when groups of them are united: borders summed, pixels pooled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule

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


@rule
def weighted_step(count: float, mean: float, centre: float) -> float:
    """What a part adds to the spread of the whole, beside its own spread (Chan, Golub & LeVeque 1983, eq. 2.1)."""
    return count * ((mean - centre) * (mean - centre))


@rule
def centre_of(pixels: float, total: float) -> float:
    """Mean of a region by its pixels, of which there may be none."""
    return total / max(pixels, 1.0)


def first_members(number: NDArray[np.int32], groups: int) -> NDArray[np.int64]:
    """Lowest member of each of the groups 0 … ``groups`` - 1, which are numbered in the order of these."""
    if on_device(number):
        device = device_form(f"{__package__}.merging")
        return device.first_members(number, groups)
    return np.flatnonzero(np.diff(np.maximum.accumulate(number), prepend=-1))


@loop
def number_groups(lowest: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
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
    """Unite regions that get the same number 0 … ``regions`` - 1; borders between united ones vanish.

    Examples
    --------
    Of a row of three regions the first two are united: what is left is their border to the third.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.contraction import RegionGraph, Statistics, contract
    >>> statistics = Statistics(np.array([10.0, 30.0, 20.0]), np.array([6.0, 8.0, 20.0]), np.zeros(3))
    >>> graph = RegionGraph(statistics, np.array([[0, 1], [1, 2]], np.int32), np.array([4, 7], np.int32))
    >>> united, _ = contract(graph, np.array([0, 0, 1], np.int32), 2)
    >>> united.edges.tolist(), united.length.tolist(), united.statistics.mean.tolist()
    ([[0, 1]], [7], [7.5, 20.0])
    """
    if regions == number.size:
        return graph, number
    if on_device(number):
        device = device_form(f"{__package__}.merging")
        edges, length = device.united(graph.edges, graph.length, number)
    else:
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


def pooled(statistics: Statistics, number: NDArray[np.int32], regions: int) -> Statistics:
    """Count, mean and spread of united regions (Chan, Golub & LeVeque 1983, eq. 2.1), summed in node order.

    Examples
    --------
    Ten pixels of 6 m and thirty of 8 m.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.contraction import Statistics, pooled
    >>> parts = Statistics(np.array([10.0, 30.0]), np.array([6.0, 8.0]), np.zeros(2))
    >>> pooled(parts, np.array([0, 0], np.int32), 1)
    Statistics(count=array([40.]), mean=array([7.5]), spread=array([30.]))
    """
    if on_device(number):
        device = device_form(f"{__package__}.merging")
        return device.pooled(statistics, number, regions)
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
        means[region] = centre_of(pixels[region], means[region])
    for old in range(count.size):
        new = np.uint32(number[old])
        spreads[new] += spread[old] + weighted_step(count[old], mean[old], means[new])
    return pixels, means, spreads
