"""Polygons of regions, assembled from shared arcs: two neighbours have their common border from the same vertices.

A *half-arc* is an arc read in one of its two ways: ``2 * arc`` forward, ``2 * arc + 1`` backward, with the region it
bounds on its left. Its shells run counter-clockwise on a map with north up, its holes clockwise.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Vertices
from tilepipe_kernels.core.ragged import Int64, take_runs
from tilepipe_kernels.polylines.arcs import Labels
from tilepipe_kernels.polylines.cracks import heading_of
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.polygon_shells import Int32, shells_of_rings


@dataclass(frozen=True)
class PolygonRings:
    """Which half-arcs bound which region; the geometry is the arcs', exact or simplified.

    Attributes
    ----------
    region
        Region id of each polygon, shape (p,), ascending; a region of several parts has several polygons.
    polygon_offsets
        int64, shape (p + 1,): polygon i has the rings ``polygon_offsets[i]:polygon_offsets[i + 1]``, its shell first.
    ring_offsets
        int64, shape (r + 1,): ring k has ``half_arcs[ring_offsets[k]:ring_offsets[k + 1]]``, in order.
    half_arcs
        int32, shape (h,).
    """

    region: Labels
    polygon_offsets: Int64
    ring_offsets: Int64
    half_arcs: Int32

    def parts(self, size: int) -> Iterator[PolygonRings]:
        """All, the polygons of so many regions at a time."""
        first = np.flatnonzero(np.diff(self.region, prepend=0) != 0)
        bounds = np.append(first[::size], len(self.region))
        for begin, end in itertools.pairwise(bounds):
            polygons = self.polygon_offsets[begin : end + 1]
            rings = self.ring_offsets[polygons[0] : polygons[-1] + 1]
            yield PolygonRings(
                self.region[begin:end],
                polygons - polygons[0],
                rings - rings[0],
                self.half_arcs[rings[0] : rings[-1]],
            )

    def coordinates(self, arcs: Arcs, transform: Sequence[float]) -> tuple[NDArray[np.float64], Int64]:
        """Coordinates (x, y) of all rings, float64, shape (m, 2), and the bounds of the rings, int64, shape (r + 1,).

        ``transform`` are the coefficients a, b, c, d, e, f of an affine map: ``x = a * column + b * row + c`` and
        ``y = d * column + e * row + f``.
        """
        a, b, c, d, e, f = (float(coefficient) for coefficient in transform[:6])
        return _ring_coordinates(self.ring_offsets, self.half_arcs, arcs.offsets, arcs.vertices, (a, b, c, d, e, f))


def assemble_polygons(arcs: Arcs) -> PolygonRings:
    """Find the rings of every region, its shells and its holes.

    At a junction a ring turns left as soon as it can, so that pixels which only touch at a corner belong to
    different polygons; a ring that comes to a corner for the second time is split there, so that every ring is simple
    and two rings of a polygon touch at most in points, as the Simple Feature Access standard (OGC 06-103r4) asks.

    Parameters
    ----------
    arcs
        All arcs of a raster, not simplified.

    Returns
    -------
    PolygonRings
        Of all regions but 0.

    Raises
    ------
    ValueError
        If the arcs do not close (they are not those of a whole raster), are simplified, or more than 2**30.

    Examples
    --------
    A courtyard in a building: the building has a shell and a hole, the courtyard a shell.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> from tilepipe_kernels.polylines.join import join_arcs
    >>> from tilepipe_kernels.polylines.polygons import assemble_polygons
    >>> labels = np.array([[1, 1, 1], [1, 2, 1], [1, 1, 1]], np.int32)
    >>> rings = assemble_polygons(join_arcs([trace_arcs(labels)]))
    >>> rings.region.tolist(), np.diff(rings.polygon_offsets).tolist()
    ([1, 2], [2, 1])
    """
    if len(arcs) >= 2**30:
        raise ValueError(f"{len(arcs)} arcs are more than 2**30: divide the raster")
    if not _along_cracks(arcs.offsets, arcs.vertices):
        raise ValueError("arcs leave the cracks between pixels: assemble them first, and simplify them afterwards")
    leaving, node, count = _nodes(arcs.offsets, arcs.vertices)
    following = _following(leaving, node, count)
    region: NDArray[Any] = np.empty(2 * len(arcs), arcs.left.dtype)
    region[::2], region[1::2] = arcs.left, arcs.right
    wanted = region != 0
    if following.min(initial=0) < 0 or not np.array_equal(region[following], region):
        raise ValueError("arcs do not close to rings: assemble the arcs of a whole raster, before any is left out")
    area = _areas(arcs.offsets, arcs.vertices)
    ring_offsets, half_arcs, ring_area, contour = _trace_rings(node, following, wanted, area, count)
    ring_region = region[half_arcs[ring_offsets[:-1]]]
    shell = shells_of_rings(arcs, ring_offsets, half_arcs, ring_region, ring_area > 0, contour)
    return _grouped(ring_offsets, half_arcs, ring_region, shell)


def _grouped(ring_offsets: Int64, half_arcs: Int32, region: Labels, shell: Int64) -> PolygonRings:
    """Sort rings by region, then by shell; a shell goes before its holes."""
    rings = np.arange(len(shell), dtype=np.int32)
    shells = np.flatnonzero(shell == rings)
    shells = shells[np.argsort(region[shells], kind="stable")]
    rank = np.empty(len(shell), np.int32)
    rank[shells] = np.arange(len(shells))
    order = _counting_sort(2 * rank[shell] + (shell != rings), rings)
    polygon_offsets = np.append(np.flatnonzero((shell == rings)[order]), len(order))
    bounds, half_arcs = take_runs(order, ring_offsets, half_arcs)
    return PolygonRings(region[shells], polygon_offsets, bounds, half_arcs)


# ------------------------------------------------------------------------------------------------- half-arcs


@loop
def _along_cracks(offsets: Int64, vertices: Vertices) -> bool:
    for i in range(len(offsets) - 1):
        for k in range(offsets[i] + 1, offsets[i + 1]):
            if (vertices[k, 0] == vertices[k - 1, 0]) == (vertices[k, 1] == vertices[k - 1, 1]):
                return False
    return True


@loop
def _counting_sort(keys: Int32, order: Int32) -> Int32:
    """Sort ``order`` by its keys ≥ 0, stable."""
    into = np.zeros(keys.max() + 2 if keys.size else 1, np.int32)
    for key in keys:
        into[key + 1] += 1
    for k in range(1, into.size):
        into[k] += into[k - 1]
    result = np.empty_like(order)
    for item in order:
        result[into[keys[item]]] = item
        into[keys[item]] += 1
    return result


@loop
def _ends_in_order(offsets: Int64, vertices: Vertices) -> Int32:
    """Arcs in row-major order of their last corner."""
    n = len(offsets) - 1
    row, column = np.empty(n, np.int32), np.empty(n, np.int32)
    for arc in range(n):
        row[arc], column[arc] = vertices[offsets[arc + 1] - 1]
    return _counting_sort(row, _counting_sort(column, np.arange(n).astype(np.int32)))


@loop
def _nodes(offsets: Int64, vertices: Vertices) -> tuple[NDArray[np.uint8], Int32, int]:
    """For each half-arc the heading in which it leaves and the number of its first corner; number of such corners.

    The arcs are sorted by their first corners, so that a merge with the sorted last corners numbers both.
    """
    n = len(offsets) - 1
    leaving, node = np.empty(2 * n, np.uint8), np.empty(2 * n, np.int32)
    ends = _ends_in_order(offsets, vertices)
    node_row = node_column = np.int32(-1)
    count = starts = done = 0
    while done < n:
        # Ends come after the starts at the same corner; every start has an end that is not lower.
        end = ends[done]
        last = offsets[end + 1] - 1
        row, column = vertices[last]
        half, next_row, next_column = 2 * end + 1, vertices[last - 1, 0], vertices[last - 1, 1]
        if starts < n:
            first = offsets[starts]
            start_row, start_column = vertices[first]
            if start_row < row or (start_row == row and start_column <= column):
                row, column = start_row, start_column
                half, next_row, next_column = 2 * starts, vertices[first + 1, 0], vertices[first + 1, 1]
        if half & 1:
            done += 1
        else:
            starts += 1
        count += row != node_row or column != node_column
        node_row, node_column = row, column
        node[half] = count - 1
        leaving[half] = heading_of(row, column, next_row, next_column)
    return leaving, node, count


@loop
def _following(leaving: NDArray[np.uint8], node: Int32, count: int) -> Int32:
    """For each half-arc the one that goes on along the same region, or -1."""
    at = np.full((count, 4), -1, np.int32)
    for half in range(len(node)):
        at[node[half], leaving[half]] = half
    following = np.empty(len(node), np.int32)
    for half in range(len(node)):
        ahead = leaving[half ^ 1] ^ 2
        out = at[node[half ^ 1]]
        onward = out[(ahead + 1) & 3]
        if onward < 0:
            onward = out[ahead]
        if onward < 0:
            onward = out[(ahead + 3) & 3]
        following[half] = onward
    return following


@loop
def _areas(offsets: Int64, vertices: Vertices) -> Int64:
    """Signed pixels between each arc and the raster's upper border: they add up to the area of a ring."""
    area = np.zeros(len(offsets) - 1, np.int64)
    for i in range(len(area)):
        for k in range(offsets[i] + 1, offsets[i + 1]):
            area[i] += np.int64(vertices[k, 0]) * (np.int64(vertices[k, 1]) - vertices[k - 1, 1])
    return area


