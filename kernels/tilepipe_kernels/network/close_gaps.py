"""Closing gaps: dangling tips are led on to a facing tip or to the line ahead of them.

A tip is a dangling edge end with the direction of its last pixels. Two tips face each other when each lies
in the other's cone; facing tips are paired from the cheapest pair on, so that each accepted pair is the
best of both of its tips. A tip that found no partner is led to the nearest point of another edge in its
cone, and that edge is cut there at a new junction. Bridges are not tested against each other: two bridges
may cross.

Memory is bounded by the number of tips plus one tile: points are shown to the tips tile by tile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.ragged import Int64, offsets_of, reduce_runs, run_of_rows
from tilepipe_kernels.network.chain_loops import count_steps
from tilepipe_kernels.network.cleaning import OnBorder, nowhere
from tilepipe_kernels.network.gap_loops import cut_parts, look_ahead, match_greedily, points_behind
from tilepipe_kernels.network.points import LoadTile, gather, pixels_at, tiles_of_slices
from tilepipe_kernels.network.street_graph import Bool, Chains, Graph, canonical, dissolve

SMALLEST_CELL = 16
BATCH_POINTS = 1_000_000


@dataclass(frozen=True)
class _Tips:
    """Dangling ends sorted by cell; facts are row, column, row and column ahead, edge."""

    position: Int64
    pixel: Int64
    facts: Int64
    cell: int
    cell_start: NDArray[np.int32]
    cells_across: int


def close_gaps(
    graph: Graph,
    chains: Chains,
    load_tile: LoadTile,
    maximum_gap: float,
    maximum_angle: float,
    steps: int = 10,
    on_border: OnBorder = nowhere,
) -> Graph:
    """Lead dangling ends on across gaps.

    Parameters
    ----------
    graph
        Edges whose parts are whole chains (no gaps closed before).
    chains
        The chains that the parts refer to.
    load_tile
        Gives the fragments and attributes of a tile.
    maximum_gap
        Longest bridge in pixels.
    maximum_angle
        Widest angle between the direction of an end and its bridge, in degrees, below 90.
    steps
        Number of links over which the direction of an end is taken.
    on_border
        Tells which node pixels lie on the border, where lines do not dangle.

    Returns
    -------
    Graph
        With bridges joined to the edges they prolong, and edges cut where bridges reach them.
    """
    tips = _find_tips(graph, chains, load_tile, maximum_gap, steps, on_border)
    if not len(tips.pixel):
        return graph
    cosine = float(np.cos(np.radians(maximum_angle)))
    pairs, cost = _facing(tips, maximum_gap, maximum_angle)
    nearest, blocked = _show_points(graph, chains, load_tile, tips, pairs, cosine, maximum_gap)
    pairs, cost = pairs[~blocked], cost[~blocked]
    low, high = np.sort(tips.pixel[pairs], axis=1).T
    pairs = pairs[np.lexsort((high, low, cost))]
    pairs = pairs[match_greedily(pairs[:, 0], pairs[:, 1], len(tips.pixel))]
    alone = nearest[:, 1] < chains.offsets[-1]
    alone[pairs.ravel()] = False
    origin = np.flatnonzero(alone)
    cut, node_at = _cut(graph, chains, load_tile, nearest[origin, 1])
    bridges = _bridges(tips, chains, pairs, origin, nearest[origin, 1], node_at)
    return dissolve(canonical(_concatenate(cut, bridges)))


def _find_tips(graph: Graph, chains: Chains, load_tile: LoadTile, gap: float, steps: int, on_border: OnBorder) -> _Tips:
    nodes, degree, index = graph.degrees()
    ends = np.flatnonzero(((degree == 1) & ~on_border(nodes))[index])
    parts = graph.offsets, graph.part_start, graph.part_stop, graph.part_backward
    position, behind = points_behind(*parts, ends, steps)
    pixel = nodes[index[ends]]
    row, column = np.divmod(pixel, chains.width)
    row_behind, column_behind = np.divmod(pixels_at(chains, load_tile, behind), chains.width)
    facts = np.stack([row, column, row - row_behind, column - column_behind, ends >> 1], axis=1)
    cell = max(int(np.ceil(gap)), SMALLEST_CELL)
    across = chains.width // cell + 3
    where = (row // cell + 1) * across + column // cell + 1
    order = np.lexsort((pixel, where))
    down = int(row.max()) // cell + 3 if len(row) else 3
    cell_start = offsets_of(np.bincount(where, minlength=down * across)).astype(np.int32)
    return _Tips(position[order], pixel[order], facts[order], cell, cell_start, across)


def _facing(tips: _Tips, gap: float, angle: float) -> tuple[Int64, NDArray[np.float64]]:
    """Pairs of tips in each other's cones, shape (m, 2), the lower tip first; and their cost."""
    # imported late, like everything here that a run needs only at its end
    from scipy.spatial import cKDTree

    place, ahead = tips.facts[:, :2], tips.facts[:, 2:4]
    pairs = cKDTree(place).query_pairs(gap + 0.5, output_type="ndarray").astype(np.int64)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    between = place[pairs[:, 1]] - place[pairs[:, 0]]
    distance = np.sqrt((between**2).sum(axis=1))
    one, other = _angle(ahead[pairs[:, 0]], between), _angle(ahead[pairs[:, 1]], -between)
    fit = (distance <= gap) & (np.maximum(one, other) <= np.radians(angle))
    return pairs[fit], (distance / gap + (one + other) / np.radians(2 * angle))[fit]


