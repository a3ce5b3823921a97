"""The polyline network: fragments of all tiles in, one clean street graph out, the same for any tiling.

Topology is solved on fragment tables alone (about 120 bytes a fragment); points stay in their tiles and are
gathered in batches when lines are written. So memory is bounded by the number of fragments, one tile and
one batch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import Int64, offsets_of, run_of_rows
from tilepipe_kernels.network.cleaning import (
    Cleaning,
    OnBorder,
    contract,
    drop_short_components,
    drop_twins,
    hysteresis,
    nowhere,
    prune,
)
from tilepipe_kernels.network.close_gaps import close_gaps
from tilepipe_kernels.network.fragment_table import FragmentTable
from tilepipe_kernels.network.points import LoadTile, coordinates, gather
from tilepipe_kernels.network.street_graph import Bool, Chains, Graph, dissolve, graph_of, join


@dataclass(frozen=True)
class Network:
    """A street graph of n lines between m nodes.

    Attributes
    ----------
    start, end
        int64, shape (n,): node ids (1 to m) of lines 1 to n.
    length
        float64, shape (n,): length of each line's pixel chain in pixels.
    node_pixel
        int64, shape (m,), ascending: global flat index of each node; the lowest one of a contracted
        cluster.
    node_xy
        float64, shape (m, 2): (x, y) in pixels from the raster's upper left corner.
    node_degree
        int64, shape (m,): number of line ends; 2 only where a closed ring starts and ends.
    graph, chains
        The tables from which `iterate_lines` gathers the lines' points.
    """

    start: Int64
    end: Int64
    length: NDArray[np.float64]
    node_pixel: Int64
    node_xy: NDArray[np.float64]
    node_degree: Int64
    graph: Graph
    chains: Chains

    def __len__(self) -> int:
        return len(self.start)


@dataclass(frozen=True)
class LineBatch:
    """Consecutive lines with their points.

    Attributes
    ----------
    line, start, end
        int64, shape (k,): line ids, and the node ids where they start and end.
    polylines
        Their points (x, y), float64, in pixels from the raster's upper left corner; pixel centres are at halves.
        The first and the last point are exactly the nodes'.
    pixel
        int64, shape (p,): global flat index of each point's pixel.
    attributes
        float32 arrays of shape (p,) by name, as given with the fragments, without ``dx`` and ``dy``.
    """

    line: Int64
    start: Int64
    end: Int64
    polylines: Polylines
    pixel: Int64
    attributes: dict[str, NDArray[np.float32]]


def build_network(
    tables: Sequence[FragmentTable],
    width: int,
    load_tile: LoadTile,
    cleaning: Cleaning | None = None,
    on_border: OnBorder = nowhere,
) -> Network:
    """Join fragments of all tiles to a street graph and clean it.

    Parameters
    ----------
    tables
        ``tilepipe_kernels.network.fragment_table.summarise`` of each tile, in the order of the tile indices.
    width
        Columns of the raster.
    load_tile
        Gives the fragments and the point attributes of a tile, by its index in ``tables``.
    cleaning
        What to clean; by default the lines are joined and left as they are.
    on_border
        Tells which node pixels lie on the raster's border, where lines are cut off and do not dangle.

    Returns
    -------
    Network
        The same, bit for bit, for any tiling.

    Raises
    ------
    ValueError
        If fragments of some tile are missing or do not belong to their table.
    """
    cleaning = cleaning or Cleaning()
    chains = join(tables, width)
    graph = graph_of(chains)
    if cleaning.high is not None:
        graph = dissolve(hysteresis(graph, chains.strength, cleaning.high, cleaning.through_junctions))
    if cleaning.contraction > 0:
        graph = contract(graph, cleaning.contraction)
    if cleaning.maximum_gap > 0:
        gap = cleaning.maximum_gap, cleaning.maximum_angle, cleaning.direction_steps
        graph = close_gaps(graph, chains, load_tile, *gap, on_border)
        # bridges make junctions of their own, two at each crossing
        graph = contract(graph, cleaning.contraction) if cleaning.contraction > 0 else graph
        graph = drop_twins(graph, 2 * cleaning.maximum_gap)
    if cleaning.minimum_branch > 0:
        graph = prune(graph, cleaning.minimum_branch, on_border)
    if cleaning.minimum_length > 0:
        graph = drop_short_components(graph, cleaning.minimum_length)
    nodes, degree, index = graph.degrees()
    xy = _node_positions(graph, chains, nodes, index, load_tile)
    return Network(index[::2] + 1, index[1::2] + 1, graph.length, nodes, xy, degree, graph, chains)


def iterate_lines(network: Network, load_tile: LoadTile, batch_points: int = 1_000_000) -> Iterator[LineBatch]:
    """Give the lines in id order with their points, in batches.

    Parameters
    ----------
    network
        n lines.
    load_tile
        As given to `build_network`; each batch loads each tile that its lines touch once.
    batch_points
        A batch ends when it holds this many points.

    Yields
    ------
    LineBatch
        Lines and points do not depend on the tiling nor on ``batch_points``.
    """
    graph = network.graph
    size = graph.points
    cuts = np.flatnonzero(np.diff(np.cumsum(size) // batch_points)) + 1
    for first, last in zip([0, *cuts.tolist()], [*cuts.tolist(), len(network)], strict=True):
        if last > first:
            yield line_batch(network, load_tile, first, last)


def _node_positions(
    graph: Graph, chains: Chains, nodes: Int64, index: Int64, load_tile: LoadTile
) -> NDArray[np.float64]:
    """Position of each node, shape (m, 2): of its pixel, or the mean of its members in ascending order."""
    if not len(nodes):
        return np.empty((0, 2))
    wanted = np.isin(graph.member_node, nodes)
    asked = np.concatenate([graph.node_positions(len(nodes), index), graph.member_position[wanted]])
    pixel, attributes = gather(chains, load_tile, asked, asked + 1, np.zeros(len(asked), bool))
    places = coordinates(pixel, attributes, chains.width)
    xy, members = places[: len(nodes)], places[len(nodes) :]
    if len(members):
        node, start, size = np.unique(graph.member_node[wanted], return_index=True, return_counts=True)
        xy[np.searchsorted(nodes, node)] = np.add.reduceat(members, start, axis=0) / size[:, None]
    return xy


def line_batch(network: Network, load_tile: LoadTile, first: int, last: int) -> LineBatch:
    """Lines ``first + 1`` to ``last``."""
    graph, chains = network.graph, network.chains
    parts = slice(graph.offsets[first], graph.offsets[last])
    start, stop = graph.part_start[parts], graph.part_stop[parts]
    pixel, attributes = gather(chains, load_tile, start, stop, graph.part_backward[parts])
    points = offsets_of(stop - start)[graph.offsets[first : last + 1] - graph.offsets[first]]
    line = run_of_rows(points)
    # Parts joined at a pixel both hold it.
    distinct = _differs(pixel) | _differs(line)
    pixel, line = pixel[distinct], line[distinct]
    attributes = {name: values[distinct] for name, values in attributes.items()}
    offsets = np.searchsorted(line, np.arange(last - first + 1))
    xy = coordinates(pixel, attributes, chains.width)
    xy[offsets[:-1]] = network.node_xy[network.start[first:last] - 1]
    xy[offsets[1:] - 1] = network.node_xy[network.end[first:last] - 1]
    named = {name: values for name, values in attributes.items() if name not in ("dx", "dy")}
    ends = network.start[first:last], network.end[first:last]
    return LineBatch(np.arange(first, last) + 1, *ends, Polylines(offsets, xy), pixel, named)


def _differs(values: Int64) -> Bool:
    """Whether each value differs from the one before."""
    return np.concatenate([[True], values[1:] != values[:-1]])[: len(values)]