@loop
def _trace_rings(
    node: Int32, following: Int32, wanted: NDArray[np.bool_], area: Int64, count: int
) -> tuple[Int64, Int32, Int64, Int64]:
    """Simple rings: their bounds, half-arcs, signed areas, and the contour of which each is a part."""
    ring_offsets, half_arcs = np.zeros(len(node) + 1, np.int64), np.empty(len(node), np.int32)
    ring_area, contour_of = np.zeros(len(node), np.int64), np.empty(len(node), np.int64)
    walked, path = np.zeros(len(node), np.bool_), np.empty(len(node), np.int32)
    place = np.full(count, -1, np.int32)
    rings = contours = cursor = 0
    for first in range(len(node)):
        if walked[first] or not wanted[first]:
            continue
        half, depth = first, 0
        while True:
            here = place[node[half]]
            if here >= 0:
                for k in range(here, depth):
                    place[node[path[k]]] = -1
                    half_arcs[cursor] = path[k]
                    cursor += 1
                    ring_area[rings] += -area[path[k] >> 1] if path[k] & 1 else area[path[k] >> 1]
                contour_of[rings] = contours
                rings += 1
                ring_offsets[rings] = cursor
                depth = here
            if walked[half]:
                break
            walked[half] = True
            place[node[half]], path[depth] = depth, half
            depth += 1
            half = following[half]
        contours += 1
    return (
        ring_offsets[: rings + 1].copy(),
        half_arcs[:cursor].copy(),
        ring_area[:rings].copy(),
        contour_of[:rings].copy(),
    )