def _angle(one: Int64, other: Int64) -> NDArray[np.float64]:
    dot = (one * other).sum(axis=1)
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    angle: NDArray[np.float64] = np.arctan2(np.abs(cross), dot)
    return angle


def _show_points(
    graph: Graph, chains: Chains, load_tile: LoadTile, tips: _Tips, pairs: Int64, cosine: float, gap: float
) -> tuple[Int64, Bool]:
    """Squared distance and canonical position of the nearest point ahead of each tip; the blocked pairs."""
    nearest = np.full((len(tips.pixel), 2), np.iinfo(np.int64).max)
    blocked = np.zeros(len(pairs), bool)
    pair_start = np.searchsorted(pairs[:, 0], np.arange(len(tips.pixel) + 1))
    others = np.ascontiguousarray(pairs[:, 1])
    edge_of_chain = np.full(len(chains.start), -1)
    chain_of_part = np.searchsorted(chains.offsets, graph.part_start, side="right") - 1
    edge_of_chain[chain_of_part] = run_of_rows(graph.offsets)
    edge = edge_of_chain[np.searchsorted(chains.offsets, chains.slice_position[:-1], side="right") - 1]
    count = np.diff(chains.slice_position)
    for tile, slices in tiles_of_slices(chains):
        look_ahead(
            load_tile(tile)[0].pixels,
            chains.slice_source[slices] - chains.tile_offsets[tile],
            chains.slice_step[slices].astype(np.int64),
            count[slices],
            chains.slice_position[slices],
            edge[slices],
            chains.width,
            tips.cell,
            tips.cell_start,
            tips.cells_across,
            tips.facts,
            others,
            pair_start,
            cosine,
            gap,
            nearest,
            blocked,
        )
    return nearest, blocked


