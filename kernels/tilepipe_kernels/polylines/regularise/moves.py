"""Vertices of arcs removed and moved one after the other, each only where no border comes to lie elsewhere.

A vertex that moves in a straight line leaves the topology as it is when no other vertex lies in a triangle that one
of its edges sweeps, and when its path meets no edge of others: at the first conflict on its way either a vertex would
come to lie on one of its edges, or it itself on another edge. A vertex that is removed moves to its neighbour. And
no region loses more than half of its area. All is decided exactly, in integers: positions are multiples of 1 / `UNITS`
of a pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.ragged import Int64, run_of_rows
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.regularise.points import (
    UNITS,
    Bools,
    Points,
    Sides,
    cells_of_edges,
    cells_of_points,
    doubled_area,
)
from tilepipe_kernels.polylines.simplify import CELL, cell_columns, cell_rows

PASSES = 4
"""How often vertices in one another's way are tried."""


# ------------------------------------------------------------------------------------------------- predicates


@rule
def _turn(r0: int, c0: int, r1: int, c1: int, row: int, column: int) -> int:
    """Sign of the turn at the second of three points; exact."""
    turn = (r1 - r0) * (column - c0) - (c1 - c0) * (row - r0)
    return int(turn > 0) - int(turn < 0)


@rule
def _in_triangle(r0: int, c0: int, r1: int, c1: int, r2: int, c2: int, row: int, column: int) -> bool:
    """Whether a point lies in a triangle or on its border; the triangle may be a line."""
    if row < min(r0, r1, r2) or row > max(r0, r1, r2) or column < min(c0, c1, c2) or column > max(c0, c1, c2):
        return False
    a, b, c = (
        _turn(r0, c0, r1, c1, row, column),
        _turn(r1, c1, r2, c2, row, column),
        _turn(r2, c2, r0, c0, row, column),
    )
    return min(a, b, c) >= 0 or max(a, b, c) <= 0


@rule
def _touch(r0: int, c0: int, r1: int, c1: int, r2: int, c2: int, r3: int, c3: int) -> bool:
    """Whether two segments have a point in common."""
    if max(r0, r1) < min(r2, r3) or max(r2, r3) < min(r0, r1) or max(c0, c1) < min(c2, c3) or max(c2, c3) < min(c0, c1):
        return False
    apart = _turn(r0, c0, r1, c1, r2, c2) * _turn(r0, c0, r1, c1, r3, c3) > 0
    return not (apart or _turn(r2, c2, r3, c3, r0, c0) * _turn(r2, c2, r3, c3, r1, c1) > 0)


@loop
def _sweeps(
    still: int, mover: int, r2: int, c2: int, into: int, row: Int64, column: Int64, alive: Bools, reach: float,
    columns: int, cells: Int64, members: NDArray[np.int32],
) -> bool:  # fmt: skip
    """Whether an edge from ``still`` to ``mover`` sweeps another point than ``into`` when ``mover`` goes to a place."""
    r0, c0, r1, c1 = row[still], column[still], row[mover], column[mover]
    margin = reach + max(abs(r2 - r1), abs(c2 - c1)) / UNITS
    rows = (len(cells) - 1) // columns
    y0, x0, y1, x1 = r0 / UNITS, c0 / UNITS, r1 / UNITS, c1 / UNITS
    first, last = cell_rows(y0, y1, margin, CELL)
    for cell_row in range(first, min(last, rows)):
        begin, end = cell_columns(cell_row, y0, x0, y1, x1, margin, CELL)
        if begin >= columns:
            continue
        for k in range(cells[cell_row * columns + begin], cells[cell_row * columns + min(end, columns)]):
            other = members[k]
            if other == still or other == mover or other == into or not alive[other]:
                continue
            if _in_triangle(r0, c0, r1, c1, r2, c2, row[other], column[other]):
                return True
    return False


# ------------------------------------------------------------------------------------------- removing, moving


