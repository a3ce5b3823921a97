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

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image.gaussian_passes import Floats
from tilepipe_kernels.ridges.points import LinePoints

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

_A0, _A1, _A2, _A3 = (np.float32(a) for a in (1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046))
_A4, _A5, _A6, _A7 = (np.float32(a) for a in (0.0308918810, -0.0170881256, 0.0066700901, -0.0012624911))


Four = tuple[np.float32, np.float32, np.float32, np.float32]


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
        int32, shape (points, 8); on the device where the points lie on one.

    Examples
    --------
    Three points in a row: the middle one has the first and the last as neighbours.

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.links import neighbour_table
    >>> from tilepipe_kernels.ridges.points import line_points
    >>> image = np.full((9, 3), 200.0)
    >>> image[4] = 100
    >>> [sorted(each[each >= 0].tolist()) for each in neighbour_table(line_points(image, sigma=1.2, low=5.0))]
    [[1], [0, 2], [1]]
    """
    if on_device(points.row):
        found: NDArray[np.int32] = device_form(__name__).neighbour_table(points)
        return found
    return _neighbour_table(points.row, points.col)


@rule
def arc_cosine(cosine: np.float32) -> np.float32:
    """Angle in radians of a cosine from 0 to 1, to 2e-8 and rounding (Abramowitz & Stegun 1964, 4.4.46).

    Only products, sums and a root, so that every backend agrees.
    """
    high = _A3 + cosine * (_A4 + cosine * (_A5 + cosine * (_A6 + cosine * _A7)))
    return np.float32(math.sqrt(ONE - cosine)) * (_A0 + cosine * (_A1 + cosine * (_A2 + cosine * high)))


@rule
def link_cost(distance: np.float32, cosine: np.float32) -> np.float32:
    """Steger's cost of a link: sub-pixel distance plus angle between the normals (modulo pi, radians)."""
    return distance + arc_cosine(min(abs(cosine), ONE))


@rule
def step_between(
    down: np.int32, right: np.int32, here: Four, there: Four
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Step to the neighbour some pixels down and right: x and y between the points, length, cosine of normals.

    A point is (dx, dy, nx, ny), as in `Geometry`.
    """
    x = np.float32(right) + (there[0] - here[0])
    y = np.float32(down) + (there[1] - here[1])
    return x, y, np.float32(math.sqrt(x * x + y * y)), abs(here[2] * there[2] + here[3] * there[3])


@rule
def cost_between(down: np.int32, right: np.int32, here: Four, there: Four) -> np.float32:
    """Cost of the link of two neighbours."""
    _, _, length, cosine = step_between(down, right, here, there)
    return link_cost(length, cosine)


@rule
def is_rival(down: np.int32, right: np.int32, here: Four, there: Four, is_earlier: bool) -> bool:
    """Whether a neighbour sees the same place of a line and sees it better; of equals the earlier one does."""
    _, _, length, cosine = step_between(down, right, here, there)
    if not (length <= SAME_PLACE and cosine >= SMALLEST_COSINE):
        return False
    own, other = here[0] * here[0] + here[1] * here[1], there[0] * there[0] + there[1] * there[1]
    return bool(other < own or (other == own and is_earlier))


@rule
def side_and_cost(down: np.int32, right: np.int32, here: Four, there: Four) -> tuple[int, np.float32]:
    """Side of a neighbour, 0 along +tangent (-ny, nx), 1 along -tangent, -1 farther off than 45°; cost of its link."""
    x, y, length, cosine = step_between(down, right, here, there)
    along, across = here[2] * y - here[3] * x, here[2] * x + here[3] * y
    if abs(across) > abs(along):
        return -1, length
    return (0 if along > 0 else 1), link_cost(length, cosine)


@rule
def attaches(k: int, other: int, mutual: int, mutual_there: int) -> bool:
    """Whether the end of a path attaches to the point in direction k, which it picked on its free side.

    It picked direction `other` on the other side; `mutual` are the bits of its mutual links.
    """
    if k < 0 or other < 0 or mutual & (1 << k) or not mutual & (1 << other):
        return False
    return mutual_there != 0


@loop
def _point(geometry: Geometry, i: int) -> Four:
    return geometry.dx[i], geometry.dy[i], geometry.nx[i], geometry.ny[i]


@loop
def _rivals(table: NDArray[np.int32], geometry: Geometry) -> NDArray[np.bool_]:
    """Points that see a place of a line which a neighbouring pixel sees better."""
    suppressed = np.zeros(table.shape[0], np.bool_)
    for i in range(suppressed.size):
        here = _point(geometry, i)
        for k in range(8):
            j = table[i, k]
            if j >= 0:
                there = _point(geometry, j)
                suppressed[i] |= is_rival(ROW_OFFSETS[k], COL_OFFSETS[k], here, there, j < i)
    return suppressed


@loop
def _picks(table: NDArray[np.int32], suppressed: NDArray[np.bool_], geometry: Geometry) -> NDArray[np.int8]:
    """Direction of the neighbour picked along +tangent and -tangent, or -1."""
    picks = np.full((suppressed.size, 2), -1, np.int8)
    for i in range(suppressed.size):
        if suppressed[i]:
            continue
        here = _point(geometry, i)
        best, cheapest = np.full(2, -1, np.int32), np.full(2, np.inf, np.float32)
        for k in range(8):
            j = table[i, k]
            if j < 0 or suppressed[j]:
                continue
            side, cost = side_and_cost(ROW_OFFSETS[k], COL_OFFSETS[k], here, _point(geometry, j))
            if side >= 0 and (cost < cheapest[side] or (cost == cheapest[side] and j < best[side])):
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
            j = table[i, max(k, 0)]
            if attaches(k, other, mutual[i], mutual[max(j, 0)]):
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
    attached = (mutual[i] & (1 << k)) == 0
    cost = cost_between(ROW_OFFSETS[k], COL_OFFSETS[k], _point(geometry, i), _point(geometry, j))
    return attached, cost, i, j


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
        `NEIGHBOUR_OFFSETS`.  Symmetric; 0 for isolated and for suppressed points.  On the device where the
        points lie on one, and the same there.

    Examples
    --------
    The points of a street are linked to one another along it: each of two neighbours, the first and the last of one.

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.links import link_points
    >>> from tilepipe_kernels.ridges.points import line_points
    >>> image = np.full((17, 6), 200.0)
    >>> image[8] = 100
    >>> [int(links).bit_count() for links in link_points(line_points(image, sigma=1.2, low=5.0))]
    [1, 2, 2, 2, 2, 1]
    """
    if len(points) == 0:
        none: NDArray[np.uint8] = namespace(points.row).zeros(0, np.uint8)
        return none
    if on_device(points.row):
        links: NDArray[np.uint8] = device_form(__name__).link_points(points)
        return links
    table = neighbour_table(points)
    geometry = Geometry(points.dx, points.dy, points.nx, points.ny)
    picks = _picks(table, _rivals(table, geometry), geometry)
    mutual = _mutual_links(table, picks)
    return _without_small_loops(table, mutual, _attached_links(table, picks, mutual), geometry)
