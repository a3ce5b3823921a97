"""Reconciliation: a graph of seam facts goes in, a lookup table comes out.

Every tile numbers its features from 1 on; number 0 means none.  A `Numbering` lays these local numbers end to end, a
list of pairs says which of them are one feature, and `unite` gives every number its feature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Numbering:
    """Local feature numbers of all tiles laid end to end: feature ``n`` of tile ``t`` is ``offsets[t] + n - 1``."""

    offsets: NDArray[np.int64]

    @classmethod
    def of_counts(cls, counts: NDArray[np.int64]) -> Numbering:
        """From the number of features of each tile."""
        return cls(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))

    @property
    def total(self) -> int:
        """Number of local features of all tiles."""
        return int(self.offsets[-1])

    def globalise(self, tile: int, numbers: NDArray[np.integer]) -> NDArray[np.int64]:
        """Global numbers of a tile's local numbers; -1 for local number 0."""
        return np.where(numbers > 0, numbers.astype(np.int64) + (self.offsets[tile] - 1), -1)


def unite(total: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Connected components of a graph.

    Parameters
    ----------
    total
        Number of nodes.
    pairs
        Edges, shape (n, 2); their order does not matter.

    Returns
    -------
    ndarray of int64, shape (total,)
        Component of each node, numbered from 0 by the lowest node of each component.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(pairs), np.uint8), (pairs[:, 0], pairs[:, 1])), shape=(total, total))
    count, component = connected_components(graph, directed=False)
    first = np.full(count, total, np.int64)
    np.minimum.at(first, component, np.arange(total))
    rank = np.empty(count, np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(count)
    united: NDArray[np.int64] = rank[component]
    return united
