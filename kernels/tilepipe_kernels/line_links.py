"""Linking line points to lines: every point decides from its neighbourhood alone, in no particular order.

Steger (1998, Section 3.3) walks along each line from its strongest point and so depends on the order of the
walk. Here each point picks the best neighbour on both sides by his cost (sub-pixel distance plus difference
of normals); two points that pick each other are linked.  A point has at most one such link a side, so these
links form plain paths and rings.  Then ends of paths attach to the path they point at, which makes the
junctions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .gaussian_passes import Floats
from .line_points import LinePoints

NEIGHBOUR_OFFSETS = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
"""(row, col) offset of neighbour direction k, clockwise from north-west; the opposite of k is (k + 4) % 8."""

LINK_RADIUS = 7
"""Pixels around a point that its links depend on.

Rivals, picks, mutual picks, attached to, attached by: one each; loops of four: two.
"""

ROW_OFFSETS = np.array([offset[0] for offset in NEIGHBOUR_OFFSETS], np.int32)
COL_OFFSETS = np.array([offset[1] for offset in NEIGHBOUR_OFFSETS], np.int32)

# Two points nearer than this along the line are one place of the line seen from two pixels.
SAME_PLACE = np.float32(0.5)
# Normals of one line turn less than 60° between neighbouring points.
SMALLEST_COSINE = np.float32(0.5)
ONE = np.float32(1)


class Geometry(NamedTuple):
    """Sub-pixel offsets and normals of the points, as in `LinePoints`."""

    dx: Floats
    dy: Floats
    nx: Floats
    ny: Floats


@loop
def _neighbour_table(row: NDArray[np.int32], col: NDArray[np.int32]) -> NDArray[np.int32]:
    count = row.size
    table = np.full((count, 8), -1, np.int32)
    # `upper` trails point i as the first point that may be its northern neighbour, so one sweep finds all
    # pairs.
    upper = 0
    for i in range(count):
        r, c = row[i], col[i]
        if i > 0 and row[i - 1] == r and col[i - 1] == c - 1:
            table[i, 7], table[i - 1, 3] = i - 1, i
        while row[upper] < r - 1 or (row[upper] == r - 1 and col[upper] < c - 1):
            upper += 1
        j = upper
        while row[j] == r - 1 and col[j] <= c + 1:
            k = col[j] - c + 1
            table[i, k], table[j, k + 4] = j, i
            j += 1
    return table


def neighbour_table(points: LinePoints) -> NDArray[np.int32]:
    """Index of each point's neighbour in the eight directions of `NEIGHBOUR_OFFSETS`, -1 where there is none.

    Parameters
    ----------
    points
        Line points in row-major order.

    Returns
    -------
    ndarray
        int32, shape (points, 8).
    """
    return _neighbour_table(points.row, points.col)


@rule
def link_cost(distance: np.float32, cosine: np.float32) -> np.float32:
    """Steger's cost of a link: sub-pixel distance plus angle between the normals (modulo pi, radians)."""
    return distance + np.float32(math.acos(min(abs(cosine), ONE)))


@loop
def _step(i: int, j: int, k: int, geometry: Geometry) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Step from i to neighbour j in direction k: x and y between the points, length, cosine of normals."""
    dx, dy, nx, ny = geometry
    x = np.float32(COL_OFFSETS[k]) + (dx[j] - dx[i])
    y = np.float32(ROW_OFFSETS[k]) + (dy[j] - dy[i])
    return x, y, np.float32(math.sqrt(x * x + y * y)), abs(nx[i] * nx[j] + ny[i] * ny[j])


@loop
def _rivals(table: NDArray[np.int32], geometry: Geometry) -> NDArray[np.bool_]:
    """Points that see a place of a line which a neighbouring pixel sees better."""
    dx, dy, _, _ = geometry
    suppressed = np.zeros(dx.size, np.bool_)
    for i in range(dx.size):
        distance = dx[i] * dx[i] + dy[i] * dy[i]
        for k in range(8):
            j = table[i, k]
            if j < 0:
                continue
            _, _, length, cosine = _step(i, j, k, geometry)
            if length <= SAME_PLACE and cosine >= SMALLEST_COSINE:
                other = dx[j] * dx[j] + dy[j] * dy[j]
                suppressed[i] |= other < distance or (other == distance and j < i)
    return suppressed


@loop
def _picks(table: NDArray[np.int32], suppressed: NDArray[np.bool_], geometry: Geometry) -> NDArray[np.int8]:
    """Direction of the neighbour picked along +tangent and -tangent, or -1; the tangent is (-ny, nx)."""
    _, _, nx, ny = geometry
    picks = np.full((nx.size, 2), -1, np.int8)
    for i in range(nx.size):
        if suppressed[i]:
            continue
        best, cheapest = np.full(2, -1, np.int32), np.full(2, np.inf, np.float32)
        for k in range(8):
            j = table[i, k]
            if j < 0 or suppressed[j]:
                continue
            x, y, length, cosine = _step(i, j, k, geometry)
            along, across = nx[i] * y - ny[i] * x, nx[i] * x + ny[i] * y
            if abs(across) > abs(along):
                continue
            side = 0 if along > 0 else 1
            cost = link_cost(length, cosine)
            if cost < cheapest[side] or (cost == cheapest[side] and j < best[side]):
                picks[i, side], cheapest[side], best[side] = k, cost, j
    return picks


@loop
def _mutual_links(table: NDArray[np.int32], picks: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Neighbour bits of the links whose two ends picked each other."""
    links = np.zeros(table.shape[0], np.uint8)
    for i in range(links.size):
        for side in range(2):
            k = picks[i, side]
            if k < 0:
                continue
            j, back = table[i, k], (k + 4) % 8
            if picks[j, 0] == back or picks[j, 1] == back:
                links[i] |= np.uint8(1 << k)
    return links


