"""The network's tools for one array in memory: street graphs and pruned skeletons without tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.network.build import LineBatch, Network, build_network, line_batch
from tilepipe_kernels.network.cleaning import Cleaning, OnBorder, nowhere, prune
from tilepipe_kernels.network.fragment_table import summarise
from tilepipe_kernels.network.points import Attributes, LoadTile, gather
from tilepipe_kernels.network.skeleton import skeleton_links
from tilepipe_kernels.network.street_graph import graph_of, join
from tilepipe_kernels.network.tracing import Fragments, trace


def trace_lines(
    links: NDArray[np.uint8],
    cleaning: Cleaning | None = None,
    response: NDArray[np.float32] | None = None,
    on_border: OnBorder = nowhere,
) -> tuple[Network, LineBatch]:
    """Street graph of one array.

    Parameters
    ----------
    links
        uint8, shape (rows, columns): pixel graph, see ``tilepipe_kernels.network.tracing``.
    cleaning
        What to clean.
    response
        float32, shape (rows, columns), for hysteresis; it becomes the point attribute ``response``.
    on_border
        Tells which node pixels lie on the border.

    Returns
    -------
    network, lines
        The graph, and all its lines in one batch.

    Examples
    --------
    A street that forks: three lines that meet in one node.

    >>> import numpy as np
    >>> from tilepipe_kernels.network.one_array import trace_lines
    >>> from tilepipe_kernels.network.skeleton import skeleton_links
    >>> skeleton = np.zeros((9, 9), bool)
    >>> skeleton[4, :] = skeleton[4:, 4] = True
    >>> network, lines = trace_lines(skeleton_links(skeleton))
    >>> network.length.tolist(), network.node_degree.tolist()
    ([4.0, 4.0, 4.0], [1, 3, 1, 1])
    """
    fragments = trace(links)
    attributes = {} if response is None else {"response": response.astype(np.float32).ravel()[fragments.pixels]}
    load_tile = _one_tile(fragments, attributes)
    table = summarise(fragments, links.shape[1], attributes.get("response"))
    network = build_network([table], links.shape[1], load_tile, cleaning, on_border)
    return network, line_batch(network, load_tile, 0, len(network))


def prune_skeleton(skeleton: NDArray[Any], length: float) -> NDArray[np.bool_]:
    """Remove terminal branches shorter than ``length`` from a skeleton.

    Parameters
    ----------
    skeleton
        Any real dtype, shape (rows, columns): nonzero = line, one pixel wide.
    length
        In pixels; diagonal links count the square root of 2. Pieces without junctions are left as they are.

    Returns
    -------
    ndarray
        bool, shape (rows, columns).

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.one_array import prune_skeleton
    >>> skeleton = np.zeros((9, 20), bool)
    >>> skeleton[4, :] = skeleton[2:4, 10] = True  # a spur of two pixels on a street
    >>> pruned = prune_skeleton(skeleton, length=5)
    >>> bool(pruned[4].all()), int(pruned[:4].sum())
    (True, 0)
    """
    links = skeleton_links(np.asarray(skeleton) != 0)
    fragments = trace(links)
    width = links.shape[1]
    chains = join([summarise(fragments, width)], width)
    graph = prune(graph_of(chains), length)
    load_tile = _one_tile(fragments, {})
    pixels, _ = gather(chains, load_tile, graph.part_start, graph.part_stop, graph.part_backward)
    pruned = np.zeros(links.shape, bool)
    pruned.ravel()[pixels] = True
    pruned |= (np.asarray(skeleton) != 0) & (links == 0)
    return pruned


def _one_tile(fragments: Fragments, attributes: Attributes) -> LoadTile:
    return lambda tile: (fragments, attributes)
