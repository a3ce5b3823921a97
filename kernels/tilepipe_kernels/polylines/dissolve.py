"""Arcs of regions dissolved into those of groups of regions: their common borders go, the others stay as they are."""

from __future__ import annotations

from dataclasses import replace

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

    Returns
    -------
    Arcs
        With the groups on their sides.

    Examples
    --------
    Three regions in a row, of which the first two are one building: their common border goes.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> from tilepipe_kernels.polylines.dissolve import dissolved
    >>> from tilepipe_kernels.polylines.join import join_arcs
    >>> arcs = join_arcs([trace_arcs(np.array([[1, 2, 3]] * 2, np.int32))])
    >>> buildings = dissolved(arcs, np.array([0, 7, 7, 8], np.uint32))
    >>> len(arcs.left), len(buildings.left)
    (6, 5)
    """
    left, right = group[arcs.left], group[arcs.right]
    return replace(arcs, left=left, right=right).taken(left != right)
