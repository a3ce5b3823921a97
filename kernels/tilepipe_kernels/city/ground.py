"""The ground of a window: streets, pavements and lawns, and the height of the terrain.

The same functions as in ``chart``, evaluated along whole rows from tables.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.chart import (
    BOULEVARD_U,
    BOULEVARD_V,
    COMMERCIAL,
    GROUND_LEVEL,
    HALF_WAVES,
    PARK,
    SPACING,
    STEEPEST,
    STREET_WAVES,
    URBAN,
    between_streets,
    block_kind,
    chart,
    dead_end,
    has_dead_end,
    off_dead_end,
    street_level,
    street_width,
)
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout

GRASS, MEADOW, CONCRETE, PAVEMENT, STREET, MARKING = 0, 1, 2, 3, 4, 5
PAVEMENT_WIDTH, MARKING_HALF_WIDTH, MARKING_PERIOD = 2.0, 0.25, 9.0
MARKED_STREET_HALF_WIDTH = 4.4
#: Bit that marks a block with a dead end in a table of block kinds.
DEAD_END = 8


@loop
def wave_tables(
    layout: Layout, row: int, column: int, rows: int, columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sine and cosine (2, waves, n) of each wave's phase down the rows and along the columns.

    As sin(a + b) is made of products of these, a pixel costs a few multiplications and no sine.
    """
    waves = layout.waves.shape[0]
    down, across = np.empty((2, waves, rows)), np.empty((2, waves, columns))
    for n in range(waves):
        for r in range(rows):
            angle = layout.waves[n, 2] * (row + r + 0.5) * layout.resolution + layout.waves[n, 3]
            down[0, n, r], down[1, n, r] = math.sin(angle), math.cos(angle)
        for c in range(columns):
            angle = layout.waves[n, 1] * (column + c + 0.5) * layout.resolution
            across[0, n, c], across[1, n, c] = math.sin(angle), math.cos(angle)
    return down, across


@loop
def lay_terrain(layout: Layout, row: int, column: int, rows: int, columns: int) -> NDArray[np.float32]:
    """Height of the ground in metres at every pixel of a window."""
    down, across = wave_tables(layout, row, column, rows, columns)
    result = np.empty((rows, columns), np.float32)
    sums = np.empty(columns)
    for r in range(rows):
        sums[:] = GROUND_LEVEL
        for wave in range(STREET_WAVES, layout.waves.shape[0]):
            amplitude = layout.waves[wave, 0]
            sin, cos = amplitude * down[0, wave, r], amplitude * down[1, wave, r]
            for c in range(columns):
                sums[c] += sin * across[1, wave, c] + cos * across[0, wave, c]
        for c in range(columns):
            result[r, c] = sums[c]
    return result


@loop
def lay_ground(layout: Layout, row: int, column: int, rows: int, columns: int) -> NDArray[np.uint8]:
    """The kind of ground at every pixel of a window, by ``chart.street_distance`` from tables of streets."""
    down, across = wave_tables(layout, row, column, rows, columns)
    result = np.empty((rows, columns), np.uint8)
    charts = np.empty((6, columns))
    metres = np.empty((3, columns))
    levels, halves, first = street_tables(layout, row, column, rows, columns)
    kinds = block_table(layout, first[0], first[1], levels.shape[1], levels.shape[1])
    for r in range(rows):
        chart_row(layout, row + r, column, down[:, :, r], across, charts, metres)
        for c in range(columns):
            u, v = charts[0, c], charts[1, c]
            w = BOULEVARD_U * u + BOULEVARD_V * v
            i = find_street(levels[0], first[0], u, SPACING[0])
            j = find_street(levels[1], first[1], v, SPACING[1])
            k = find_street(levels[2], first[2], w, SPACING[2])
            near_u = _between(levels[0], halves[0], i, u, metres[0, c])
            near_v = _between(levels[1], halves[1], j, v, metres[1, c])
            near_w = _between(levels[2], halves[2], k, w, metres[2, c])
            distance = min(near_u, near_v, near_w)
            kind = kinds[i, j]
            if kind & DEAD_END:
                middle, end = dead_end(levels[0, i], levels[0, i + 1], levels[1, j], levels[1, j + 1])
                off = off_dead_end((u - middle) * metres[0, c], (v - end) * metres[1, c])
                distance = min(distance, off)
            if distance > PAVEMENT_WIDTH:
                kind = kind & ~DEAD_END
                result[r, c] = CONCRETE if kind == URBAN or kind == COMMERCIAL else MEADOW if kind == PARK else GRASS
            elif distance > 0.0:
                result[r, c] = PAVEMENT
            else:
                result[r, c] = STREET
                # A broken line runs along the middle of broad streets, but not through their junctions.
                if near_u == distance and min(near_v, near_w) > 1.0:
                    middle, along, half = _nearer(levels[0], halves[0], i, u, metres[0, c]), v, near_u
                elif near_v == distance and min(near_u, near_w) > 1.0:
                    middle, along, half = _nearer(levels[1], halves[1], j, v, metres[1, c]), u, near_v
                else:
                    continue
                dash = along / MARKING_PERIOD
                broad = middle - half > MARKED_STREET_HALF_WIDTH
                if broad and middle < MARKING_HALF_WIDTH and dash - math.floor(dash) < 0.45:
                    result[r, c] = MARKING
    return result


