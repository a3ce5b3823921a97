"""The street graph as tables: joining fragments to chains, and keeping edges in their one canonical order.

Two numberings of the same points matter here. *Stored* points stand tile after tile as traced; that order
depends on the tiling. *Canonical* positions count the points chain after chain, where chains are sorted by
their lowest link and each has one canonical direction; that order depends on the pixels alone. All
decisions are taken on canonical numbers, so the tiling cannot be seen in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.ragged import Int64, offsets_of, reduce_runs
from tilepipe_kernels.network.chain_loops import rearrange, walk_chains
from tilepipe_kernels.network.fragment_table import FragmentTable
from tilepipe_kernels.network.tracing import CROSSING, NODE

Bool = NDArray[np.bool_]

DIAGONAL = float(np.sqrt(2.0))


@dataclass(frozen=True)
class Chains:
    """The lines of the pixel graph between two nodes, or closed rings, in canonical order.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): canonical positions of chain i are ``offsets[i]`` to ``offsets[i + 1]``; a
        ring's first point is repeated as its last.
    start, end
        int64, shape (n,): node pixels; the lowest pixel at both ends of a ring.
    axial, diagonal
        int64, shape (n,): numbers of links.
    strength
        float32, shape (n,): greatest response of the chain's pixels.
    slice_position, slice_source, slice_step
        Where the points are stored: slice i fills the canonical positions from ``slice_position[i]`` to
        ``slice_position[i + 1]`` with the stored points ``slice_source[i]``, ``+ slice_step[i]``, ...
    tile_offsets
        int64, shape (tiles + 1,): bounds of the tiles in the stored order.
    width
        Columns of the raster.
    """

    offsets: Int64
    start: Int64
    end: Int64
    axial: Int64
    diagonal: Int64
    strength: NDArray[np.float32]
    slice_position: Int64
    slice_source: Int64
    slice_step: NDArray[np.int8]
    tile_offsets: Int64
    width: int


@dataclass(frozen=True)
class Graph:
    """Edges between nodes, sorted by ``key``; a node is named by a pixel.

    Attributes
    ----------
    start, end
        int64, shape (n,): node pixels, ``start <= end``.
    axial, diagonal
        int64, shape (n,): numbers of links; lengths for decisions are computed from these two integers
        only.
    key
        int64, shape (n,): lowest canonical position of the edge; unique.
    offsets, part_start, part_stop, part_backward
        Edge i goes in order through the parts ``offsets[i]`` to ``offsets[i + 1]``; a part is the canonical
        positions [start, stop), read from its end where backward.
    member_node, member_pixel, member_position
        int64, shape (m,): node pixels contracted to ``member_node``, a canonical position of each; sorted by node
        and pixel.
    """

    start: Int64
    end: Int64
    axial: Int64
    diagonal: Int64
    key: Int64
    offsets: Int64
    part_start: Int64
    part_stop: Int64
    part_backward: Bool
    member_node: Int64
    member_pixel: Int64
    member_position: Int64

    def __len__(self) -> int:
        return len(self.start)

    @property
    def length(self) -> NDArray[np.float64]:
        """Length in pixels, shape (n,)."""
        return chain_length(self.axial, self.diagonal)

    @property
    def points(self) -> Int64:
        """Number of points of each edge's parts, int64, shape (n,)."""
        return reduce_runs(np.add, self.part_stop - self.part_start, self.offsets)

    def node_positions(self, count: int, index: Int64) -> Int64:
        """A canonical position of each of ``count`` nodes, from the node index of each edge end (see `degrees`)."""
        first, last = self.offsets[:-1], self.offsets[1:] - 1
        position = np.empty(count, np.int64)
        position[index[::2]] = np.where(self.part_backward[first], self.part_stop[first] - 1, self.part_start[first])
        position[index[1::2]] = np.where(self.part_backward[last], self.part_start[last], self.part_stop[last] - 1)
        return position

    def degrees(self) -> tuple[Int64, Int64, Int64]:
        """Node pixels (sorted), number of edge ends at each, and the node index of each of the 2 n ends."""
        ends = np.stack([self.start, self.end], axis=1).ravel()
        nodes, index = np.unique(ends, return_inverse=True)
        return nodes, np.bincount(index, minlength=len(nodes)), index