@rule
def _fits(area: int, least: int, gain: int) -> bool:
    """Whether a region may gain an area: always, unless it loses what it has too little of."""
    return gain >= 0 or area + gain >= least


def remove_vertices(arcs: Arcs, points: Points, sides: Sides, removable: Bools, tolerance: float) -> Bools:
    """Say which vertices stay when removable ones go where they may; update the areas.

    Parameters
    ----------
    arcs, points, sides
        Valid arcs, their points, and the regions on their sides.
    removable
        bool, shape (m,): vertices that may go, no ends of arcs.
    tolerance
        Largest distance in pixels of a vertex from the edge that replaces it.

    Returns
    -------
    bool array of shape (m,)
    """
    cells = cells_of_points(points)
    arc_of = run_of_rows(arcs.offsets)
    kept: Bools = _remove(
        arcs.offsets, arc_of, points.of_vertex, points.row, points.column, points.offsets, points.edges,
        sides.left, sides.right, sides.area, sides.least,
        removable, tolerance, cells.columns, cells.offsets, cells.members,
    )  # fmt: skip
    return kept


@loop
def _remove(
    offsets: Int64, arc_of: Int64, of_vertex: Int64, row: Int64, column: Int64, edges_at: Int64, edges: Int64,
    left: Int64, right: Int64, area: Int64, least: Int64,
    removable: Bools, tolerance: float, columns: int, cells: Int64, members: NDArray[np.int32],
) -> Bools:  # fmt: skip
    kept, alive = np.ones(len(of_vertex), np.bool_), np.ones(len(row), np.bool_)
    size = offsets[1:] - offsets[:-1]
    for arc in range(len(offsets) - 1):
        first, last, one, other = offsets[arc], offsets[arc + 1] - 1, left[arc], right[arc]
        before = first
        for k in range(first + 1, last):
            a, u, b = of_vertex[before], of_vertex[k], of_vertex[k + 1]
            gone = removable[k] and a != b
            if gone:
                down, across = float(row[b] - row[a]), float(column[b] - column[a])
                away = (row[u] - row[a]) * across - (column[u] - column[a]) * down
                gone = abs(away) <= tolerance * UNITS * np.hypot(down, across)
            if gone and of_vertex[first] == of_vertex[last]:
                gone = size[arc] > 4
            elif gone and size[arc] == 3:
                gone = not _straight(a, b, arc, offsets, arc_of, of_vertex, edges_at, edges, size)
            if gone and not _sweeps(a, u, row[b], column[b], b, row, column, alive, 0.0, columns, cells, members):
                gain = doubled_area(row[a], column[a], row[b], column[b])
                gain -= doubled_area(row[a], column[a], row[u], column[u])
                gain -= doubled_area(row[u], column[u], row[b], column[b])
                gone = _fits(area[one], least[one], gain) and _fits(area[other], least[other], -gain)
                if gone:
                    area[one] += gain
                    area[other] -= gain
                    kept[k] = alive[u] = False
                    size[arc] -= 1
            else:
                gone = False
            if not gone:
                before = k
    return kept


@loop
def _straight(
    a: int,
    b: int,
    but: int,
    offsets: Int64,
    arc_of: Int64,
    of_vertex: Int64,
    edges_at: Int64,
    edges: Int64,
    size: Int64,
) -> bool:
    """Whether there is an arc straight from one point to another, with which a second one would coincide."""
    for half in edges[edges_at[a] : edges_at[a + 1]]:
        arc = arc_of[half >> 1]
        begin, end = of_vertex[offsets[arc]], of_vertex[offsets[arc + 1] - 1]
        if arc != but and size[arc] == 2 and ((begin == a and end == b) or (begin == b and end == a)):
            return True
    return False


