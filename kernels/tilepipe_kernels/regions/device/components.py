"""`components` on the device."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.union_find import flatten, unite


@grid
def _unite_edges(count: int, edges: Any, parent: Any) -> None:
    for edge in range(cuda.grid(1), count, cuda.gridsize(1)):
        unite(parent, edges[edge, 0], edges[edge, 1])


def united_by(edges: Any, nodes: int) -> Any:
    """Lowest node of the component of every node of a device graph, int32."""
    parent = namespace(edges).arange(nodes, dtype=np.int32)
    _unite_edges(len(edges), edges, parent)
    flatten(nodes, parent)
    return parent


def count_components(edges: Any, marked: Any) -> tuple[int, int]:
    """Components, and those without a marked node, as of `components.count_components`; the host reads both."""
    xp = namespace(edges)
    root = united_by(edges, marked.size)
    with_mark = xp.zeros(marked.size, bool)
    with_mark[root[marked]] = True
    components = int((root == xp.arange(root.size, dtype=xp.int32)).sum())
    return components, components - int(with_mark.sum())
