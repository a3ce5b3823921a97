"""`merging` on the device: a thread for every region."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.union_find import flatten, unite
from tilepipe_kernels.regions.contraction import RegionGraph, Statistics, centre_of, weighted_step
from tilepipe_kernels.regions.device.incidence import incidence
from tilepipe_kernels.regions.merging import is_nearer, is_surer

# ------------------------------------------------------------------------------------------------- best partners


@grid
def _best_edges(
    count: int, offsets: Any, incident: Any, length: Any, probability: Any, least: np.float32, best: Any
) -> None:
    """Most probable edge of each region, -1 if none reaches ``least``."""
    for region in range(cuda.grid(1), count, cuda.gridsize(1)):
        held = -1
        for at in range(offsets[region], offsets[region + 1]):
            edge = incident[at]
            if probability[edge] < least:
                continue
            if held < 0 or is_surer(probability[edge], length[edge], probability[held], length[held]):
                held = edge
        best[region] = held


@cuda.jit(device=True)
def _other_side(edges: Any, edge: int, region: int) -> int:
    return edges[edge, 0] + edges[edge, 1] - region


@grid
def _join_pairs(count: int, edges: Any, best: Any, into: Any, lowest: Any) -> None:
    """Name the group of each region by the pair that its best neighbour is of, if any, and note its lowest member."""
    for region in range(cuda.grid(1), count, cuda.gridsize(1)):
        group, edge = region, best[region]
        if edge >= 0:
            other = _other_side(edges, edge, region)
            partner = _other_side(edges, best[other], other)
            if best[partner] == best[other]:
                group = min(other, partner)
        into[region] = group
        cuda.atomic.min(lowest, group, region)


def best_groups(graph: RegionGraph, probability: Any, least: np.float32) -> Any:
    """Lowest region of the group that each region merges into."""
    xp = namespace(probability)
    regions = graph.statistics.count.size
    best, into = xp.empty(regions, xp.int32), xp.empty(regions, xp.int32)
    lowest = xp.full(regions, regions, xp.int32)
    _best_edges(regions, *incidence(graph.edges, regions), graph.length, probability, least, best)
    _join_pairs(regions, graph.edges, best, into, lowest)
    return lowest[into]


# ------------------------------------------------------------------------------------------------- small regions


@grid
def _join_most_similar(
    count: int, edges: Any, offsets: Any, incident: Any, length: Any, mean: Any, small: Any, parent: Any
) -> None:
    for region in range(cuda.grid(1), count, cuda.gridsize(1)):
        if not small[region]:
            continue
        held, before = -1, 0.0
        for at in range(offsets[region], offsets[region + 1]):
            edge = incident[at]
            step = abs(mean[edges[edge, 0]] - mean[edges[edge, 1]])
            if held < 0 or is_nearer(step, length[edge], before, length[held]):
                held, before = edge, step
        if held >= 0:
            unite(parent, edges[held, 0], edges[held, 1])


def most_similar(graph: RegionGraph, small: Any) -> Any:
    """Root of each region in the forest where small ones hang on the neighbour of the most similar height."""
    regions = small.size
    parent = namespace(small).arange(regions, dtype=np.int32)
    _join_most_similar(
        regions, graph.edges, *incidence(graph.edges, regions), graph.length, graph.statistics.mean, small, parent
    )  # fmt: skip
    flatten(regions, parent)
    return parent


# ------------------------------------------------------------------------------------------------- contraction


def numbered(lowest: Any) -> tuple[Any, int]:
    """Number groups, which are named by their lowest member, in order; the host reads how many there are."""
    xp = namespace(lowest)
    if not lowest.size:
        return lowest, 0
    number = xp.cumsum(lowest == xp.arange(lowest.size, dtype=xp.int32), dtype=xp.int32)
    return number[lowest] - xp.int32(1), int(number[-1])


@grid
def _find_first(count: int, number: Any, first: Any) -> None:
    for member in range(cuda.grid(1), count, cuda.gridsize(1)):
        cuda.atomic.min(first, number[member], member)


def first_members(number: Any, groups: int) -> Any:
    """Lowest member of each group, int64."""
    first = namespace(number).full(groups, number.size, np.int64)
    _find_first(number.size, number, first)
    return first


def united(edges: Any, length: Any, number: Any) -> tuple[Any, Any]:
    """New edges, sorted, each once, with the sum of its borders."""
    xp = namespace(edges)
    a, b = number[edges[:, 0]], number[edges[:, 1]]
    apart = a != b
    low, high = xp.minimum(a, b)[apart].astype(xp.int64), xp.maximum(a, b)[apart]
    keys, length = (low << 32) | high, length[apart]
    order = xp.argsort(keys, kind="stable")
    keys = keys[order]
    # borders are whole numbers, so that differences of running sums are exact
    ends = xp.concatenate((xp.zeros(1, xp.int64), xp.cumsum(length[order], dtype=xp.int64)))
    starts = xp.flatnonzero(xp.concatenate((xp.ones(min(keys.size, 1), bool), keys[1:] != keys[:-1])))
    sums = ends[xp.concatenate((starts[1:], xp.full(min(keys.size, 1), keys.size, starts.dtype)))] - ends[starts]
    keys = keys[starts]
    return xp.stack(((keys >> 32).astype(xp.int32), keys.astype(xp.int32)), axis=1), sums.astype(xp.int32)


@grid
def _pool(
    count: int, starts: Any, members: Any, pixels_of: Any, mean_of: Any, spread_of: Any, pixels: Any, mean: Any,
    spread: Any,
) -> None:  # fmt: skip
    for region in range(cuda.grid(1), count, cuda.gridsize(1)):
        n = 0.0
        total = 0.0
        for at in range(starts[region], starts[region + 1]):
            member = members[at]
            n += pixels_of[member]
            total += pixels_of[member] * mean_of[member]
        centre = centre_of(n, total)
        squares = 0.0
        for at in range(starts[region], starts[region + 1]):
            member = members[at]
            squares += spread_of[member] + weighted_step(pixels_of[member], mean_of[member], centre)
        pixels[region], mean[region], spread[region] = n, centre, squares


def pooled(statistics: Statistics, number: Any, regions: int) -> Statistics:
    """Count, mean and spread of united regions, each summed in node order by one thread."""
    xp = namespace(number)
    members = xp.argsort(number, kind="stable").astype(xp.int32)
    starts = xp.searchsorted(number[members], xp.arange(regions + 1, dtype=number.dtype)).astype(xp.int32)
    found = Statistics(xp.empty(regions), xp.empty(regions), xp.empty(regions))
    _pool(
        regions, starts, members, statistics.count, statistics.mean, statistics.spread, found.count, found.mean,
        found.spread,
    )  # fmt: skip
    return found
