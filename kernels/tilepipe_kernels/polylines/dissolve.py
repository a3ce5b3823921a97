"""Arcs of regions dissolved into those of groups of regions: their common borders go, the others stay as they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.polylines.join import Arcs


def dissolved(arcs: Arcs, group: NDArray[np.uint32]) -> Arcs:
    """Arcs that part two groups of regions, in their order and with all their vertices.

    Parameters
    ----------
    arcs
        Arcs of all regions, exact or simplified: the same arcs remain of both.
    group
        Group of every region id, shape (regions + 1,), 0 = none; entry 0 stands for nodata.
    """
    left, right = group[arcs.left], group[arcs.right]
    parting = left != right
    sizes = np.diff(arcs.offsets)
    offsets = np.concatenate([[0], np.cumsum(sizes[parting])]).astype(np.int64)
    return Arcs(offsets, arcs.vertices[np.repeat(parting, sizes)], left[parting], right[parting])