def chain_length(axial: Int64, diagonal: Int64) -> NDArray[np.float64]:
    """Length of 8-connected chains in pixels: axial steps count 1, diagonal ones the square root of 2.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.street_graph import chain_length
    >>> chain_length(np.array([10, 0]), np.array([0, 10])).round(2).tolist()
    [10.0, 14.14]
    """
    return axial + DIAGONAL * diagonal


def join(tables: Sequence[FragmentTable], width: int) -> Chains:
    """Join the fragments of all tiles to chains between nodes.

    Parameters
    ----------
    tables
        Fragment tables of the tiles; their order fixes the stored order, not the result's canonical order.
    width
        Columns of the raster.

    Returns
    -------
    Chains
        Sorted by lowest link. A chain runs from its lower node; a loop at one node toward its lower second
        pixel; a ring from its lowest pixel toward that pixel's lower neighbour.

    Raises
    ------
    ValueError
        If a link crosses a seam and no tile holds its other side.
    """
    if not tables:
        raise ValueError("no fragment tables: give one for each tile")
    table = FragmentTable(
        *(np.concatenate([getattr(t, name) for t in tables]) for name in FragmentTable.__dataclass_fields__)
    )
    ends = np.stack([table.lowest_pixel] * 2, axis=1)
    toward_lower = np.argsort(table.lowest_neighbour[:, ::-1], axis=1)
    members_of, members, backward, closed = walk_chains(_mates(table), (2 * ends + toward_lower).ravel())

    first, last = members_of[:-1], members_of[1:] - 1
    start, start_second = _at_end(table, members[first], backward[first].astype(np.int64))
    end, end_second = _at_end(table, members[last], 1 - backward[last].astype(np.int64))
    flip = ~closed & ((start > end) | ((start == end) & (start_second > end_second)))
    order = np.argsort(reduce_runs(np.minimum, table.lowest_link[members], members_of), kind="stable")
    bounds, source, turned = rearrange(members_of, order, flip[order])
    start, end = np.minimum(start, end)[order], np.maximum(start, end)[order]
    members, backward, closed = members[source], backward[source] ^ turned, closed[order]
    lowest = reduce_runs(np.minimum, table.lowest_pixel[members], bounds)
    slices = _slices(table, bounds, members, backward, closed)
    return Chains(
        slices[0],
        np.where(closed, lowest, start),
        np.where(closed, lowest, end),
        reduce_runs(np.add, table.axial[members], bounds),
        reduce_runs(np.add, table.diagonal[members], bounds),
        reduce_runs(np.maximum, table.strength[members], bounds),
        *slices[1:],
        np.cumsum([0, *(int(t.count.sum()) for t in tables)]),
        width,
    )


def _mates(table: FragmentTable) -> Int64:
    """Find the end joined to each fragment end: across a seam, or a ring's own other end, or -1 at a node."""
    kind = table.end_kind.ravel()
    mate = np.where(kind == NODE, -1, np.arange(len(kind)) ^ 1)
    crossing = np.flatnonzero(kind == CROSSING)
    link = table.end_link.ravel()[crossing]
    order = np.argsort(link, kind="stable")
    crossing, link = crossing[order], link[order]
    if len(link) % 2 or not np.array_equal(link[::2], link[1::2]) or np.any(link[1:-1:2] == link[2::2]):
        raise ValueError("a line crosses a seam but stops there: trace all tiles of one raster, each once")
    mate[crossing[::2]], mate[crossing[1::2]] = crossing[1::2], crossing[::2]
    return mate


def _at_end(table: FragmentTable, fragment: Int64, side: Int64) -> tuple[Int64, Int64]:
    return table.end_node[fragment, side], table.second_pixel[fragment, side]


