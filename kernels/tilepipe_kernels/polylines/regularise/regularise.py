"""Borders of building-like regions turned to the regions' main directions, shared borders staying shared.

Every edge of a simplified border that can turn to a main direction without leaving the tolerance lies on a *line* in
that direction; edges that go on from one another in one direction lie on the same line while all their ends stay
within the tolerance of it. Vertices move to where their lines cross. So the walls of a house become parallel and
perpendicular, a chamfer that simplification has left at a corner or in a wall vanishes, and the fronts of a row of
houses become one line. A vertex is one point for all regions around it, and it moves only where the topology stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.regularise.directions import Directions, main_directions
from tilepipe_kernels.polylines.regularise.fitted_lines import fitted_lines, joined_lines
from tilepipe_kernels.polylines.regularise.moves import move_points, remove_vertices
from tilepipe_kernels.polylines.regularise.points import UNITS, Bools, Points, Sides, arcs_near, points_of, sides_of
from tilepipe_kernels.polylines.simplify import simplify_polylines

LEAST_SINE = 0.5
"""Sine of the angle from which two lines tell a point."""
OF_LINES = float(np.sqrt(0.5))
"""Share of the tolerance by which edges may move, so that a right angle moves by no more than all of it."""

Float = NDArray[np.float64]


def regularise_arcs(
    exact: Arcs,
    tolerance: float,
    shape: tuple[int, int],
    *,
    simplification: float = 0.0,
    pixel_height: float = 1.0,
    pixel_width: float = 1.0,
    regions: NDArray[np.bool_] | None = None,
) -> Arcs:
    """Simplify arcs, and turn the borders of building-like regions to their main directions.

    Parameters
    ----------
    exact
        Arcs along the cracks of a raster, as `join_arcs` gives them.
    tolerance
        Largest move of a vertex in metres; the borders to regularise are simplified with 0.71 of it. With less than
        twice the steps of the borders (the side of a smallest leaf) there is little to find.
    shape
        Rows and columns of the raster: vertices on its outer border stay on it.
    simplification
        Tolerance of the other borders in metres, as for `simplify_polylines`.
    pixel_height, pixel_width
        Size of a pixel in metres, > 0.
    regions
        bool, indexed by region id: which regions to regularise. Default: those with the shape of a building, see
        `main_directions`.

    Returns
    -------
    Arcs
        The same arcs in the same order between the same regions, a valid coverage; vertices are float64, multiples of
        1 / 256 of a pixel; a ring may start at another vertex. No region loses more than half of its area by moves.

    Raises
    ------
    ValueError
        For tolerances < 0 or pixel sizes that are not > 0.

    Examples
    --------
    The border of a turned building has a corner at nearly every pixel; four of them are left.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> from tilepipe_kernels.polylines.join import join_arcs
    >>> from tilepipe_kernels.polylines.regularise.regularise import regularise_arcs
    >>> y, x = np.mgrid[-60:60, -60:60]
    >>> inside = (abs(0.87 * x + 0.5 * y) < 30) & (abs(0.87 * y - 0.5 * x) < 20)
    >>> arcs = join_arcs([trace_arcs(1 + inside.astype(np.int32))])
    >>> building = regularise_arcs(arcs, tolerance=2.0, shape=inside.shape)
    >>> np.diff(arcs.offsets).max().item() > 100, np.diff(building.offsets).tolist()  # rings repeat their first corner
    (True, [5, 5])
    """
    sizes = pixel_height, pixel_width
    allowance = OF_LINES * tolerance
    coarse = simplify_polylines(exact, allowance, *sizes)
    if len(exact) == 0 or tolerance == 0:
        return simplify_polylines(exact, simplification, *sizes)
    directions = main_directions(coarse, shape, *sizes, regions)
    regular = (directions.frame[directions.left] >= 0) | (directions.frame[directions.right] >= 0)
    arcs = simplify_polylines(exact, np.where(regular, allowance, simplification), *sizes)
    sides = sides_of(arcs, directions.left, directions.right)
    near = arcs_near(arcs, regular, 2 * tolerance / min(sizes) + 2)
    far = np.setdiff1d(np.arange(len(arcs)), near, assume_unique=True)
    turned = _turned(arcs.taken(near), exact.taken(near), sides.taken(near), directions, tolerance, shape, sizes)
    return Arcs.concatenated([arcs.taken(far), turned]).taken(np.argsort(np.concatenate([far, near])))


def _turned(
    arcs: Arcs,
    exact: Arcs,
    sides: Sides,
    directions: Directions,
    tolerance: float,
    shape: tuple[int, int],
    sizes: tuple[float, float],
) -> Arcs:
    """Simplified arcs turned to the main directions."""
    reach, allowance = tolerance / min(sizes), OF_LINES * tolerance
    lines = fitted_lines(arcs, exact, sides, directions, allowance, shape, sizes)
    points = points_of(arcs.offsets, arcs.vertices)
    line = joined_lines(lines, points, sizes, allowance)
    order = _starts_at_corners(arcs.offsets, points.of_vertex, points.offsets, line)
    arcs, line = replace(arcs, vertices=arcs.vertices[order]), line[order]
    points = points.with_vertices(arcs.offsets, order)
    arcs, line, points = _without_vertices_amid_lines(arcs, line, points, sides, reach)
    place = points.row, points.column, points.offsets, points.edges
    row, column = _targets(*place, line, lines.down, lines.right, lines.level, lines.weight, shape, sizes, tolerance)
    move_points(arcs, points, sides, row, column, reach)
    arcs, _, points = _without_vertices_amid_lines(arcs, line, points, sides, reach)
    vertices = np.stack([points.row, points.column], axis=1)[points.of_vertex] / UNITS
    return replace(arcs, vertices=vertices)


def _without_vertices_amid_lines(
    arcs: Arcs, line: Int64, points: Points, sides: Sides, reach: float
) -> tuple[Arcs, Int64, Points]:
    kept = remove_vertices(arcs, points, sides, _amid_lines(arcs.offsets, line), reach)
    left = arcs.with_vertices(kept)
    return left, line[kept], points.with_vertices(left.offsets, kept)


@loop
def _starts_at_corners(offsets: Int64, of_vertex: Int64, edges_at: Int64, line: Int64) -> Int64:
    """Order of the vertices in which no ring starts amid a line where only its own two edges meet."""
    order = np.arange(len(of_vertex))
    for arc in range(len(offsets) - 1):
        first, last = offsets[arc], offsets[arc + 1] - 1
        point = of_vertex[first]
        alone = point == of_vertex[last] and edges_at[point + 1] - edges_at[point] == 2
        if not alone or line[first] < 0 or line[first] != line[last - 1]:
            continue
        start = first + 1
        while start < last and line[start] == line[start - 1]:
            start += 1
        size = last - first
        for k in range(size + 1):
            order[first + k] = first + (start - first + k) % size
    return order


@loop
def _amid_lines(offsets: Int64, line: Int64) -> Bools:
    """Vertices between two edges of one line."""
    amid = np.zeros(len(line), np.bool_)
    for arc in range(len(offsets) - 1):
        for k in range(offsets[arc] + 1, offsets[arc + 1] - 1):
            amid[k] = line[k] >= 0 and line[k] == line[k - 1]
    return amid


@loop
def _targets(
    row: Int64, column: Int64, offsets: Int64, edges: Int64, line: Int64,
    down: Float, right: Float, level: Float, weight: Float,
    shape: tuple[int, int], sizes: tuple[float, float], tolerance: float,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Where points would lie: where the two longest of their lines cross, on the longest, or where they are."""
    to_row, to_column = row.copy(), column.copy()
    for point in range(len(row)):
        y, x = row[point] / UNITS * sizes[0], column[point] / UNITS * sizes[1]
        # a point on the raster's border has that as its first line, and no second one at a corner
        on_row = row[point] == 0 or row[point] == shape[0] * UNITS
        on_column = column[point] == 0 or column[point] == shape[1] * UNITS
        if on_row and on_column:
            continue
        first = second = -1
        for half in edges[offsets[point] : offsets[point + 1]]:
            root = line[half >> 1]
            if root >= 0 and (first < 0 or (weight[root], -root) > (weight[first], -first)):
                first = root
        if first < 0:
            continue
        a, b, c = down[first], right[first], level[first]
        if on_row or on_column:
            a, b, c = (1.0, 0.0, y) if on_row else (0.0, 1.0, x)
        for half in edges[offsets[point] : offsets[point + 1]]:
            root = line[half >> 1]
            if root < 0 or abs(a * right[root] - b * down[root]) < LEAST_SINE:
                continue
            if second < 0 or (weight[root], -root) > (weight[second], -second):
                second = root
        gap = c - (a * y + b * x)
        new_y, new_x = y + a * gap, x + b * gap
        if second >= 0:
            turn = a * right[second] - b * down[second]
            corner_y = (c * right[second] - b * level[second]) / turn
            corner_x = (a * level[second] - c * down[second]) / turn
            if np.hypot(corner_y - y, corner_x - x) <= tolerance:
                new_y, new_x = corner_y, corner_x
        if np.hypot(new_y - y, new_x - x) > tolerance:
            continue
        new_row, new_column = int(np.rint(new_y / sizes[0] * UNITS)), int(np.rint(new_x / sizes[1] * UNITS))
        inside = on_row or 0 < new_row < shape[0] * UNITS
        if inside and (on_column or 0 < new_column < shape[1] * UNITS):
            to_row[point] = row[point] if on_row else new_row
            to_column[point] = column[point] if on_column else new_column
    return to_row, to_column
