"""Arcs and crack lines of a whole raster, joined from the fragments that the tiles have traced."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Polylines, Vertices
from tilepipe_kernels.core.ragged import Int64, reduce_runs, take_runs
from tilepipe_kernels.network.chain_loops import walk_chains
from tilepipe_kernels.polylines.arcs import ArcFragments, Labels
from tilepipe_kernels.polylines.crack_lines import CrackLineFragments
from tilepipe_kernels.polylines.cracks import CrackFragments, heading_of

Some = TypeVar("Some", bound=CrackFragments)


@dataclass(frozen=True)
class Arcs(Polylines):
    """All arcs of a raster, sorted by (first row, first column, first heading).

    Of the two ways to read an arc it is the one that comes first in that order, headings in the order down, right, up,
    left; a ring starts at its lowest corner, so what it surrounds is on its left. Vertices are (row, column): int32 on
    the corners of pixels, float64 once arcs are regularised.

    Attributes
    ----------
    left, right
        Region ids on the two sides, shape (n,); 0 = nodata or outside the raster.
    """

    left: Labels
    right: Labels


@dataclass(frozen=True)
class CrackLines(Polylines):
    """All crack lines of a raster, read and sorted as `Arcs` are.

    Attributes
    ----------
    contrast
        int64, shape (n,): sum over the cracks of the absolute difference of grey across them, in ticks.
    step
        int64, shape (n,): sum of the grey to the left of the cracks less that to their right, in ticks.
    """

    contrast: Int64
    step: Int64


def join_arcs(fragments: Iterable[ArcFragments]) -> Arcs:
    """Join the fragments of the arcs of all tiles of a raster.

    Parameters
    ----------
    fragments
        What ``trace_arcs`` returned for each tile of the grid, in any order.

    Returns
    -------
    Arcs
        The same for any tiling, bit for bit.

    Raises
    ------
    ValueError
        If a cut fragment does not go on in any other: a tile is missing, doubled, or was traced without its halo.

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
    parts = ArcFragments.concatenated(_some(fragments))
    joined = _joined(parts)
    first, turned = joined.members[joined.bounds[:-1]], joined.backward[joined.bounds[:-1]]
    left, right = parts.left[first], parts.right[first]
    return Arcs(joined.offsets, joined.vertices, np.where(turned, right, left), np.where(turned, left, right))


def join_crack_lines(fragments: Iterable[CrackLineFragments]) -> CrackLines:
    """Join the fragments of the crack lines of all tiles of a raster; arguments and errors as `join_arcs`."""
    parts = CrackLineFragments.concatenated(_some(fragments))
    joined = _joined(parts)
    contrast = parts.contrast[joined.members]
    step = np.where(joined.backward, -1, 1) * parts.step[joined.members]
    sums = (reduce_runs(np.add, values, joined.bounds) for values in (contrast, step))
    return CrackLines(joined.offsets, joined.vertices, *sums)


def _some(fragments: Iterable[Some]) -> list[Some]:
    parts = list(fragments)
    if not parts:
        raise ValueError("there are no fragments to join: trace at least one tile")
    return parts


class _Joined(NamedTuple):
    """Whole polylines: i is of the fragments ``members[bounds[i]:bounds[i + 1]]``, some of which it reads backward."""

    offsets: Int64
    vertices: Vertices
    bounds: Int64
    members: Int64
    backward: NDArray[np.bool_]


def _joined(fragments: CrackFragments) -> _Joined:
    """Whole polylines in canonical direction and order; a fragment not cut has the direction from its tile."""
    offsets, vertices = fragments.offsets, fragments.vertices
    of_several = fragments.cut.any(axis=1)
    alone, split = np.flatnonzero(~of_several), np.flatnonzero(of_several)
    whole = _Joined(
        *take_runs(alone, offsets, vertices), np.arange(alone.size + 1), alone, np.zeros(alone.size, np.bool_)
    )
    if split.size == 0:
        return _sorted(whole)
    offsets, vertices = take_runs(split, offsets, vertices)
    mates = _mates(offsets, vertices, fragments.cut[split])
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


def _sorted(joined: _Joined) -> _Joined:
    order = np.argsort(_sort_keys(joined.offsets, joined.vertices), kind="stable")
    bounds, members = take_runs(order, joined.bounds, joined.members)
    _, backward = take_runs(order, joined.bounds, joined.backward)
    return _Joined(*take_runs(order, joined.offsets, joined.vertices), bounds, members, backward)


def _mates(offsets: Int64, vertices: Vertices, cut: NDArray[np.bool_]) -> Int64:
    """For each end of a fragment (2 i its first, 2 i + 1 its last) the end at which the arc goes on, or -1."""
    mates = np.full(cut.size, -1, np.int64)
    ends = np.flatnonzero(cut)
    at = vertices[np.where(ends & 1, offsets[(ends >> 1) + 1] - 1, offsets[ends >> 1])]
    order = np.lexsort((at[:, 1], at[:, 0]))
    ends, at = ends[order], at[order]
    paired = ends.size % 2 == 0 and bool(np.array_equal(at[::2], at[1::2]))
    if not paired or (at[2::2] == at[1:-1:2]).all(axis=1).any():
        raise ValueError("fragments do not meet at the seams: trace every tile once, with its halo of one pixel")
    mates[ends[::2]], mates[ends[1::2]] = ends[1::2], ends[::2]
    return mates


@loop
def _starts_later(polyline: Vertices) -> bool:
    """Whether a polyline reads better from its end: by row and column of the corner, then by heading."""
    a, b, y, z = polyline[0], polyline[1], polyline[-2], polyline[-1]
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
    runs: Int64,
    members: Int64,
    backward: NDArray[np.bool_],
    closed: NDArray[np.bool_],
    offsets: Int64,
    vertices: Vertices,
) -> tuple[Int64, Vertices, NDArray[np.bool_]]:
    """Concatenate the fragments of each polyline without the corners where they were cut, in canonical direction."""
    joined = np.empty_like(vertices)
    bounds = np.zeros(len(runs), np.int64)
    turned = np.zeros(len(runs) - 1, np.bool_)
    cursor = 0
    for c in range(len(runs) - 1):
        start = cursor
        for k in range(runs[c], runs[c + 1]):
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
