"""Arcs of a whole raster, joined from the pieces that the tiles have traced."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe_kernels.arcs import DOWN, LEFT, RIGHT, UP, ArcPieces, Labels
from tilepipe_kernels.compiled import loop, rule
from tilepipe_kernels.graph import walk_chains

Int64 = NDArray[np.int64]
Vertices = NDArray[np.int32]


@dataclass(frozen=True)
class Arcs:
    """All arcs of a raster, sorted by (first row, first column, first heading), as flat arrays.

    Of the two ways to read an arc it is the one that comes first in that order, headings in the order down, right,
    up, left; a ring starts at its lowest corner, so what it surrounds is on its left.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): arc i has ``vertices[offsets[i]:offsets[i + 1]]``.
    vertices
        int32, shape (m, 2): (row, column) of corners; a ring repeats its first one.
    left, right
        Region ids on the two sides, shape (n,); 0 = nodata or outside the raster.
    """

    offsets: Int64
    vertices: Vertices
    left: Labels
    right: Labels

    def __len__(self) -> int:
        return len(self.left)

    def lengths(self, pixel_height: float = 1.0, pixel_width: float = 1.0) -> NDArray[np.float64]:
        """Length of each arc as a polyline, float64, in the unit of the pixel sizes."""
        steps = np.abs(np.diff(self.vertices, axis=0, prepend=self.vertices[:1]).astype(np.float64))
        steps = np.hypot(steps[:, 0] * pixel_height, steps[:, 1] * pixel_width)
        steps[self.offsets[:-1]] = 0
        return np.add.reduceat(steps, self.offsets[:-1]) if len(self) else steps


def join_arcs(pieces: Iterable[ArcPieces]) -> Arcs:
    """Join the pieces of all tiles of a raster.

    Parameters
    ----------
    pieces
        What ``trace_arcs`` returned for each tile of the grid, in any order.

    Returns
    -------
    Arcs
        The same for any tiling, bit for bit.

    Raises
    ------
    InputError
        If a cut piece does not go on in any other: a tile is missing, doubled, or was traced without its halo.
    """
    parts = list(pieces)
    if not parts:
        raise InputError("there are no pieces of arcs to join: trace at least one tile")
    lengths = np.concatenate([np.diff(part.offsets) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    left, right = (np.concatenate([getattr(part, side) for part in parts]) for side in ("left", "right"))
    cut = np.concatenate([part.cut for part in parts])
    del parts
    arcs = Arcs(np.concatenate([[0], np.cumsum(lengths)]), vertices, left, right)
    of_several = cut.any(axis=1)
    if of_several.any():
        whole = _taken(arcs, np.flatnonzero(~of_several))
        joined = _joined(_taken(arcs, np.flatnonzero(of_several)), cut[of_several])
        arcs = Arcs(
            np.concatenate([whole.offsets, whole.offsets[-1] + joined.offsets[1:]]),
            *(
                np.concatenate([getattr(part, name) for part in (whole, joined)])
                for name in ("vertices", "left", "right")
            ),
        )
    return _taken(arcs, np.argsort(_sort_keys(arcs.offsets, arcs.vertices), kind="stable"))


def _taken(arcs: Arcs, order: Int64) -> Arcs:
    offsets, vertices = _gather(order, arcs.offsets, arcs.vertices)
    return Arcs(offsets, vertices, arcs.left[order], arcs.right[order])


def _joined(pieces: Arcs, cut: NDArray[np.bool_]) -> Arcs:
    """Whole arcs from cut pieces, in canonical direction; a piece that is not cut has it from its tile."""
    mates = _mates(pieces.offsets, pieces.vertices, cut)
    chains, members, backward, closed = walk_chains(mates, np.zeros_like(mates))
    offsets, vertices, turned = _join(chains, members, backward, closed, pieces.offsets, pieces.vertices)
    first, turned = members[chains[:-1]], turned ^ backward[chains[:-1]]
    left, right = pieces.left[first], pieces.right[first]
    return Arcs(offsets, vertices, np.where(turned, right, left), np.where(turned, left, right))


def _mates(offsets: Int64, vertices: Vertices, cut: NDArray[np.bool_]) -> Int64:
    """For each end of a piece (2 i its first, 2 i + 1 its last) the end at which the arc goes on, or -1."""
    mates = np.full(cut.size, -1, np.int64)
    ends = np.flatnonzero(cut)
    at = vertices[np.where(ends & 1, offsets[(ends >> 1) + 1] - 1, offsets[ends >> 1])]
    order = np.lexsort((at[:, 1], at[:, 0]))
    ends, at = ends[order], at[order]
    paired = ends.size % 2 == 0 and bool(np.array_equal(at[::2], at[1::2]))
    if not paired or (at[2::2] == at[1:-1:2]).all(axis=1).any():
        raise InputError("pieces of arcs do not meet at the seams: trace every tile once, with its halo of one pixel")
    mates[ends[::2]], mates[ends[1::2]] = ends[1::2], ends[::2]
    return mates


@rule
def heading_of(row: int, column: int, next_row: int, next_column: int) -> int:
    """Heading from one corner to another one in the same row or column."""
    if next_column == column:
        return DOWN if next_row > row else UP
    return RIGHT if next_column > column else LEFT


@loop
def _starts_later(chain: Vertices) -> bool:
    """Whether an arc reads better from its end: by row and column of the corner, then by heading."""
    a, b, y, z = chain[0], chain[1], chain[-2], chain[-1]
    first = a[0], a[1], heading_of(a[0], a[1], b[0], b[1])
    return (z[0], z[1], heading_of(z[0], z[1], y[0], y[1])) < first


@loop
def _from_lowest(ring: Vertices) -> int:
    """Let a ring start at its lowest corner; return its number of vertices, less one if it began amid a side."""
    last = len(ring) - 1
    before, start, after = ring[last - 1], ring[0], ring[1]
    if before[0] == start[0] == after[0] or before[1] == start[1] == after[1]:
        ring[:last] = ring[1:].copy()
        last -= 1
    lowest = 0
    for k in range(1, last):
        if (ring[k, 0], ring[k, 1]) < (ring[lowest, 0], ring[lowest, 1]):
            lowest = k
    corners = ring[:last].copy()
    for k in range(last + 1):
        ring[k] = corners[(lowest + k) % last]
    return last + 1


@loop
def _join(
    chains: Int64,
    members: Int64,
    backward: NDArray[np.bool_],
    closed: NDArray[np.bool_],
    offsets: Int64,
    vertices: Vertices,
) -> tuple[Int64, Vertices, NDArray[np.bool_]]:
    """Concatenate the pieces of each chain without the corners where they were cut, in canonical direction."""
    joined = np.empty_like(vertices)
    bounds = np.zeros(len(chains), np.int64)
    turned = np.zeros(len(chains) - 1, np.bool_)
    cursor = 0
    for c in range(len(chains) - 1):
        start = cursor
        for k in range(chains[c], chains[c + 1]):
            first, last = offsets[members[k]], offsets[members[k] + 1] - 1
            step = -1 if backward[k] else 1
            at = last if backward[k] else first
            for _ in range(first, last + 1):
                row, column = vertices[at, 0], vertices[at, 1]
                at += step
                if cursor > start and joined[cursor - 1, 0] == row and joined[cursor - 1, 1] == column:
                    continue
                if cursor > start + 1:
                    level = joined[cursor - 2, 0] == joined[cursor - 1, 0] == row
                    if level or joined[cursor - 2, 1] == joined[cursor - 1, 1] == column:
                        cursor -= 1
                joined[cursor, 0], joined[cursor, 1] = row, column
                cursor += 1
        if closed[c]:
            cursor = start + _from_lowest(joined[start:cursor])
        if _starts_later(joined[start:cursor]):
            joined[start:cursor] = joined[start:cursor][::-1].copy()
            turned[c] = True
        bounds[c + 1] = cursor
    return bounds, joined[:cursor].copy(), turned


@loop
def _sort_keys(offsets: Int64, vertices: Vertices) -> Int64:
    keys = np.empty(len(offsets) - 1, np.int64)
    for i in range(len(keys)):
        a, b = vertices[offsets[i]], vertices[offsets[i] + 1]
        keys[i] = np.int64(a[0]) << 33 | np.int64(a[1]) << 2 | heading_of(a[0], a[1], b[0], b[1])
    return keys


@loop
def _gather(order: Int64, offsets: Int64, vertices: Vertices) -> tuple[Int64, Vertices]:
    bounds = np.zeros(len(order) + 1, np.int64)
    for i, arc in enumerate(order):
        bounds[i + 1] = bounds[i] + offsets[arc + 1] - offsets[arc]
    gathered = np.empty((bounds[-1], 2), np.int32)
    for i, arc in enumerate(order):
        for k in range(offsets[arc + 1] - offsets[arc]):
            gathered[bounds[i] + k, 0] = vertices[offsets[arc] + k, 0]
            gathered[bounds[i] + k, 1] = vertices[offsets[arc] + k, 1]
    return bounds, gathered
