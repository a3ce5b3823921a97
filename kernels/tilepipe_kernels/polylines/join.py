"""Arcs and lines of a whole raster, joined from the pieces that the tiles have traced."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.network.walks import walk_chains
from tilepipe_kernels.polylines.arcs import ArcPieces, Labels, Pieces, heading_of
from tilepipe_kernels.polylines.crack_lines import LinePieces

Int64 = NDArray[np.int64]
Vertices = NDArray[Any]
"""int32 on the corners of pixels, float64 once arcs are regularised."""


@dataclass(frozen=True)
class Chains:
    """Chains of the cracks of a raster, sorted by (first row, first column, first heading), as flat arrays.

    Of the two ways to read a chain it is the one that comes first in that order, headings in the order down, right,
    up, left; a ring starts at its lowest corner, so what it surrounds is on its left.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): chain i has ``vertices[offsets[i]:offsets[i + 1]]``.
    vertices
        int32, shape (m, 2): (row, column) of corners; a ring repeats its first one.
    """

    offsets: Int64
    vertices: Vertices

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def lengths(self, pixel_height: float = 1.0, pixel_width: float = 1.0) -> NDArray[np.float64]:
        """Length of each chain as a polyline, float64, in the unit of the pixel sizes."""
        steps = np.abs(np.diff(self.vertices, axis=0, prepend=self.vertices[:1]).astype(np.float64))
        steps = np.hypot(steps[:, 0] * pixel_height, steps[:, 1] * pixel_width)
        steps[self.offsets[:-1]] = 0
        return np.add.reduceat(steps, self.offsets[:-1]) if len(self) else steps


@dataclass(frozen=True)
class Arcs(Chains):
    """All arcs of a raster.

    Attributes
    ----------
    left, right
        Region ids on the two sides, shape (n,); 0 = nodata or outside the raster.
    """

    left: Labels
    right: Labels


@dataclass(frozen=True)
class Lines(Chains):
    """All lines of a line field.

    Attributes
    ----------
    contrast
        int64, shape (n,): sum over the cracks of the absolute difference of grey across them, in ticks.
    step
        int64, shape (n,): sum of the grey to the left of the cracks less that to their right, in ticks.
    """

    contrast: Int64
    step: Int64


def taken(offsets: Int64, vertices: NDArray[Any], kept: NDArray[np.bool_]) -> tuple[Int64, NDArray[Any]]:
    """Those of the chains that are kept: their offsets and vertices."""
    sizes = np.diff(offsets)
    return np.concatenate([[0], np.cumsum(sizes[kept])]), vertices[np.repeat(kept, sizes)]


def end_points(offsets: Int64, vertices: Vertices) -> Vertices:
    """First and last vertex of each chain, one after the other: shape (2 n, 2)."""
    return vertices[np.stack([offsets[:-1], offsets[1:] - 1], axis=1).reshape(-1)]


def place_numbers(points: Vertices) -> Int64:
    """One number for the (row, column) of each point, both whole numbers from 0 to 2³¹, in that order."""
    whole = points.astype(np.int64)
    numbers: Int64 = whole[:, 0] << 32 | whole[:, 1]
    return numbers


def join_arcs(pieces: Iterable[ArcPieces]) -> Arcs:
    """Join the pieces of the arcs of all tiles of a raster.

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
    ValueError
        If a cut piece does not go on in any other: a tile is missing, doubled, or was traced without its halo.

    Examples
    --------
    The arcs of two tiles, each traced with one pixel of its neighbour, are those of the whole.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> from tilepipe_kernels.polylines.join import join_arcs
    >>> labels = np.array([[1, 1, 1, 1], [1, 2, 2, 1], [1, 1, 1, 1]], np.int32)
    >>> left = trace_arcs(labels[:, :3], core=(0, 3, 0, 2))
    >>> right = trace_arcs(labels[:, 1:], core=(0, 3, 1, 3), origin=(0, 1))
    >>> arcs, whole = join_arcs([right, left]), join_arcs([trace_arcs(labels)])
    >>> bool((arcs.vertices == whole.vertices).all()), arcs.lengths().tolist()
    (True, [14.0, 6.0])
    """
    parts = list(pieces)
    joined = _joined(parts)
    left, right = (np.concatenate([getattr(part, side) for part in parts]) for side in ("left", "right"))
    first, turned = joined.members[joined.bounds[:-1]], joined.backward[joined.bounds[:-1]]
    left, right = left[first], right[first]
    return Arcs(joined.offsets, joined.vertices, np.where(turned, right, left), np.where(turned, left, right))


def join_lines(pieces: Iterable[LinePieces]) -> Lines:
    """Join the pieces of the lines of all tiles of a raster; arguments and errors as `join_arcs`."""
    parts = list(pieces)
    joined = _joined(parts)
    contrast, step = (np.concatenate([getattr(part, name) for part in parts]) for name in ("contrast", "step"))
    contrast, step = contrast[joined.members], np.where(joined.backward, -1, 1) * step[joined.members]
    sums = (np.add.reduceat(values, joined.bounds[:-1]) if values.size else values for values in (contrast, step))
    return Lines(joined.offsets, joined.vertices, *sums)


class _Joined(NamedTuple):
    """Whole chains: chain i is of the pieces ``members[bounds[i]:bounds[i + 1]]``, some of which it reads backward."""

    offsets: Int64
    vertices: Vertices
    bounds: Int64
    members: Int64
    backward: NDArray[np.bool_]


def _joined(parts: Sequence[Pieces]) -> _Joined:
    """Whole chains in canonical direction and order; a piece that is not cut has the direction from its tile."""
    if not parts:
        raise ValueError("there are no pieces of arcs to join: trace at least one tile")
    offsets = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(part.offsets) for part in parts]))])
    vertices = np.concatenate([part.vertices for part in parts])
    cut = np.concatenate([part.cut for part in parts])
    of_several = cut.any(axis=1)
    alone, split = np.flatnonzero(~of_several), np.flatnonzero(of_several)
    whole = _Joined(
        *_gather(alone, offsets, vertices), np.arange(alone.size + 1), alone, np.zeros(alone.size, np.bool_)
    )
    if split.size == 0:
        return _sorted(whole)
    offsets, vertices = _gather(split, offsets, vertices)
    mates = _mates(offsets, vertices, cut[split])
    bounds, members, backward, closed = walk_chains(mates, np.zeros_like(mates))
    joined, corners, turned = _join(bounds, members, backward, closed, offsets, vertices)
    return _sorted(
        _Joined(
            np.concatenate([whole.offsets, whole.offsets[-1] + joined[1:]]),
            np.concatenate([whole.vertices, corners]),
            np.concatenate([whole.bounds, whole.bounds[-1] + bounds[1:]]),
            np.concatenate([whole.members, split[members]]),
            np.concatenate([whole.backward, np.repeat(turned, np.diff(bounds)) ^ backward]),
        )
    )


def _sorted(chains: _Joined) -> _Joined:
    order = np.argsort(_sort_keys(chains.offsets, chains.vertices), kind="stable")
    bounds, pieces = _gather(order, chains.bounds, np.stack([chains.members, chains.backward], axis=1))
    return _Joined(*_gather(order, chains.offsets, chains.vertices), bounds, pieces[:, 0], pieces[:, 1] != 0)


def _mates(offsets: Int64, vertices: Vertices, cut: NDArray[np.bool_]) -> Int64:
    """For each end of a piece (2 i its first, 2 i + 1 its last) the end at which the arc goes on, or -1."""
    mates = np.full(cut.size, -1, np.int64)
    ends = np.flatnonzero(cut)
    at = vertices[np.where(ends & 1, offsets[(ends >> 1) + 1] - 1, offsets[ends >> 1])]
    order = np.lexsort((at[:, 1], at[:, 0]))
    ends, at = ends[order], at[order]
    paired = ends.size % 2 == 0 and bool(np.array_equal(at[::2], at[1::2]))
    if not paired or (at[2::2] == at[1:-1:2]).all(axis=1).any():
        raise ValueError("pieces of arcs do not meet at the seams: trace every tile once, with its halo of one pixel")
    mates[ends[::2]], mates[ends[1::2]] = ends[1::2], ends[::2]
    return mates


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
def _gather(order: Int64, offsets: Int64, rows: NDArray[Any]) -> tuple[Int64, NDArray[Any]]:
    """The rows of some runs, and their offsets."""
    bounds = np.zeros(len(order) + 1, np.int64)
    for i, run in enumerate(order):
        bounds[i + 1] = bounds[i] + offsets[run + 1] - offsets[run]
    gathered = np.empty((bounds[-1], rows.shape[1]), rows.dtype)
    for i, run in enumerate(order):
        for k in range(offsets[run + 1] - offsets[run]):
            for column in range(rows.shape[1]):
                gathered[bounds[i] + k, column] = rows[offsets[run] + k, column]
    return bounds, gathered