@loop
def street_tables(
    layout: Layout, row: int, column: int, rows: int, columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Levels and half widths (3, n) of each family's streets near a window, and the index of each first."""
    x, y = (column + 0.5 * columns) * layout.resolution, (row + 0.5 * rows) * layout.resolution
    u, v, _, _, _, _ = chart(layout, x, y)
    reach = STEEPEST * (BOULEVARD_U + BOULEVARD_V) * 0.5 * math.hypot(rows, columns) * layout.resolution
    count = int(2.0 * reach / SPACING[0]) + 6
    levels, halves, first = np.empty((3, count)), np.empty((3, count)), np.empty(3, np.int64)
    middle = (u, v, BOULEVARD_U * u + BOULEVARD_V * v)
    for family in range(3):
        first[family] = int(math.floor((middle[family] - reach) / SPACING[family])) - 2
        for n in range(count):
            levels[family, n] = street_level(layout, family, first[family] + n)
            halves[family, n] = 0.5 * street_width(layout, family, first[family] + n)
    return levels, halves, first


@rule
def find_street(levels: NDArray[np.float64], first: int, value: float, spacing: float) -> int:
    """``chart.street_before`` as a place in a family's table of levels."""
    place = int(math.floor(value / spacing)) - first
    return place if levels[place] <= value else place - 1


@loop
def block_table(layout: Layout, first_i: int, first_j: int, along: int, across: int) -> NDArray[np.uint8]:
    """Kind of each block, with the bit ``DEAD_END`` where it has one."""
    kinds = np.empty((along, across), np.uint8)
    for i in range(along):
        for j in range(across):
            kinds[i, j] = block_kind(layout, first_i + i, first_j + j)
            if has_dead_end(layout, first_i + i, first_j + j):
                kinds[i, j] |= DEAD_END
    return kinds


@rule
def chart_row(
    layout: Layout, row: int, column: int, down: NDArray[np.float64], across: NDArray[np.float64],
    charts: NDArray[np.float64], metres: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fill ``charts`` (6, columns) with ``chart.chart`` along a row, ``metres`` with 1 / gradients."""
    columns = charts.shape[1]
    y = (row + 0.5) * layout.resolution
    for c in range(columns):
        x = (column + c + 0.5) * layout.resolution
        charts[0, c], charts[1, c] = layout.cos * x + layout.sin * y, layout.cos * y - layout.sin * x
    charts[2], charts[3], charts[4], charts[5] = layout.cos, layout.sin, -layout.sin, layout.cos
    for wave in range(STREET_WAVES):
        amplitude, kx, ky = layout.waves[wave, 0], layout.waves[wave, 1], layout.waves[wave, 2]
        sin, cos = amplitude * down[0, wave], amplitude * down[1, wave]
        family = wave // HALF_WAVES
        value, slope_x, slope_y = charts[family], charts[2 + 2 * family], charts[3 + 2 * family]
        for c in range(columns):
            value[c] += sin * across[1, wave, c] + cos * across[0, wave, c]
            change = cos * across[1, wave, c] - sin * across[0, wave, c]
            slope_x[c] += kx * change
            slope_y[c] += ky * change
    for c in range(columns):
        ux, uy, vx, vy = charts[2, c], charts[3, c], charts[4, c], charts[5, c]
        wx, wy = BOULEVARD_U * ux + BOULEVARD_V * vx, BOULEVARD_U * uy + BOULEVARD_V * vy
        metres[0, c] = 1.0 / math.sqrt(ux * ux + uy * uy)
        metres[1, c] = 1.0 / math.sqrt(vx * vx + vy * vy)
        metres[2, c] = 1.0 / math.sqrt(wx * wx + wy * wy)


@rule
def _between(levels: NDArray[np.float64], halves: NDArray[np.float64], n: int, value: float, metres: float) -> float:
    """``chart.between_streets`` of streets n and n + 1 of a table."""
    return between_streets(value, metres, levels[n], levels[n + 1], halves[n], halves[n + 1])


@rule
def _nearer(levels: NDArray[np.float64], halves: NDArray[np.float64], n: int, value: float, metres: float) -> float:
    """Distance in metres to the centerline of whichever of streets n and n + 1 has the nearer border."""
    low, high = (value - levels[n]) * metres, (levels[n + 1] - value) * metres
    nearer: float = low if low - halves[n] < high - halves[n + 1] else high
    return nearer
