"""Lines in the main directions of regions on which edges of their borders come to lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Vertices
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.core.union_find import flatten, root_of
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.regularise.directions import Directions, closeness, on_one_side, quarter_turns
from tilepipe_kernels.polylines.regularise.points import UNITS, Bools, Points, Sides

ROUNDS = 3
"""How often lines are made anew after short edges between parallel lines have become steps across."""
STEEP = 0.5
"""Slope of an edge against its line from which it is a chamfer, which does not tell where the line goes."""

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class FittedLines:
    """Lines of edges, by the number of an edge's first vertex, shape (m,), in metres.

    ``frame`` numbers the direction, 2 f along main direction f and 2 f + 1 across it, or is -1. A line holds the points
    with ``down * y + right * x = level``, and its edges have their ends between ``low`` and ``high``; ``weight`` is the
    length of its edges. ``root`` is the edge that keeps these figures for all edges of one line.
    """

    frame: Int64
    down: Float
    right: Float
    level: Float
    low: Float
    high: Float
    weight: Float
    root: Int64


def fitted_lines(
    arcs: Arcs,
    exact: Arcs,
    sides: Sides,
    directions: Directions,
    tolerance: float,
    shape: tuple[int, int],
    sizes: tuple[float, float],
) -> FittedLines:
    """A line of its own for each edge that can turn to a main direction of the region on one of its sides.

    ``exact`` are the same arcs along the cracks; a line leaves as much of them on either side. ``tolerance`` is the
    largest distance of an edge's end from its line in metres, ``shape`` that of the raster, whose outer border stays.
    """
    angle = np.angle(directions.quarter) / 4
    frames = directions.frame, directions.quarter, np.cos(angle), np.sin(angle)
    of_arcs = arcs.offsets, arcs.vertices, exact.offsets, exact.vertices, sides.left, sides.right
    return FittedLines(*_fit(*of_arcs, *frames, shape, sizes, tolerance))


@loop
def _fit(
    offsets: Int64, vertices: Vertices, exact_offsets: Int64, exact: Vertices,
    left: Int64, right: Int64, frames: Int64, quarter: Complex, cosine: Float, sine: Float,
    shape: tuple[int, int], sizes: tuple[float, float], tolerance: float,
) -> tuple[Int64, Float, Float, Float, Float, Float, Float, Int64]:  # fmt: skip
    size = len(vertices)
    frame, root = np.full(size, -1, np.int64), np.arange(size)
    normal_y, normal_x, level = np.zeros(size), np.zeros(size), np.zeros(size)
    low, high, weight = np.zeros(size), np.zeros(size), np.zeros(size)
    height, width = sizes
    for arc in range(len(offsets) - 1):
        one, other = left[arc], right[arc]
        if frames[one] < 0 and frames[other] < 0:
            continue
        region = _leading(vertices[offsets[arc] : offsets[arc + 1]], one, other, frames, quarter, sizes)
        at = exact_offsets[arc]
        for k in range(offsets[arc], offsets[arc + 1] - 1):
            r0, c0, r1, c1 = vertices[k, 0], vertices[k, 1], vertices[k + 1, 0], vertices[k + 1, 1]
            area = 0
            while True:
                y, x = exact[at, 0] - r0, exact[at, 1] - c0
                at += 1
                area += x * (exact[at, 0] - r0) - (exact[at, 1] - c0) * y
                if exact[at, 0] == r1 and exact[at, 1] == c1:
                    break
            if on_one_side(vertices[k], vertices[k + 1], shape):
                continue
            y, x = (r1 - r0) * height, (c1 - c0) * width
            unit_x, unit_y = cosine[region], sine[region]
            across = abs(x * unit_y - y * unit_x) > abs(x * unit_x + y * unit_y)
            if across:
                unit_x, unit_y = -unit_y, unit_x
            along, off = x * unit_x + y * unit_y, y * unit_x - x * unit_y
            begin = c0 * width * -unit_y + r0 * height * unit_x
            shift = -area / 2 * height * width / along if abs(off) < STEEP * abs(along) else 0.0
            middle = begin + off / 2 + shift
            if abs(off) / 2 + abs(shift) > tolerance:
                continue
            frame[k] = 2 * frames[region] + across
            normal_y[k], normal_x[k], level[k], weight[k] = unit_x, -unit_y, middle, abs(along)
            # a chamfer goes on from the line to a corner, where the crossing line takes its other end
            half = abs(off) / 2 if abs(off) < STEEP * abs(along) else 0.0
            low[k], high[k] = begin + off / 2 - half, begin + off / 2 + half
    return frame, normal_y, normal_x, level, low, high, weight, root


@loop
def _leading(
    vertices: Vertices, one: int, other: int, frames: Int64, quarter: Complex, sizes: tuple[float, float]
) -> int:
    """Of two regions the one to whose main directions the vertices of an arc keep better."""
    if frames[one] < 0 or frames[other] < 0:
        return other if frames[one] < 0 else one
    gain = 0.0
    for k in range(len(vertices) - 1):
        y, x = (vertices[k + 1, 0] - vertices[k, 0]) * sizes[0], (vertices[k + 1, 1] - vertices[k, 1]) * sizes[1]
        direction = quarter_turns(x, y)
        gain += (closeness(direction, quarter[other]) - closeness(direction, quarter[one])) * (x * x + y * y)
    return other if gain > 0 else one


def joined_lines(lines: FittedLines, points: Points, sizes: tuple[float, float], tolerance: float) -> Int64:
    """Join the lines of edges that go on from one another; for each edge the root of its line, or -1."""
    place = points.of_vertex, points.row, points.column
    own = lines.level.copy(), lines.low.copy(), lines.high.copy(), lines.weight.copy()
    crossed = np.zeros(len(lines.frame), np.bool_)
    for _ in range(ROUNDS):
        pairs = _straight_on(*place, points.offsets, points.edges, lines.frame, lines.down, lines.right, sizes)
        pairs = pairs[np.argsort(-own[3][pairs].sum(axis=1), kind="stable")]
        figures = lines.level, lines.low, lines.high, lines.weight
        for figure, of_edge in zip(figures, own, strict=True):
            figure[:] = of_edge
        _join(pairs, lines.root, *figures, tolerance)
        apart = pairs[lines.root[pairs[:, 0]] != lines.root[pairs[:, 1]]]
        if not len(apart):
            break
        _step_across(apart, crossed, *place, lines.frame, lines.down, lines.right, *own, sizes, tolerance)
    return np.where(lines.frame >= 0, lines.root, -1)


@loop
def _straight_on(
    of_vertex: Int64, row: Int64, column: Int64, offsets: Int64, edges: Int64,
    frame: Int64, down: Float, right: Float, sizes: tuple[float, float],
) -> Int64:  # fmt: skip
    """Pairs of edges in one direction on opposite sides of a common point."""
    pairs = np.empty((0, 2), np.int64)
    for fill in (False, True):
        count = 0
        for point in range(len(row)):
            for i in range(offsets[point], offsets[point + 1]):
                one = edges[i] >> 1
                if frame[one] < 0:
                    continue
                for j in range(i + 1, offsets[point + 1]):
                    other = edges[j] >> 1
                    if frame[other] != frame[one]:
                        continue
                    away = 1.0
                    for half in (edges[i], edges[j]):
                        end = of_vertex[(half >> 1) + 1 - (half & 1)]
                        y, x = (row[end] - row[point]) * sizes[0], (column[end] - column[point]) * sizes[1]
                        away *= x * down[one] - y * right[one]
                    if away < 0:
                        if fill:
                            pairs[count, 0], pairs[count, 1] = one, other
                        count += 1
        if not fill:
            pairs = np.empty((count, 2), np.int64)
    return pairs


@loop
def _join(pairs: Int64, root: Int64, level: Float, low: Float, high: Float, weight: Float, tolerance: float) -> None:
    """Join lines in the given order while all ends stay within the tolerance of the mean line."""
    root[:] = np.arange(len(root))
    for k in range(len(pairs)):
        one, other = root_of(root, pairs[k, 0]), root_of(root, pairs[k, 1])
        if one == other:
            continue
        both = weight[one] + weight[other]
        middle = (weight[one] * level[one] + weight[other] * level[other]) / both
        least, most = min(low[one], low[other]), max(high[one], high[other])
        if most - middle <= tolerance and middle - least <= tolerance:
            one, other = min(one, other), max(one, other)
            root[other] = one
            level[one], low[one], high[one], weight[one] = middle, least, most, both
    flatten(root)


@loop
def _step_across(
    apart: Int64, crossed: Bools, of_vertex: Int64, row: Int64, column: Int64, frame: Int64, down: Float, right: Float,
    level: Float, low: Float, high: Float, weight: Float, sizes: tuple[float, float], tolerance: float,
) -> None:  # fmt: skip
    """Of two edges on parallel lines that share a point turn the shorter one across, or leave it as it is."""
    for k in range(len(apart)):
        one, other = apart[k]
        if frame[one] != frame[other]:
            continue
        short = one if weight[one] < weight[other] else other
        a, b = of_vertex[short], of_vertex[short + 1]
        down[short], right[short] = right[short], -down[short]
        ends = (
            (row[a] * sizes[0] * down[short] + column[a] * sizes[1] * right[short]) / UNITS,
            (row[b] * sizes[0] * down[short] + column[b] * sizes[1] * right[short]) / UNITS,
        )
        low[short], high[short] = min(ends), max(ends)
        level[short] = (low[short] + high[short]) / 2
        length = np.hypot((row[b] - row[a]) * sizes[0], (column[b] - column[a]) * sizes[1]) / UNITS
        weight[short] = np.sqrt(max(length**2 - (high[short] - low[short]) ** 2, 0.0))
        frame[short] = -1 if crossed[short] or high[short] - low[short] > 2 * tolerance else frame[short] ^ 1
        crossed[short] = True
