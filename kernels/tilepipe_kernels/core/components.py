"""Connected components of a graph, numbered by their lowest node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def connected_components(total: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
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

    Examples
    --------
    Six regions, of which 1, 3 and 4 are joined, and 2 and 5.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.components import connected_components
    >>> connected_components(6, np.array([[4, 3], [1, 4], [2, 5]])).tolist()
    [0, 1, 2, 1, 1, 2]
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components as components_of

    graph = coo_matrix((np.ones(len(pairs), np.uint8), (pairs[:, 0], pairs[:, 1])), shape=(total, total))
    count, component = components_of(graph, directed=False)
    first = np.full(count, total, np.int64)
    np.minimum.at(first, component, np.arange(total))
    rank = np.empty(count, np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(count)
    numbered: NDArray[np.int64] = rank[component]
    return numbered
