"""Which shell a hole lies in: a region of several parts has a shell of each, and holes of some."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Vertices
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.polylines.arcs import Labels
from tilepipe_kernels.polylines.join import Arcs

Int32 = NDArray[np.int32]


def shells_of_rings(
    arcs: Arcs, ring_offsets: Int64, half_arcs: Int32, region: Labels, is_shell: NDArray[np.bool_], contour: Int64
) -> Int64:
    """Shell of each ring: of one contour at most one ring is a shell; a region's only shell holds all its holes."""
    shells = np.flatnonzero(is_shell)
    of_contour = np.full(contour.max(initial=-1) + 1, -1, np.int64)
    of_contour[contour[shells]] = shells
    shell = of_contour[contour]
    free = np.flatnonzero(shell < 0)
    if free.size == 0:
        return shell
    by_region = shells[np.argsort(region[shells], kind="stable")]
    first = np.searchsorted(region[by_region], region[free])
    alone = np.searchsorted(region[by_region], region[free], side="right") == first + 1
    shell[free[alone]] = by_region[first[alone]]
    free = free[~alone]
    if free.size:
        lowest = _lowest_corners(free, ring_offsets, half_arcs, arcs.offsets, arcs.vertices)
        members = np.flatnonzero(np.isin(region, region[free]))
        sides = _western_sides(members, ring_offsets, half_arcs, arcs.offsets, arcs.vertices)
        rings = np.concatenate([free, sides[:, 2]])
        rows, columns = (np.concatenate([lowest[:, k], sides[:, k]]) for k in range(2))
        # In a row of a region the side before a hole is the nearest one to its west, of the same part.
        order = np.lexsort((np.arange(rings.size) >= free.size, columns, rows, region[rings]))
        last = np.maximum.accumulate(np.where(order >= free.size, np.arange(order.size), -1))
        west = np.empty(free.size, np.int64)
        holes = order < free.size
        west[order[holes]] = rings[order[last[holes]]]
        for k in np.lexsort((lowest[:, 1], lowest[:, 0])):
            shell[free[k]] = shell[west[k]]
    return shell


@loop
def _lowest_corners(
    rings: Int64, ring_offsets: Int64, half_arcs: Int32, offsets: Int64, vertices: Vertices
) -> NDArray[np.int32]:
    lowest = np.full((len(rings), 2), np.iinfo(np.int32).max, np.int32)
    for i, ring in enumerate(rings):
        for half in half_arcs[ring_offsets[ring] : ring_offsets[ring + 1]]:
            for k in range(offsets[half >> 1], offsets[(half >> 1) + 1]):
                if (vertices[k, 0], vertices[k, 1]) < (lowest[i, 0], lowest[i, 1]):
                    lowest[i, 0], lowest[i, 1] = vertices[k, 0], vertices[k, 1]
    return lowest


@loop
def _western_sides(
    rings: Int64, ring_offsets: Int64, half_arcs: Int32, offsets: Int64, vertices: Vertices
) -> NDArray[np.int64]:
    """Row, column and ring of each crack with the ring's region on its east: those that the ring goes down."""
    sides = np.empty((0, 3), np.int64)
    for fill in (False, True):
        count = 0
        for ring in rings:
            for half in half_arcs[ring_offsets[ring] : ring_offsets[ring + 1]]:
                for k in range(offsets[half >> 1] + 1, offsets[(half >> 1) + 1]):
                    top, bottom = vertices[k - 1, 0], vertices[k, 0]
                    if half & 1:
                        top, bottom = bottom, top
                    for row in range(top, bottom):
                        if fill:
                            sides[count, 0], sides[count, 1], sides[count, 2] = row, vertices[k, 1], ring
                        count += 1
        if not fill:
            sides = np.empty((count, 3), np.int64)
    return sides
