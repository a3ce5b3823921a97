"""Array loops that close gaps between lines: what a tip sees ahead, who is paired, where edges are cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.ragged import Int64

Bool = NDArray[np.bool_]


@rule
def within_cone(row: int, column: int, row_ahead: int, column_ahead: int, cosine: float, reach: float) -> bool:
    """Whether a step is at most ``reach`` long and the cosine of its angle to ahead at least ``cosine``."""
    squared = row * row + column * column
    dot = row * row_ahead + column * column_ahead
    ahead = row_ahead * row_ahead + column_ahead * column_ahead
    return 0 < squared <= reach * reach and dot > 0 and dot * dot >= cosine * cosine * squared * ahead


@loop
def points_behind(
    offsets: Int64, start: Int64, stop: Int64, backward: Bool, ends: Int64, steps: int
) -> tuple[Int64, Int64]:
    """Canonical positions of the point at each edge end, and ``steps`` before it or at the other end."""
    tip = np.empty(len(ends), np.int64)
    behind = np.empty(len(ends), np.int64)
    for i, end in enumerate(ends):
        edge, left = end >> 1, steps
        first, last = offsets[edge], offsets[edge + 1] - 1
        for k in range(last - first + 1):
            part = last - k if end & 1 else first + k
            descending = backward[part] != (end & 1 == 1)
            near = stop[part] - 1 if descending else start[part]
            far = start[part] if descending else stop[part] - 1
            if k == 0:
                tip[i] = near
            size = stop[part] - start[part]
            if left < size:
                behind[i] = near - left if descending else near + left
                break
            behind[i] = far
            left -= size
    return tip, behind


@loop
def look_ahead(
    pixels: Int64,
    source: Int64,
    step: Int64,
    count: Int64,
    position: Int64,
    edge: Int64,
    width: int,
    cell: int,
    cell_start: NDArray[np.int32],
    cells_across: int,
    tips: Int64,
    pairs: Int64,
    pair_start: Int64,
    cosine: float,
    reach: float,
    nearest: Int64,
    blocked: Bool,
) -> None:
    """Show the points of one tile to the dangling tips around them.

    For each tip the nearest point of another edge within its cone is kept, ties to the lower canonical
    position; so the outcome does not depend on the order of the tiles. A pair of facing tips is blocked by
    a point of a third edge within sqrt(1/2) pixel of the segment between them: no 8-connected chain can
    cross it otherwise.

    Parameters
    ----------
    pixels
        int64: the tile's stored points.
    source, step, count, position, edge
        int64, one of each slice of the tile: first stored point (in the tile), step, number, first
        canonical position and edge; slices of removed edges have edge -1.
    width
        Columns of the raster.
    cell, cell_start, cells_across
        Tips are sorted by square cells of ``cell`` pixels, at least ``reach``; those of cell i stand from
        ``cell_start[i]`` to ``cell_start[i + 1]``; one empty cell surrounds the grid.
    tips
        int64, shape (n, 5): row, column, row ahead, column ahead, own edge.
    pairs, pair_start
        int64: pairs of tip i are the tips ``pairs[pair_start[i]:pair_start[i + 1]]``.
    cosine, reach
        Of the widest angle, and the greatest distance in pixels.
    nearest
        int64, shape (n, 2), in place: squared distance and canonical position of the nearest point so far.
    blocked
        bool, shape (pairs,), in place.
    """
    cells = len(cell_start) - 1
    for i in range(len(source)):
        if edge[i] < 0:
            continue
        for k in range(count[i]):
            pixel = pixels[source[i] + step[i] * k]
            row, column = pixel // width, pixel % width
            middle = (row // cell + 1) * cells_across + column // cell + 1
            for line in range(-1, 2):
                around = middle + line * cells_across
                if around < 1 or around + 2 > cells:
                    continue
                for t in range(cell_start[around - 1], cell_start[around + 2]):
                    if tips[t, 4] == edge[i]:
                        continue
                    r, c = row - tips[t, 0], column - tips[t, 1]
                    if r * r + c * c > reach * reach:
                        continue
                    if within_cone(r, c, tips[t, 2], tips[t, 3], cosine, reach):
                        found = (r * r + c * c, position[i] + k)
                        if found < (nearest[t, 0], nearest[t, 1]):
                            nearest[t, 0], nearest[t, 1] = found
                    for p in range(pair_start[t], pair_start[t + 1]):
                        other = pairs[p]
                        if tips[other, 4] == edge[i]:
                            continue
                        r_pair, c_pair = tips[other, 0] - tips[t, 0], tips[other, 1] - tips[t, 1]
                        squared = r_pair * r_pair + c_pair * c_pair
                        dot, cross = r * r_pair + c * c_pair, r * c_pair - c * r_pair
                        if 0 < dot < squared and 2 * cross * cross <= squared:
                            blocked[p] = True


@loop
def match_greedily(one: Int64, other: Int64, things: int) -> Bool:
    """Accept pairs in the given order, each thing at most once; so every accepted pair is mutually best."""
    free = np.ones(things, np.bool_)
    accepted = np.zeros(len(one), np.bool_)
    for i in range(len(one)):
        if free[one[i]] and free[other[i]]:
            free[one[i]] = free[other[i]] = False
            accepted[i] = True
    return accepted


@loop
def cut_parts(
    offsets: Int64,
    start: Int64,
    stop: Int64,
    backward: Bool,
    cut_edge: Int64,
    cut_part: Int64,
    cut_position: Int64,
) -> tuple[Int64, Int64, Int64, Int64, Bool]:
    """Cut edges at canonical positions; the point at a cut ends one piece and begins the next.

    Parameters
    ----------
    offsets, start, stop, backward
        Parts of the edges.
    cut_edge, cut_part, cut_position
        int64: edge, part (index into ``start``) and canonical position of each cut, sorted along the edges.

    Returns
    -------
    parent, offsets, start, stop, backward
        Edge of each piece, and the pieces' parts.
    """
    pieces, cuts = len(offsets) - 1 + len(cut_edge), len(cut_edge)
    parent = np.empty(pieces, np.int64)
    bounds = np.zeros(pieces + 1, np.int64)
    new_start = np.empty(len(start) + cuts, np.int64)
    new_stop = np.empty(len(start) + cuts, np.int64)
    new_backward = np.empty(len(start) + cuts, np.bool_)
    cut = piece = cursor = 0
    for edge in range(len(offsets) - 1):
        for part in range(offsets[edge], offsets[edge + 1]):
            low, high = start[part], stop[part]
            while cut < cuts and cut_edge[cut] == edge and cut_part[cut] == part:
                at = cut_position[cut]
                new_start[cursor] = at if backward[part] else low
                new_stop[cursor] = high if backward[part] else at + 1
                new_backward[cursor] = backward[part]
                if backward[part]:
                    high = at + 1
                else:
                    low = at
                cursor, cut = cursor + 1, cut + 1
                parent[piece], bounds[piece + 1] = edge, cursor
                piece += 1
            new_start[cursor], new_stop[cursor], new_backward[cursor] = low, high, backward[part]
            cursor += 1
        parent[piece], bounds[piece + 1] = edge, cursor
        piece += 1
    return parent, bounds, new_start, new_stop, new_backward