def _slices(
    table: FragmentTable, bounds: Int64, members: Int64, backward: Bool, closed: Bool
) -> tuple[Int64, Int64, Int64, NDArray[np.int8]]:
    """Chain offsets in canonical positions, and the slices of stored points that fill them."""
    stored = np.cumsum(table.count) - table.count
    count = table.count[members]
    source = stored[members] + np.where(backward, count - 1, 0)
    # A ring is cut at its lowest pixel: the first fragment gives its tail now and its head at the ring's end.
    ring = np.flatnonzero(closed)
    cut = bounds[:-1][ring]
    lowest = table.lowest_index[members[cut]]
    head = np.where(backward[cut], count[cut] - lowest, lowest + 1)
    head_source = source[cut].copy()
    source[cut] = stored[members[cut]] + lowest
    count[cut] += 1 - head
    after = bounds[1:][ring]
    source, count = np.insert(source, after, head_source), np.insert(count, after, head)
    step = np.where(np.insert(backward, after, backward[cut]), -1, 1).astype(np.int8)
    position = offsets_of(count)
    return position[bounds + offsets_of(closed)], position, source, step


def graph_of(chains: Chains) -> Graph:
    """Make the graph whose edges are the chains, one part each."""
    count = len(chains.start)
    none = np.empty(0, np.int64)
    start, stop = chains.offsets[:-1], chains.offsets[1:]
    parts = np.arange(count + 1), start, stop, np.zeros(count, bool)
    return Graph(chains.start, chains.end, chains.axial, chains.diagonal, start, *parts, none, none, none)


def take(graph: Graph, order: Int64, flip: Bool) -> Graph:
    """Take the edges ``order`` in that order, turned round where ``flip``."""
    offsets, source, flipped = rearrange(graph.offsets, order, flip)
    return replace(
        graph,
        start=np.where(flip, graph.end[order], graph.start[order]),
        end=np.where(flip, graph.start[order], graph.end[order]),
        axial=graph.axial[order],
        diagonal=graph.diagonal[order],
        key=graph.key[order],
        offsets=offsets,
        part_start=graph.part_start[source],
        part_stop=graph.part_stop[source],
        part_backward=graph.part_backward[source] ^ flipped,
    )


def keep(graph: Graph, kept: Bool) -> Graph:
    """Keep the edges where ``kept`` (shape (n,)), in their order."""
    if kept.all():
        return graph
    order = np.flatnonzero(kept)
    return take(graph, order, np.zeros(len(order), bool))


def canonical(graph: Graph) -> Graph:
    """Turn every edge to run from its lower node and sort the edges by key.

    Loops stay as they were found: that was a walk over canonical edges, so it is the same for any tiling.
    """
    order = np.argsort(graph.key, kind="stable")
    return take(graph, order, (graph.start > graph.end)[order])


def dissolve(graph: Graph) -> Graph:
    """Join the two edges that meet at each node of degree two.

    A cycle of such nodes becomes a loop at the lowest of them.
    """
    nodes, degree, index = graph.degrees()
    passed = np.flatnonzero(degree[index] == 2)
    passed = passed[np.argsort(index[passed], kind="stable")]
    one, other = passed[::2], passed[1::2]
    between = one >> 1 != other >> 1
    if not between.any():
        return graph
    one, other = one[between], other[between]
    mate = np.full(2 * len(graph), -1)
    mate[one], mate[other] = other, one
    offsets, members, backward, _ = walk_chains(mate, nodes[index])
    parts = take(graph, members, backward)
    last = offsets[1:] - 1
    joined = replace(
        parts,
        start=parts.start[offsets[:-1]],
        end=parts.end[last],
        axial=reduce_runs(np.add, parts.axial, offsets),
        diagonal=reduce_runs(np.add, parts.diagonal, offsets),
        key=reduce_runs(np.minimum, parts.key, offsets),
        offsets=parts.offsets[offsets],
    )
    return canonical(joined)
