"""Union-find by many threads at once: the root of a set is its smallest site, whatever the order of the work."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda

Sites = Any
"""int32 or int64 (sites,) on the device: each site's parent, itself if it is a root."""


@cuda.jit(device=True)
def root_of(parent: Sites, site: int) -> int:
    """Smallest site known to be united with this one.

    On the way every site is hung on its parent's parent: rows of united sites begin as chains, which all their threads
    halve at once.  What a thread writes over is a longer way to the same root, whoever has written it.
    """
    above = parent[site]
    while above != site:
        further = parent[above]
        if further < above:
            parent[site] = further
        site, above = above, further
    return site


@cuda.jit(device=True)
def unite(parent: Sites, a: int, b: int) -> None:
    """Unite the sets of two sites: the larger root is hung on the smaller one (Jaiganesh & Burtscher 2018)."""
    a, b = root_of(parent, a), root_of(parent, b)
    while a != b:
        if a < b:
            a, b = b, a
        before = cuda.atomic.min(parent, a, b)
        # another thread may have hung the root elsewhere meanwhile: that set is to be united then
        if before == a:
            return
        a = root_of(parent, before)
        b = root_of(parent, b)


@grid
def flatten(count: int, parent: Sites) -> None:
    """Let every site point at its root."""
    for site in range(cuda.grid(1), count, cuda.gridsize(1)):
        parent[site] = root_of(parent, site)
