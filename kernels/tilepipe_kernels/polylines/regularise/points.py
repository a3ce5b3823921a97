"""The vertices of arcs as points, the edges that meet there, the regions beside them, and what lies near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Vertices
from tilepipe_kernels.core.ragged import Int64, offsets_of
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.simplify import CELL, cell_columns, cell_rows

UNITS = 256
"""Positions within a pixel on each axis."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Points:
    """The vertices of arcs where those at one place are one point, and the edges there.

    Edge k runs from vertex k to vertex k + 1 of the same arc.

    Attributes
    ----------
    of_vertex
        int64, shape (m,): point of each vertex; at first come the ends of arcs.
    row, column
        int64, shape (p,): position in `UNITS` of a pixel.
    offsets
        int64, shape (p + 1,): point i has ``edges[offsets[i]:offsets[i + 1]]``.
    edges
        int64, twice the number of the edge, plus one where the point is its second end.
    """

    of_vertex: Int64
    row: Int64
    column: Int64
    offsets: Int64
    edges: Int64

    def with_vertices(self, offsets: Int64, kept: Bools | Int64) -> Points:
        """The points of a part of the vertices, or of the vertices in another order, as arcs with these offsets."""
        of_vertex = self.of_vertex[kept]
        used = np.zeros(len(self.row), np.bool_)
        used[of_vertex] = True
        of_vertex = (np.cumsum(used) - 1)[of_vertex]
        row, column = self.row[used], self.column[used]
        return Points(of_vertex, row, column, *_edges_at(offsets, of_vertex, len(row)))


@dataclass(frozen=True)
class Sides:
    """Regions on the sides of arcs, their areas, and what must be left of them.

    Attributes
    ----------
    left, right
        int64, shape (n,): row of the region in the other arrays.
    area, least
        int64, shape (r,): twice the areas in squares of a pixel's `UNITS`, kept up to date, and the least ones.
    """

    left: Int64
    right: Int64
    area: Int64
    least: Int64

    def taken(self, arcs: Int64) -> Sides:
        """Sides of a part of the arcs."""
        return Sides(self.left[arcs], self.right[arcs], self.area, self.least)


def sides_of(arcs: Arcs, left: Int64, right: Int64) -> Sides:
    """Sides of all arcs of a raster with vertices on corners of pixels; row 0 is what may shrink without limit."""
    area = doubled_areas(arcs.offsets, arcs.vertices, left, right) * UNITS**2
    least = area // 2
    least[0] = np.iinfo(np.int64).min
    return Sides(left, right, area, least)


@rule
def doubled_area(r0: int, c0: int, r1: int, c1: int) -> int:
    """Twice the area between an edge and the first row, positive when the edge goes right."""
    return (r0 + r1) * (c1 - c0)


@loop
def doubled_areas(offsets: Int64, vertices: Vertices, left: Int64, right: Int64) -> Int64:
    """Twice the areas of the regions in rows 0 to r - 1, in pixels, of all arcs of a raster along corners of pixels."""
    area = np.zeros(max(left.max(), right.max()) + 1, np.int64)
    for arc in range(len(left)):
        part = 0
        for k in range(offsets[arc] + 1, offsets[arc + 1]):
            (r0, c0), (r1, c1) = vertices[k - 1], vertices[k]
            part += doubled_area(int(r0), int(c0), int(r1), int(c1))
        area[left[arc]] += part
        area[right[arc]] -= part
    return area


def points_of(offsets: Int64, vertices: Vertices) -> Points:
    """Points of arcs, in an order that their geometry alone decides."""
    end = np.zeros(len(vertices), np.bool_)
    end[offsets[:-1]] = end[offsets[1:] - 1] = True
    keys, inverse = np.unique(vertices[end].astype(np.int64) @ np.array([1 << 32, 1]), return_inverse=True)
    of_vertex = np.empty(len(vertices), np.int64)
    of_vertex[end] = inverse
    of_vertex[~end] = np.arange(len(keys), len(keys) + len(vertices) - inverse.size)
    count = len(keys) + len(vertices) - inverse.size
    row, column = np.empty((2, count), np.int64)
    row[of_vertex], column[of_vertex] = vertices.T.astype(np.int64) * UNITS
    return Points(of_vertex, row, column, *_edges_at(offsets, of_vertex, count))


@loop
def _edges_at(offsets: Int64, of_vertex: Int64, points: int) -> tuple[Int64, Int64]:
    bounds = np.zeros(points + 1, np.int64)
    for arc in range(len(offsets) - 1):
        for k in range(offsets[arc], offsets[arc + 1] - 1):
            bounds[of_vertex[k] + 1] += 1
            bounds[of_vertex[k + 1] + 1] += 1
    for point in range(points):
        bounds[point + 1] += bounds[point]
    edges, filled = np.empty(bounds[-1], np.int64), bounds.copy()
    for arc in range(len(offsets) - 1):
        for k in range(offsets[arc], offsets[arc + 1] - 1):
            for end in range(2):
                point = of_vertex[k + end]
                edges[filled[point]] = 2 * k + end
                filled[point] += 1
    return bounds, edges


