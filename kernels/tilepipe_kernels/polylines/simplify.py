"""Polylines simplified one by one, without one coming into conflict with another."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Polylines, Vertices
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.polylines.end_point_fit import keep_vertices

Some = TypeVar("Some", bound=Polylines)

CELL = 16
"""Pixels on a side of the cells by which segments that may meet are found."""
HALVINGS = 3
"""How often the tolerance of an arc in conflict is halved before the arc stays as it is."""


def simplify_polylines(
    polylines: Some,
    tolerance: float | NDArray[np.float64],
    pixel_height: float = 1.0,
    pixel_width: float = 1.0,
    cell: int = CELL,
) -> Some:
    """Simplify each polyline by itself (Douglas & Peucker 1973), with its two ends fixed, so that the topology stays.

    Polylines that come into conflict are simplified again with half their tolerance, at last not at all. A conflict is
    a new segment that meets another segment elsewhere than in a common vertex, or that passes an end of a polyline or
    a kept corner of a closed one; both are decided exactly, in integers. Without conflict no region collapses, none
    overlaps another, and holes stay where they are. A closed polyline keeps three corners at least.

    Parameters
    ----------
    polylines
        With integer vertices (row, column), that meet at their ends only, such as those along the cracks of a raster.
    tolerance
        Largest distance between a removed corner and the segment that replaces it, in the unit of the pixel sizes,
        for all polylines or for each. A diagonal staircase becomes a line from 0.71 pixels on.
    pixel_height, pixel_width
        Size of a step of the vertices, > 0.
    cell
        Steps on a side of the cells by which segments that may meet are found; it does not show in the result.

    Returns
    -------
    Polylines
        The same in the same order, with a part of their vertices.

    Raises
    ------
    ValueError
        For a tolerance < 0 or pixel sizes that are not > 0.

    Examples
    --------
    The stairs of a diagonal border become one line.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.simplify import simplify_polylines
    >>> stairs = np.repeat(np.arange(8), 2)
    >>> vertices = np.stack([stairs[:-1], stairs[1:]], axis=1).astype(np.int32)
    >>> simplify_polylines(Polylines(np.array([0, 15]), vertices), tolerance=0.75).vertices.tolist()
    [[0, 0], [7, 7]]
    """
    tolerances = np.array(np.broadcast_to(tolerance, len(polylines)), np.float64)
    if not (np.isfinite(tolerance).all() and np.all(tolerances >= 0) and pixel_height > 0 and pixel_width > 0):
        raise ValueError(f"tolerance ({tolerance}) must be ≥ 0 and pixel sizes > 0: give them in the same unit")
    least = tolerances / 2**HALVINGS
    kept = np.ones(len(polylines.vertices), np.bool_)
    redo = np.flatnonzero(tolerances > 0)
    reach = tolerances.max(initial=0) / min(pixel_height, pixel_width) + 1
    again = False
    while redo.size:
        keep_vertices(redo, polylines.offsets, polylines.vertices, tolerances, pixel_height, pixel_width, kept)
        redo = np.flatnonzero(_conflicts(polylines.offsets, polylines.vertices, kept, redo, again, reach, cell))
        again = True
        tolerances[redo] /= 2
        tolerances[tolerances < least] = 0
    return polylines.with_vertices(kept)


@loop
def _segments(offsets: Int64, kept: NDArray[np.bool_]) -> tuple[Int64, Int64]:
    """First vertex, last vertex and arc of each segment between kept vertices."""
    segments = np.empty((len(kept), 2), np.int64)
    arc_of = np.empty(len(kept), np.int64)
    count = 0
    for arc in range(len(offsets) - 1):
        before = offsets[arc]
        for k in range(offsets[arc] + 1, offsets[arc + 1]):
            if kept[k]:
                segments[count, 0], segments[count, 1], arc_of[count] = before, k, arc
                count += 1
                before = k
    return segments[:count], arc_of[:count]


@rule
def cell_rows(a: float, b: float, margin: float, cell: int) -> tuple[int, int]:
    """Range of rows of cells that come within the margin of the rows from a to b."""
    return max(int(np.floor((min(a, b) - margin) / cell)), 0), int(np.floor((max(a, b) + margin) / cell)) + 1


@rule
def cell_columns(
    cell_row: int, r0: float, c0: float, r1: float, c1: float, margin: float, cell: int
) -> tuple[int, int]:
    """Range of cells of one row of cells that come within the margin of a segment."""
    low, high = float(min(c0, c1)), float(max(c0, c1))
    if r0 != r1:
        slope = (c1 - c0) / (r1 - r0)
        above = c0 + (cell_row * cell - margin - r0) * slope
        below = c0 + ((cell_row + 1) * cell + margin - r0) * slope
        low, high = max(low, min(above, below)), min(high, max(above, below))
    return max(int(np.floor((low - margin) / cell)), 0), int(np.floor((high + margin) / cell)) + 1


@loop
def _cells_of_redone(
    segments: Int64,
    arc_of: Int64,
    vertices: Vertices,
    redone: NDArray[np.bool_],
    with_old: bool,
    reach: float,
    cell: int,
) -> tuple[Int64, Int64]:
    """Cells that segments of redone arcs may sweep, and these segments, unsorted."""
    keys, listed = np.empty(0, np.int64), np.empty(0, np.int64)
    for fill in (False, True):
        count = 0
        for s in range(len(segments)):
            if not redone[arc_of[s]] or not (with_old or segments[s, 1] > segments[s, 0] + 1):
                continue
            (r0, c0), (r1, c1) = vertices[segments[s, 0]], vertices[segments[s, 1]]
            first, last = cell_rows(r0, r1, reach, cell)
            for cell_row in range(first, last):
                left, right = cell_columns(cell_row, r0, c0, r1, c1, reach, cell)
                for cell_column in range(left, right):
                    if fill:
                        keys[count], listed[count] = np.int64(cell_row) << 32 | cell_column, s
                    count += 1
        if not fill:
            keys, listed = np.empty(count, np.int64), np.empty(count, np.int64)
    return keys, listed


@rule
def _side(r0: int, c0: int, r1: int, c1: int, row: int, column: int) -> int:
    """Sign of the turn at the second of three points; int64, exact."""
    turn = np.int64(r1 - r0) * np.int64(column - c0) - np.int64(c1 - c0) * np.int64(row - r0)
    return int(turn > 0) - int(turn < 0)


@rule
def _meet(r0: int, c0: int, r1: int, c1: int, r2: int, c2: int, r3: int, c3: int) -> bool:
    """Whether two segments have a point in common, other than one common end."""
    if (r0 == r2 and c0 == c2) or (r1 == r3 and c1 == c3) or (r0 == r3 and c0 == c3) or (r1 == r2 and c1 == c2):
        if (r0 == r3 and c0 == c3) or (r1 == r2 and c1 == c2):
            r2, c2, r3, c3 = r3, c3, r2, c2
        if r1 == r3 and c1 == c3:
            r0, c0, r1, c1, r2, c2, r3, c3 = r1, c1, r0, c0, r3, c3, r2, c2
        along = np.int64(r1 - r0) * np.int64(r3 - r2) + np.int64(c1 - c0) * np.int64(c3 - c2)
        return _side(r0, c0, r1, c1, r3, c3) == 0 and bool(along > 0)
    if max(r0, r1) < min(r2, r3) or max(r2, r3) < min(r0, r1) or max(c0, c1) < min(c2, c3) or max(c2, c3) < min(c0, c1):
        return False
    apart = _side(r0, c0, r1, c1, r2, c2) * _side(r0, c0, r1, c1, r3, c3) > 0
    return not (apart or _side(r2, c2, r3, c3, r0, c0) * _side(r2, c2, r3, c3, r1, c1) > 0)


@loop
def _passed(vertices: Vertices, first: int, last: int, row: int, column: int) -> bool:
    """Whether a point lies between a row of vertices and the segment that replaces it (ray casting)."""
    inside = False
    before = last
    for k in range(first, last + 1):
        r0, c0, r1, c1 = vertices[before, 0], vertices[before, 1], vertices[k, 0], vertices[k, 1]
        if (r0 == row and c0 == column) or (r1 == row and c1 == column):
            return False
        if (r0 > row) != (r1 > row) and (_side(r0, c0, r1, c1, row, column) > 0) == (r1 > r0):
            inside = not inside
        before = k
    return inside


@loop
def _mark_conflicts(
    keys: Int64,
    listed: Int64,
    segments: Int64,
    arc_of: Int64,
    offsets: Int64,
    vertices: Vertices,
    kept: NDArray[np.bool_],
    bad: NDArray[np.bool_],
    cell: int,
) -> None:
    for s in range(len(segments)):
        (r0, c0), (r1, c1) = vertices[segments[s, 0]], vertices[segments[s, 1]]
        first, last = cell_rows(r0, r1, 0.25, cell)
        for cell_row in range(first, last):
            left, right = cell_columns(cell_row, r0, c0, r1, c1, 0.25, cell)
            stop = np.int64(cell_row) << 32 | right
            at = np.searchsorted(keys, np.int64(cell_row) << 32 | left)
            while at < len(keys) and keys[at] < stop:
                other = listed[at]
                at += 1
                (r2, c2), (r3, c3) = vertices[segments[other, 0]], vertices[segments[other, 1]]
                if other != s and _meet(r0, c0, r1, c1, r2, c2, r3, c3):
                    bad[arc_of[s]] |= segments[s, 1] > segments[s, 0] + 1
                    bad[arc_of[other]] |= segments[other, 1] > segments[other, 0] + 1
    for arc in range(len(offsets) - 1):
        first, second = offsets[arc], offsets[arc + 1] - 1
        if vertices[first, 0] == vertices[second, 0] and vertices[first, 1] == vertices[second, 1]:
            # A loop may hang on one junction, where the arc that passes it also ends: only the rest of it tells.
            second = first + 1
            while not kept[second]:
                second += 1
        for fixed in (first, second):
            row, column = vertices[fixed, 0], vertices[fixed, 1]
            key = np.int64(row // cell) << 32 | np.int64(column // cell)
            at = np.searchsorted(keys, key)
            while at < len(keys) and keys[at] == key:
                begin, end = segments[listed[at]]
                bad[arc_of[listed[at]]] |= end > begin + 1 and _passed(vertices, begin, end, row, column)
                at += 1


def _conflicts(
    offsets: Int64, vertices: Vertices, kept: NDArray[np.bool_], redo: Int64, again: bool, reach: float, cell: int
) -> NDArray[np.bool_]:
    """Arcs with a new segment that passes a fixed point, or meets another segment, one of the two of a redone arc.

    At first all segments that are not new lie along cracks and cannot meet; `again` they can, where an arc has been
    taken back.
    """
    segments, arc_of = _segments(offsets, kept)
    redone, bad = np.zeros((2, len(offsets) - 1), np.bool_)
    redone[redo] = True
    keys, listed = _cells_of_redone(segments, arc_of, vertices, redone, again, reach, cell)
    order = np.argsort(keys, kind="stable")
    _mark_conflicts(keys[order], listed[order], segments, arc_of, offsets, vertices, kept, bad, cell)
    return bad
