"""Connected components of a region graph, counted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.core.union_find import flatten, unite
from tilepipe_kernels.regions.colouring import Edges


def count_components(edges: Edges, marked: NDArray[np.bool_]) -> tuple[int, int]:
    """Count the connected components, and those among them without any marked node.

    Parameters
    ----------
    edges
        Pairs of nodes, int32, shape (m, 2).
    marked
        bool, shape (n,).

    Returns
    -------
    components, unmarked
        Two numbers.

    Examples
    --------
    Nodes 0 and 1 are joined, 2 and 3 too; of these only 0 has data.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.components import count_components
    >>> count_components(np.array([[0, 1], [2, 3]], np.int32), np.array([True, False, False, False]))
    (2, 1)
    """
    if on_device(edges, marked):
        device = device_form(__name__)
        return device.count_components(edges, marked)
    return _count_components(edges, marked)


@loop
def _count_components(edges: Edges, marked: NDArray[np.bool_]) -> tuple[int, int]:
    root = np.arange(marked.size).astype(np.int32)
    for edge in range(edges.shape[0]):
        unite(root, edges[edge, 0], edges[edge, 1])
    flatten(root)
    found = np.zeros(marked.size, np.bool_)
    components = with_mark = 0
    for node in range(marked.size):
        components += root[node] == node
        if marked[node] and not found[root[node]]:
            found[root[node]] = True
            with_mark += 1
    return components, components - with_mark