# --------------------------------------------------------------------------------------------- what lies near


@dataclass(frozen=True)
class Cells:
    """Members of square cells of `CELL` pixels: cell i has ``members[offsets[i]:offsets[i + 1]]``."""

    columns: int
    offsets: Int64
    members: NDArray[np.int32]


def cells_of_points(points: Points) -> Cells:
    """Cells in which points lie."""
    cell_row, cell_column = points.row // (CELL * UNITS), points.column // (CELL * UNITS)
    columns = int(cell_column.max(initial=0)) + 1
    cell = cell_row * columns + cell_column
    offsets = offsets_of(np.bincount(cell, minlength=(int(cell_row.max(initial=0)) + 1) * columns))
    return Cells(columns, offsets, np.argsort(cell, kind="stable").astype(np.int32))


def cells_of_edges(offsets: Int64, points: Points, reach: float) -> Cells:
    """Cells that an edge comes near to, within ``reach`` pixels."""
    rows, columns = (int(at.max(initial=0)) // (CELL * UNITS) + 1 for at in (points.row, points.column))
    bounds, members = _list_edges(offsets, points.of_vertex, points.row, points.column, reach, rows, columns)
    return Cells(columns, bounds, members)


@loop
def _list_edges(
    offsets: Int64, of_vertex: Int64, row: Int64, column: Int64, reach: float, rows: int, columns: int
) -> tuple[Int64, NDArray[np.int32]]:
    bounds, members = np.zeros(rows * columns + 1, np.int64), np.empty(0, np.int32)
    for fill in (False, True):
        for arc in range(len(offsets) - 1):
            for k in range(offsets[arc], offsets[arc + 1] - 1):
                a, b = of_vertex[k], of_vertex[k + 1]
                r0, c0, r1, c1 = row[a] / UNITS, column[a] / UNITS, row[b] / UNITS, column[b] / UNITS
                first, last = cell_rows(r0, r1, reach, CELL)
                for cell_row in range(first, min(last, rows)):
                    begin, end = cell_columns(cell_row, r0, c0, r1, c1, reach, CELL)
                    for cell in range(cell_row * columns + begin, cell_row * columns + min(end, columns)):
                        if fill:
                            bounds[cell] -= 1
                            members[bounds[cell]] = k
                        else:
                            bounds[cell] += 1
        if not fill:
            for cell in range(1, len(bounds)):
                bounds[cell] += bounds[cell - 1]
            members = np.empty(bounds[-1], np.int32)
    return bounds, members


def arcs_near(arcs: Arcs, some: Bools, reach: float) -> Int64:
    """Numbers of the arcs that some arcs, or others that go on from these, may meet when points move.

    ``some`` is bool, shape (n,); ``reach`` in pixels.
    """
    largest = arcs.vertices.max(axis=0, initial=0)
    cells = np.zeros([int(most) // CELL + 1 for most in largest], np.bool_)
    near = some.copy()
    for _ in range(2):
        _mark_cells(arcs.offsets, arcs.vertices, near, cells, reach)
        _in_marked_cells(arcs.offsets, arcs.vertices, near, cells)
    return np.flatnonzero(near)


@loop
def _mark_cells(offsets: Int64, vertices: Vertices, some: Bools, cells: Bools, reach: float) -> None:
    for arc in range(len(some)):
        if not some[arc]:
            continue
        for k in range(offsets[arc] + 1, offsets[arc + 1]):
            (r0, c0), (r1, c1) = vertices[k - 1], vertices[k]
            first, last = cell_rows(r0, r1, reach, CELL)
            for cell_row in range(first, min(last, cells.shape[0])):
                begin, end = cell_columns(cell_row, r0, c0, r1, c1, reach, CELL)
                for cell_column in range(begin, min(end, cells.shape[1])):
                    cells[cell_row, cell_column] = True


@loop
def _in_marked_cells(offsets: Int64, vertices: Vertices, some: Bools, cells: Bools) -> None:
    """Set arcs that come to marked cells."""
    for arc in range(len(some)):
        k = offsets[arc] + 1
        while k < offsets[arc + 1] and not some[arc]:
            (r0, c0), (r1, c1) = vertices[k - 1], vertices[k]
            first, last = cell_rows(r0, r1, 0.0, CELL)
            for cell_row in range(first, min(last, cells.shape[0])):
                begin, end = cell_columns(cell_row, r0, c0, r1, c1, 0.0, CELL)
                for cell_column in range(begin, min(end, cells.shape[1])):
                    some[arc] |= cells[cell_row, cell_column]
            k += 1