@loop
def _attached_links(table: NDArray[np.int32], picks: NDArray[np.int8], mutual: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Neighbour bits of the junction links: the end of a path and the point of a path that it picked."""
    links = np.zeros_like(mutual)
    for i in range(links.size):
        for side in range(2):
            k, other = picks[i, side], picks[i, 1 - side]
            if k < 0 or other < 0 or mutual[i] & (1 << k) or not mutual[i] & (1 << other):
                continue
            j = table[i, k]
            if mutual[j] != 0:
                links[i] |= np.uint8(1 << k)
                links[j] |= np.uint8(1 << ((k + 4) % 8))
    return links


@loop
def _badness(
    i: int, k: int, table: NDArray[np.int32], mutual: NDArray[np.uint8], geometry: Geometry
) -> tuple[bool, np.float32, int, int]:
    """Strict order of links, the same from both ends: attached after mutual, then by cost, then by index."""
    j = table[i, k]
    if j < i:
        i, j, k = j, i, (k + 4) % 8
    _, _, length, cosine = _step(i, j, k, geometry)
    attached = (mutual[i] & (1 << k)) == 0
    return attached, link_cost(length, cosine), i, j


@loop
def _without_small_loops(
    table: NDArray[np.int32], mutual: NDArray[np.uint8], attached: NDArray[np.uint8], geometry: Geometry
) -> NDArray[np.uint8]:
    """Drop the worst link of every loop of three or four points; what was connected stays connected."""
    links = mutual | attached
    result = links.copy()
    for i in range(links.size):
        for k in range(8):
            if not links[i] & (1 << k):
                continue
            j, dropped = table[i, k], False
            worst = _badness(i, k, table, mutual, geometry)
            for m in range(8):
                a = table[i, m]
                if m == k or not links[i] & (1 << m) or _badness(i, m, table, mutual, geometry) > worst:
                    continue
                for n in range(8):
                    b = table[a, n]
                    if not links[a] & (1 << n) or b == i or _badness(a, n, table, mutual, geometry) > worst:
                        continue
                    dropped |= b == j
                    for o in range(8):
                        if links[b] & (1 << o) and table[b, o] == j and b != j:
                            dropped |= _badness(b, o, table, mutual, geometry) <= worst
            if dropped:
                result[i] &= ~np.uint8(1 << k)
    return result


def link_points(points: LinePoints) -> NDArray[np.uint8]:
    """Link neighbouring line points to lines and junctions (after Steger 1998, Section 3.3).

    Where two pixels across a line see the same place of it, the one nearer to the line speaks for both.  Each
    point picks, among the neighbours whose sub-pixel positions lie within 45° of its tangent, the cheapest on
    either side. Mutual picks are links.  A path's end whose pick goes to another path is attached to it: a
    junction.

    Parameters
    ----------
    points
        Line points in row-major order.

    Returns
    -------
    ndarray
        uint8 per point: bit k is set when the point is linked to its neighbour in direction k of
        `NEIGHBOUR_OFFSETS`.  Symmetric; 0 for isolated and for suppressed points.
    """
    if len(points) == 0:
        return np.zeros(0, np.uint8)
    table = neighbour_table(points)
    geometry = Geometry(points.dx, points.dy, points.nx, points.ny)
    picks = _picks(table, _rivals(table, geometry), geometry)
    mutual = _mutual_links(table, picks)
    return _without_small_loops(table, mutual, _attached_links(table, picks, mutual), geometry)
