"""Tracing along the cracks between pixels, as far as one tile core can see them.

A *corner* is a point where four pixels meet, named by the (row, column) of the pixel to its lower right; a *crack* is a
pixel side that parts two different labels, or that a line field marks. A *fragment* is the part of a polyline along
cracks that lies in a tile core. Headings are numbered counter-clockwise on a map with north up, so that
``heading + 1`` is a turn to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Polylines

DOWN, RIGHT, UP, LEFT = 0, 1, 2, 3

DEGREE = np.array([bin(value).count("1") for value in range(16)], np.int64)

HEADING = np.array([0, 0, 1, 0, 2, 0, 0, 0, 3], np.int64)  # of a single crack bit

CRACKS = 15
"""Bits of a corner: crack k is set when the crack in heading k exists."""

WALKED_DOWN, WALKED_RIGHT, STOP = 16, 32, 64

UPRIGHT, LEVEL = 1 << DOWN | 1 << UP, 1 << LEFT | 1 << RIGHT

Corners = NDArray[np.uint8]


@dataclass(frozen=True)
class CrackFragments(Polylines):
    """Fragments of one tile core along its cracks.

    Their vertices are int32: global (row, column) of the first corner, the corners where a fragment turns, and the
    last one.

    Attributes
    ----------
    cut
        bool, shape (n, 2): whether the fragment goes on in another tile beyond its first (last) corner.
    """

    cut: NDArray[np.bool_]


@loop
def _mark_stops(corners: Corners, rows: int, columns: int) -> tuple[int, int]:
    """Mark the stops among the corners; return how many fragments and vertices there are at most.

    A fragment stops at a junction, at a loose end, at a corner that another tile owns, and at one that a crack of
    another tile reaches.
    """
    ends = turns = rings = 0
    for i in range(corners.shape[0]):
        row = corners[i]
        for j in range(row.size):
            cracks = row[j]
            if cracks == 0:
                continue
            degree = DEGREE[cracks]
            foreign = (i == 0 and cracks & 1 << UP) or (j == 0 and cracks & 1 << LEFT)
            if degree != 2 or foreign or i == rows or j == columns:
                row[j] = cracks | STOP
                ends += degree
            elif cracks not in (UPRIGHT, LEVEL):
                turns += 1
                rings += cracks == 1 << DOWN | 1 << RIGHT
    fragments = ends // 2 + rings + 1
    return fragments, 2 * fragments + turns


@rule
def _owned(i: int, j: int, heading: int, rows: int, columns: int) -> bool:
    """Whether the crack in ``heading`` is the tile's: whether its lower corner is."""
    return 0 <= i - (heading == UP) < rows and 0 <= j - (heading == LEFT) < columns


@loop
def _is_walked(corners: Corners, i: int, j: int, heading: int) -> bool:
    if heading == DOWN or heading == UP:
        return (corners[i - (heading == UP), j] & WALKED_DOWN) != 0
    return (corners[i, j - (heading == LEFT)] & WALKED_RIGHT) != 0


@loop
def _follow(
    corners: Corners, i: int, j: int, heading: int, origin: tuple[int, int], vertices: NDArray[np.int32], cursor: int
) -> tuple[int, bool]:
    """Write the vertices of the fragment that leaves corner (i, j); return the cursor and whether its end is a cut."""
    start_i, start_j = i, j
    vertices[cursor, 0], vertices[cursor, 1] = origin[0] + i, origin[1] + j
    cursor += 1
    while True:
        if heading == DOWN:
            corners[i, j] |= WALKED_DOWN
            i += 1
        elif heading == RIGHT:
            corners[i, j] |= WALKED_RIGHT
            j += 1
        elif heading == UP:
            i -= 1
            corners[i, j] |= WALKED_DOWN
        else:
            j -= 1
            corners[i, j] |= WALKED_RIGHT
        value = corners[i, j]
        cracks = value & CRACKS
        arrived = (value & STOP) != 0 or (i == start_i and j == start_j)
        if arrived or (cracks != UPRIGHT and cracks != LEVEL):
            vertices[cursor, 0], vertices[cursor, 1] = origin[0] + i, origin[1] + j
            cursor += 1
            if arrived:
                return cursor, (value & STOP) != 0 and DEGREE[cracks] == 2
            heading = HEADING[cracks & ~(1 << (heading ^ 2))]