def move_points(arcs: Arcs, points: Points, sides: Sides, row: Int64, column: Int64, reach: float) -> None:
    """Move points to their targets where they may, in place, in their order.

    Parameters
    ----------
    arcs, points, sides
        Valid arcs, their points, of which ``row`` and ``column`` are changed, and the regions on their sides.
    row, column
        int64, shape (p,): targets in `UNITS` of a pixel.
    reach
        Pixels: no target is farther.
    """
    movers = np.flatnonzero((row != points.row) | (column != points.column))
    # a path may be as long as the reach, and the edge that it meets has moved by as much
    edges = cells_of_edges(arcs.offsets, points, 2 * reach + 1)
    near = cells_of_points(points)
    arc_of = run_of_rows(arcs.offsets)
    _move(
        movers, row, column, arc_of, points.of_vertex, points.row, points.column, points.offsets, points.edges,
        sides.left, sides.right, sides.area, sides.least, np.ones(len(points.row), np.bool_), reach + 1,
        near.columns, near.offsets, near.members, edges.columns, edges.offsets, edges.members,
    )  # fmt: skip


@loop
def _move(
    movers: Int64, to_row: Int64, to_column: Int64, arc_of: Int64,
    of_vertex: Int64, row: Int64, column: Int64, edges_at: Int64, edges: Int64,
    left: Int64, right: Int64, area: Int64, least: Int64, alive: Bools, reach: float,
    columns: int, cells: Int64, members: NDArray[np.int32],
    edge_columns: int, edge_cells: Int64, edge_members: NDArray[np.int32],
) -> None:  # fmt: skip
    waiting = movers.copy()
    for _ in range(PASSES):
        count = 0
        for point in waiting:
            r1, c1, r2, c2 = row[point], column[point], to_row[point], to_column[point]
            around = edges[edges_at[point] : edges_at[point + 1]]
            blocked = False
            for half in around:
                still = of_vertex[(half >> 1) + 1 - (half & 1)]
                if _sweeps(still, point, r2, c2, point, row, column, alive, reach, columns, cells, members):
                    blocked = True
                    break
            if not blocked:
                cell = r1 // (CELL * UNITS) * edge_columns + c1 // (CELL * UNITS)
                near = edge_members[edge_cells[cell] : edge_cells[cell + 1]]
                blocked = _meets(point, r2, c2, near, of_vertex, row, column)
            if not blocked:
                blocked = not _exchange(point, r2, c2, around, arc_of, of_vertex, row, column, left, right, area, least)
            if blocked:
                waiting[count] = point
                count += 1
            else:
                row[point], column[point] = r2, c2
        if count == 0 or count == len(waiting):
            break
        waiting = waiting[:count]


@loop
def _meets(point: int, r2: int, c2: int, near: NDArray[np.int32], of_vertex: Int64, row: Int64, column: Int64) -> bool:
    """Whether the path of a point meets an edge of others."""
    r1, c1 = row[point], column[point]
    for edge in near:
        a, b = of_vertex[edge], of_vertex[edge + 1]
        if a != point and b != point and _touch(r1, c1, r2, c2, row[a], column[a], row[b], column[b]):
            return True
    return False


@loop
def _exchange(
    point: int, r2: int, c2: int, around: Int64, arc_of: Int64, of_vertex: Int64, row: Int64, column: Int64,
    left: Int64, right: Int64, area: Int64, least: Int64,
) -> bool:  # fmt: skip
    """Update the areas for a point that moves; or leave them and say no, when a region would lose too much."""
    r1, c1 = row[point], column[point]
    for back in range(2):
        sign = 1 - 2 * back
        for half in around:
            end = of_vertex[(half >> 1) + 1 - (half & 1)]
            gain = doubled_area(r2, c2, row[end], column[end]) - doubled_area(r1, c1, row[end], column[end])
            gain = -sign * gain if half & 1 else sign * gain
            area[left[arc_of[half >> 1]]] += gain
            area[right[arc_of[half >> 1]]] -= gain
        if back:
            return False
        enough = True
        for half in around:
            for region in (left[arc_of[half >> 1]], right[arc_of[half >> 1]]):
                enough = enough and area[region] >= least[region]
        if enough:
            return True
    return False
