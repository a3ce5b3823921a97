"""`ridges.links` on the device: every point decides by itself, a launch for each round of decisions.

What a rule returns is wrapped in `np.float32` where it is kept, see `image.device.diffusion`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.ridges.links import COL_OFFSETS, ROW_OFFSETS, attaches, cost_between, is_rival, side_and_cost
from tilepipe_kernels.ridges.points import LinePoints

INFINITE = np.float32(np.inf)


@cuda.jit(device=True)
def _first_from(keys: Any, wanted: int, stop: int) -> int:
    """First of the increasing keys before `stop` that is not smaller than the wanted one; `stop` if there is none."""
    start = 0
    while start < stop:
        middle = (start + stop) // 2
        if keys[middle] < wanted:
            start = middle + 1
        else:
            stop = middle
    return start


@grid
def _neighbours(count: int, keys: Any, row_key: int, table: Any) -> None:
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        key = keys[i]
        for k in range(8):
            table[i, k] = -1
        if i > 0 and keys[i - 1] == key - 1:
            table[i, 7] = i - 1
        if i < count - 1 and keys[i + 1] == key + 1:
            table[i, 3] = i + 1
        above = key - row_key - 1
        j = _first_from(keys, above, i)
        while j < i and keys[j] <= above + 2:
            table[i, keys[j] - above] = j
            j += 1
        below = key + row_key - 1
        j = _first_from(keys, below, count)
        while j < count and keys[j] <= below + 2:
            table[i, 6 - (keys[j] - below)] = j
            j += 1


@cuda.jit(device=True)
def _point(geometry: Any, i: int) -> Any:
    return geometry[0, i], geometry[1, i], geometry[2, i], geometry[3, i]


@grid
def _rivals(count: int, table: Any, geometry: Any, down: Any, right: Any, suppressed: Any) -> None:
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        here, found = _point(geometry, i), False
        for k in range(8):
            j = table[i, k]
            if j >= 0 and is_rival(down[k], right[k], here, _point(geometry, j), j < i):
                found = True
        suppressed[i] = found


@grid
def _picks(count: int, table: Any, suppressed: Any, geometry: Any, down: Any, right: Any, picks: Any) -> None:
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        here = _point(geometry, i)
        for wanted in range(2):
            pick, best, cheapest = -1, -1, INFINITE
            for k in range(8):
                j = table[i, k]
                if j < 0 or suppressed[i] or suppressed[j]:
                    continue
                side, cost = side_and_cost(down[k], right[k], here, _point(geometry, j))
                if side == wanted and (cost < cheapest or (cost == cheapest and j < best)):
                    pick, best, cheapest = k, j, np.float32(cost)
            picks[i, wanted] = pick


@grid
def _mutual_links(count: int, table: Any, picks: Any, mutual: Any) -> None:
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        bits = 0
        for side in range(2):
            k = int(picks[i, side])
            if k >= 0:
                j, back = table[i, k], (k + 4) % 8
                if picks[j, 0] == back or picks[j, 1] == back:
                    bits |= 1 << k
        mutual[i] = bits


@cuda.jit(device=True)
def _is_attached(i: int, j: int, k: int, picks: Any, mutual: Any) -> bool:
    """Whether point i attaches to its neighbour j in direction k."""
    for side in range(2):
        if picks[i, side] == k and attaches(k, int(picks[i, 1 - side]), int(mutual[i]), int(mutual[j])):
            return True
    return False


@grid
def _all_links(count: int, table: Any, picks: Any, mutual: Any, links: Any) -> None:
    """Mutual links, and those by which this point attaches to another or another one to it."""
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        bits = int(mutual[i])
        for k in range(8):
            j = table[i, k]
            if j >= 0 and (_is_attached(i, j, k, picks, mutual) or _is_attached(j, i, (k + 4) % 8, picks, mutual)):
                bits |= 1 << k
        links[i] = bits


@cuda.jit(device=True)
def _badness(i: int, k: int, table: Any, mutual: Any, geometry: Any, down: Any, right: Any) -> Any:
    """Strict order of links, the same from both ends: attached after mutual, then by cost, then by index."""
    j = int(table[i, k])
    if j < i:
        i, j, k = j, i, (k + 4) % 8
    cost = np.float32(cost_between(down[k], right[k], _point(geometry, i), _point(geometry, j)))
    return (int(mutual[i]) & (1 << k)) == 0, cost, i, j


@cuda.jit(device=True)
def _closes_loop(
    i: int, k: int, table: Any, mutual: Any, links: Any, geometry: Any, down: Any, right: Any
) -> bool:  # fmt: skip
    """Whether the link of point i in direction k is the worst of a loop of three or four points."""
    j = int(table[i, k])
    worst = _badness(i, k, table, mutual, geometry, down, right)
    for m in range(8):
        if m == k or not int(links[i]) & (1 << m) or _badness(i, m, table, mutual, geometry, down, right) > worst:
            continue
        a = int(table[i, m])
        for n in range(8):
            if not int(links[a]) & (1 << n):
                continue
            b = int(table[a, n])
            if b == i or _badness(a, n, table, mutual, geometry, down, right) > worst:
                continue
            if b == j:
                return True
            for o in range(8):
                back = int(links[b]) & (1 << o) and table[b, o] == j
                if back and _badness(b, o, table, mutual, geometry, down, right) <= worst:
                    return True
    return False


@grid
def _without_small_loops(
    count: int, table: Any, mutual: Any, links: Any, geometry: Any, down: Any, right: Any, result: Any
) -> None:
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        bits = int(links[i])
        for k in range(8):
            if bits & (1 << k) and _closes_loop(i, k, table, mutual, links, geometry, down, right):
                bits &= ~(1 << k)
        result[i] = bits


def neighbour_table(points: LinePoints) -> Any:
    """`ridges.links.neighbour_table` of points on the device."""
    xp, count = namespace(points.row), len(points)
    # one number a pixel that grows in row-major order and leaves a gap between rows
    row_key = 1 << 32
    keys = points.row.astype(xp.int64) * row_key + points.col
    table = xp.empty((count, 8), xp.int32)
    _neighbours(count, keys, row_key, table)
    return table


def link_points(points: LinePoints) -> Any:
    """`ridges.links.link_points` of points on the device."""
    xp, count = namespace(points.row), len(points)
    table = neighbour_table(points)
    geometry = xp.stack([points.dx, points.dy, points.nx, points.ny])
    steps = xp.asarray(ROW_OFFSETS), xp.asarray(COL_OFFSETS)
    suppressed, picks = xp.empty(count, xp.uint8), xp.empty((count, 2), xp.int8)
    _rivals(count, table, geometry, *steps, suppressed)
    _picks(count, table, suppressed, geometry, *steps, picks)
    mutual, links, result = (xp.empty(count, xp.uint8) for _ in range(3))
    _mutual_links(count, table, picks, mutual)
    _all_links(count, table, picks, mutual, links)
    _without_small_loops(count, table, mutual, links, geometry, *steps, result)
    return result
