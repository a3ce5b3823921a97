"""The edges at every node of a graph, on the device: what threads of single nodes walk."""

from __future__ import annotations

from typing import Any, NamedTuple

from tilepipe_kernels.core.arrays import namespace


class Incidence(NamedTuple):
    """Edges by node.

    Attributes
    ----------
    offsets
        int32 (n + 1,): the edges at node i are ``incident[offsets[i]:offsets[i + 1]]``.
    incident
        int32 (2 m,): edges, ascending at every node, so that sums over them come in the order of a loop over edges.
    """

    offsets: Any
    incident: Any


def incidence(edges: Any, nodes: int) -> Incidence:
    """Find the edges at every node; ``edges``, int32 (m, 2), go from the lower to the upper node and are sorted."""
    xp = namespace(edges)
    # edges from lower nodes come before those to upper ones, so that a stable sort keeps them all ascending
    ends = xp.concatenate((edges[:, 1], edges[:, 0]))
    order = xp.argsort(ends, kind="stable")
    offsets = xp.searchsorted(ends[order], xp.arange(nodes + 1, dtype=ends.dtype)).astype(xp.int32)
    return Incidence(offsets, (order % max(len(edges), 1)).astype(xp.int32))