def _cut(graph: Graph, chains: Chains, load_tile: LoadTile, positions: Int64) -> tuple[Graph, Int64]:
    """Cut edges at canonical positions; return the cut graph and the node pixel at each position."""
    by_start = np.argsort(graph.part_start)
    part = by_start[np.searchsorted(graph.part_start[by_start], positions, side="right") - 1]
    edge = np.searchsorted(graph.offsets, part, side="right") - 1
    parts = graph.offsets, graph.part_start, graph.part_stop, graph.part_backward
    start_position, _ = points_behind(*parts, 2 * np.arange(len(graph)), 0)
    end_position, _ = points_behind(*parts, 2 * np.arange(len(graph)) + 1, 0)
    node = pixels_at(chains, load_tile, positions)
    at_start, at_end = start_position[edge] == positions, end_position[edge] == positions
    node = np.where(at_start, graph.start[edge], np.where(at_end, graph.end[edge], node))

    _, first = np.unique(positions, return_index=True)
    cuts = first[~(at_start | at_end)[first]]
    along = np.where(graph.part_backward[part], -positions, positions)
    cuts = cuts[np.lexsort((along[cuts], part[cuts]))]
    parent, offsets, start, stop, backward = cut_parts(*parts, edge[cuts], part[cuts], positions[cuts])
    later = np.flatnonzero(parent[1:] == parent[:-1]) + 1
    start_node, end_node = graph.start[parent], graph.end[parent]
    start_node[later], end_node[later - 1] = node[cuts], node[cuts]
    whole = stop - start > 1
    # A piece without a stretch of its own chain comes after all positions and all bridges.
    key = reduce_runs(np.minimum, np.where(whole, start, start + 2 * chains.offsets[-1]), offsets)
    pieces = Graph(
        start_node,
        end_node,
        graph.axial[parent],
        graph.diagonal[parent],
        key,
        offsets,
        start,
        stop,
        backward,
        graph.member_node,
        graph.member_pixel,
        graph.member_position,
    )
    return _measured(pieces, chains, load_tile, np.union1d(later, later - 1)), node


def _measured(graph: Graph, chains: Chains, load_tile: LoadTile, pieces: Int64) -> Graph:
    """Count the links of ``pieces`` anew, from their pixels."""
    axial, diagonal = graph.axial.copy(), graph.diagonal.copy()
    points = graph.points
    for batch in np.split(pieces, np.flatnonzero(np.diff(np.cumsum(points[pieces]) // BATCH_POINTS)) + 1):
        part = np.concatenate([np.arange(*graph.offsets[i : i + 2]) for i in batch] or [np.empty(0, np.int64)])
        parts = graph.part_start[part], graph.part_stop[part], graph.part_backward[part]
        pixels, _ = gather(chains, load_tile, *parts)
        axial[batch], diagonal[batch] = count_steps(pixels, offsets_of(points[batch]), chains.width)
    return replace(graph, axial=axial, diagonal=diagonal)


def _bridges(tips: _Tips, chains: Chains, pairs: Int64, origin: Int64, target: Int64, target_node: Int64) -> Graph:
    """Edges of two points: between paired tips, and from lone tips to the points ahead of them."""
    tip = tips.pixel
    pairs = np.where((tip[pairs[:, 0]] < tip[pairs[:, 1]])[:, None], pairs, pairs[:, ::-1])
    start = np.concatenate([tip[pairs[:, 0]], tip[origin]])
    end = np.concatenate([tip[pairs[:, 1]], target_node])
    points = np.concatenate([tips.position[pairs], np.stack([tips.position[origin], target], axis=1)])
    # Two lone tips that chose each other need one bridge only.
    _, first = np.unique(np.sort(np.stack([start, end], axis=1), axis=1), axis=0, return_index=True)
    start, end, points = start[first], end[first], points[first]
    axial, diagonal = count_steps(np.stack([start, end], axis=1).ravel(), 2 * np.arange(len(start) + 1), chains.width)
    flat = points.ravel()
    none = np.empty(0, np.int64)
    return Graph(
        start,
        end,
        axial,
        diagonal,
        chains.offsets[-1] + points[:, 0],
        2 * np.arange(len(start) + 1),
        flat,
        flat + 1,
        np.zeros(len(flat), bool),
        none,
        none,
        none,
    )


def _concatenate(one: Graph, other: Graph) -> Graph:
    names = ("start", "end", "axial", "diagonal", "key", "part_start", "part_stop", "part_backward")
    together = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in names}
    return replace(one, offsets=np.concatenate([one.offsets, one.offsets[-1] + other.offsets[1:]]), **together)