@loop
def trace_cracks(
    corners: Corners, rows: int, columns: int, origin: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_]]:
    """Trace the fragments along the cracks of a tile.

    Parameters
    ----------
    corners
        uint8, shape (r, c): bits of the cracks that meet at each corner, of which the tile owns the first `rows` and
        `columns`; used up.
    rows, columns
        r and c at the raster's lower and right border, else one less.
    origin
        Global (row, column) of ``corners[0, 0]``.

    Returns
    -------
    offsets, vertices, cut
        As in `CrackFragments`, in the order that `trace_arcs` states.
    """
    bound, total = _mark_stops(corners, rows, columns)
    offsets = np.zeros(bound + 1, np.int64)
    vertices = np.empty((total, 2), np.int32)
    cut = np.zeros((bound, 2), np.bool_)
    count = cursor = 0
    # Fragments between stops go first, so that what is left are rings, met first at their lowest corner.
    for rings in (False, True):
        for i in range(corners.shape[0]):
            row = corners[i]
            for j in range(row.size):
                if (row[j] & CRACKS) == 0 or ((row[j] & STOP) == 0) != rings:
                    continue
                for heading in range(4):
                    if not row[j] & 1 << heading or not _owned(i, j, heading, rows, columns):
                        continue
                    if _is_walked(corners, i, j, heading):
                        continue
                    cut[count, 0] = not rings and DEGREE[row[j] & CRACKS] == 2
                    cursor, cut[count, 1] = _follow(corners, i, j, heading, origin, vertices, cursor)
                    count += 1
                    offsets[count] = cursor
    # Copies, so that generous bounds do not stay in memory; where they are not generous there is no room for copies.
    if 2 * cursor > total:
        return offsets[: count + 1], vertices[:cursor], cut[:count]
    return offsets[: count + 1].copy(), vertices[:cursor].copy(), cut[:count].copy()


@rule
def heading_of(row: int, column: int, next_row: int, next_column: int) -> int:
    """Heading from one corner to another one in the same row or column."""
    if next_column == column:
        return DOWN if next_row > row else UP
    return RIGHT if next_column > column else LEFT


@dataclass(frozen=True)
class Core:
    """A tile core in its block, with one pixel around it, 0 beyond the raster."""

    top: int
    left: int
    bottom: int
    right: int
    last_row: bool
    last_column: bool

    @classmethod
    def of(cls, shape: tuple[int, ...], core: tuple[int, int, int, int] | None, origin: tuple[int, int]) -> Core:
        """Check a core: a window of the block, or None for all of it.

        Raises
        ------
        ValueError
            If it is no window of the block, or the origin is negative.
        """
        top, bottom, left, right = (0, shape[0], 0, shape[1]) if core is None else core
        if not (0 <= top <= bottom <= shape[0] and 0 <= left <= right <= shape[1]):
            raise ValueError(f"core {core} is not a window of a block of shape {shape}")
        if min(origin) < 0:
            raise ValueError(f"origin {origin} must be the block's global row and column, from 0 on")
        return cls(top, left, bottom, right, bottom == shape[0], right == shape[1])

    @property
    def corners(self) -> tuple[int, int]:
        """Rows and columns of the corners that the tile owns."""
        return self.bottom - self.top + self.last_row, self.right - self.left + self.last_column

    def framed(self, block: NDArray[Any]) -> NDArray[Any]:
        """The core with its frame."""
        around = np.zeros((self.bottom - self.top + 2, self.right - self.left + 2), block.dtype)
        first_row, first_column = max(self.top - 1, 0), max(self.left - 1, 0)
        seen = block[first_row : self.bottom + 1, first_column : self.right + 1]
        into_row, into_column = first_row - (self.top - 1), first_column - (self.left - 1)
        around[into_row : into_row + seen.shape[0], into_column : into_column + seen.shape[1]] = seen
        return around
