"""Union–find: sets of sites that grow together, each known by its smallest site, in whatever order they are united.

``parent`` is int32 or int64, shape (sites,): each site's parent, itself if it is a root. It begins as
``np.arange(sites)``, and a parent is never larger than its site.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop

Parents = NDArray[Any]


@loop
def root_of(parent: Parents, site: int) -> int:
    """Smallest site united with this one; on the way every site is hung on its parent's parent."""
    while parent[site] != site:
        parent[site] = parent[parent[site]]
        site = parent[site]
    return site


@loop
def unite(parent: Parents, a: int, b: int) -> None:
    """Unite the sets of two sites: the larger root is hung on the smaller one."""
    a, b = root_of(parent, a), root_of(parent, b)
    parent[max(a, b)] = min(a, b)


@loop
def flatten(parent: Parents) -> None:
    """Let every site point at its root."""
    for site in range(parent.size):
        # the parent is not larger, so that it points at its root already
        parent[site] = parent[parent[site]]
