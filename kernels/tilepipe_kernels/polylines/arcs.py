"""Arcs between labelled regions: chains of the cracks between pixels, as far as one tile core can see them.

A *corner* is a point where four pixels meet, named by the (row, column) of the pixel to its lower right; a *crack* is
a pixel side that parts two different labels. A *junction* is a corner where three or four cracks meet, and an *arc*
a chain of cracks between two junctions, or a closed ring without one: it has one region on its left, another on its
right. Headings are numbered counter-clockwise on a map with north up, so that ``heading + 1`` is a turn to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

DOWN, RIGHT, UP, LEFT = 0, 1, 2, 3
DEGREE = np.array([bin(value).count("1") for value in range(16)], np.int64)
HEADING = np.array([0, 0, 1, 0, 2, 0, 0, 0, 3], np.int64)  # of a single crack bit
CRACKS = 15
"""Bits of a corner: crack k is set when the crack in heading k exists."""
WALKED_DOWN, WALKED_RIGHT, STOP = 16, 32, 64
UPRIGHT, LEVEL = 1 << DOWN | 1 << UP, 1 << LEFT | 1 << RIGHT

Labels = NDArray[np.int32] | NDArray[np.uint32]
Corners = NDArray[np.uint8]


@dataclass(frozen=True)
class Pieces:
    """Chains of the cracks of one tile core, cut where they leave it, as flat arrays.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): piece i has ``vertices[offsets[i]:offsets[i + 1]]``.
    vertices
        int32, shape (m, 2): global (row, column) of the first corner, the corners where it turns, and the last one.
    cut
        bool, shape (n, 2): whether the piece goes on in another tile beyond its first (last) corner.
    """

    offsets: NDArray[np.int64]
    vertices: NDArray[np.int32]
    cut: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.cut)


@dataclass(frozen=True)
class ArcPieces(Pieces):
    """The pieces of the arcs of one tile core.

    Attributes
    ----------
    left, right
        Labels on the two sides, shape (n,), dtype of the labels; 0 = nodata or outside the raster.
    """

    left: Labels
    right: Labels


def halo() -> int:
    """Pixels needed around the core: one, since a tile owns the upper and left sides of its pixels."""
    return 1


@loop
def _cracks_of_row(above: NDArray[Any], below: NDArray[Any], into: Corners) -> None:
    for j in range(into.size):
        down = 1 if below[j] != below[j + 1] else 0
        right = 2 if above[j + 1] != below[j + 1] else 0
        up = 4 if above[j] != above[j + 1] else 0
        left = 8 if above[j] != below[j] else 0
        into[j] = down | right | up | left


@loop
def _cracks_of_labels(labels: NDArray[Any]) -> Corners:
    corners = np.empty((labels.shape[0] - 1, labels.shape[1] - 1), np.uint8)
    for i in range(corners.shape[0]):
        _cracks_of_row(labels[i], labels[i + 1], corners[i])
    return corners


@loop
def _mark_stops(corners: Corners, rows: int, columns: int) -> tuple[int, int]:
    """Mark the stops among the corners; return how many pieces and vertices there are at most.

    A piece stops at a junction, at a loose end, at a corner that another tile owns, and at one that a crack of
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
    pieces = ends // 2 + rings + 1
    return pieces, 2 * pieces + turns


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
    """Write the vertices of the piece that leaves corner (i, j); return the cursor and whether its end is a cut."""
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
    """Trace the chains of cracks of a tile.

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
        As in `Pieces`, in the order that `trace_arcs` states.
    """
    bound, total = _mark_stops(corners, rows, columns)
    offsets = np.zeros(bound + 1, np.int64)
    vertices = np.empty((total, 2), np.int32)
    cut = np.zeros((bound, 2), np.bool_)
    count = cursor = 0
    # Pieces between stops go first, so that what is left are rings, met first at their lowest corner.
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
    # Copies, so that the generous bounds do not stay in memory.
    return offsets[: count + 1].copy(), vertices[:cursor].copy(), cut[:count].copy()


@rule
def heading_of(row: int, column: int, next_row: int, next_column: int) -> int:
    """Heading from one corner to another one in the same row or column."""
    if next_column == column:
        return DOWN if next_row > row else UP
    return RIGHT if next_column > column else LEFT


@loop
def _sides(
    labels: NDArray[Any], origin: tuple[int, int], offsets: NDArray[np.int64], vertices: NDArray[np.int32],
    left: NDArray[Any], right: NDArray[Any],
) -> None:  # fmt: skip
    """Write the labels to the left and right of the first crack of each piece."""
    for piece in range(left.size):
        first, second = vertices[offsets[piece]], vertices[offsets[piece] + 1]
        heading = heading_of(first[0], first[1], second[0], second[1])
        i, j = first[0] - origin[0], first[1] - origin[1]
        left[piece] = labels[i + (heading in (DOWN, LEFT)), j + (heading in (DOWN, RIGHT))]
        right[piece] = labels[i + (heading in (DOWN, RIGHT)), j + (heading in (RIGHT, UP))]


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


def trace_arcs(
    labels: Labels,
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
) -> ArcPieces:
    """Trace the arcs between the regions of a tile core.

    The tile owns the upper and left sides of its core's pixels, and the lower and right sides on the raster's border.
    So the pieces of all tiles hold every crack once.

    Parameters
    ----------
    labels
        int32 or uint32, shape (rows, columns): global labels of a block; 0 = nodata.
    core
        Window (first row, end row, first column, end column) of the core in the block; the whole block if None.
        Where the core reaches the block's border, that is the raster's border; elsewhere the block goes on for
        `halo` pixels at least.
    origin
        Global (row, column) of ``labels[0, 0]``.

    Returns
    -------
    ArcPieces
        Pieces that end somewhere, in row-major order of their first corner, which is the lower of the two; then the
        rings, which start and end at their lowest corner and go down first, with what they surround on their left.

    Raises
    ------
    ValueError
        If the labels are not a two-dimensional int32 or uint32 array, the core is no window of it, or the
        origin is negative.

    Examples
    --------
    Two regions side by side: one arc parts them, two part them from the outside.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> arcs = trace_arcs(np.array([[1, 1, 2], [1, 1, 2]], np.int32))
    >>> [sorted(sides) for sides in zip(arcs.left.tolist(), arcs.right.tolist(), strict=True)]
    [[1, 2], [0, 2], [0, 1]]
    """
    if labels.ndim != 2 or labels.dtype not in (np.int32, np.uint32):
        raise ValueError(f"labels must be a 2-D array of int32 or uint32, got {labels.ndim}-D {labels.dtype}")
    window = Core.of(labels.shape, core, origin)
    around = window.framed(labels)
    first = origin[0] + window.top, origin[1] + window.left
    offsets, vertices, cut = trace_cracks(_cracks_of_labels(around), *window.corners, first)
    left, right = np.empty_like(labels, shape=len(cut)), np.empty_like(labels, shape=len(cut))
    _sides(around, first, offsets, vertices, left, right)
    return ArcPieces(offsets, vertices, cut, left, right)