# ------------------------------------------------------------------------------------------------- geometry


@loop
def _ring_coordinates(
    ring_offsets: Int64,
    half_arcs: Int32,
    offsets: Int64,
    vertices: Vertices,
    transform: tuple[float, float, float, float, float, float],
) -> tuple[NDArray[np.float64], Int64]:
    bounds = np.zeros_like(ring_offsets)
    for ring in range(len(ring_offsets) - 1):
        bounds[ring + 1] = bounds[ring] + 1
        for half in half_arcs[ring_offsets[ring] : ring_offsets[ring + 1]]:
            bounds[ring + 1] += offsets[(half >> 1) + 1] - offsets[half >> 1] - 1
    coordinates = np.empty((bounds[-1], 2), np.float64)
    a, b, c, d, e, f = transform
    for ring in range(len(ring_offsets) - 1):
        cursor = bounds[ring]
        for half in half_arcs[ring_offsets[ring] : ring_offsets[ring + 1]]:
            first, last = offsets[half >> 1], offsets[(half >> 1) + 1] - 1
            at, step = (last, -1) if half & 1 else (first, 1)
            for _ in range(last - first):
                row, column = vertices[at, 0], vertices[at, 1]
                coordinates[cursor, 0] = a * column + b * row + c
                coordinates[cursor, 1] = d * column + e * row + f
                cursor += 1
                at += step
        coordinates[cursor] = coordinates[bounds[ring]]
    return coordinates, bounds
