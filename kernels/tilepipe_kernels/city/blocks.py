"""What stands in a block: buildings on its lots, trees in its gardens and along its streets, parked cars.

Everything a block holds is drawn from a key of its own, so any window finds the same objects by asking the
blocks around it, and no object reaches farther out of its block than ``chart.REACH``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.buildings import add_buildings
from tilepipe_kernels.city.chart import (
    PARK,
    REACH,
    RESIDENTIAL,
    STEEPEST,
    block_kind,
    block_levels,
    chart,
    position,
    street_before,
    street_distance,
    street_level,
    street_width,
    terrain,
)
from tilepipe_kernels.city.hashing import bits, draws
from tilepipe_kernels.city.objects import CAR, OBJECT, TREE, inside
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout

#: Most objects of one block; distance of trunks from walls in metres; stream of the blocks' keys.
CAPACITY, WALL_CLEARANCE, BLOCK_STREAM = 640, 1.0, 20
#: Where the draws of a block's lots end and those of its garden trees, sides, street trees and cars begin.
GARDEN, SIDE, STREET_TREE, CARS = 10_000, 20_000, 30_000, 40_000
PARKING_SPACING = 6.3


@loop
def blocks_near(
    layout: Layout, first_row: int, first_column: int, rows: int, columns: int, stride: int
) -> NDArray[np.int64]:
    """Blocks (n, 2) in row-major order whose objects may show in a window, tested every ``stride`` pixels."""
    spread = STEEPEST * (REACH + stride * layout.resolution)
    down, right = rows // stride + 2, columns // stride + 2
    spans = np.empty((down * right, 2, 2), np.int64)
    bounds = np.array([[2**62, -(2**62)], [2**62, -(2**62)]])
    for n in range(down * right):
        x = (first_column + n % right * stride) * layout.resolution
        y = (first_row + n // right * stride) * layout.resolution
        coordinates = chart(layout, x, y)
        for family in range(2):
            low = street_before(layout, family, coordinates[family] - spread)
            high = street_before(layout, family, coordinates[family] + spread)
            spans[n, family, 0], spans[n, family, 1] = low, high
            bounds[family, 0], bounds[family, 1] = min(bounds[family, 0], low), max(bounds[family, 1], high)
    first_i, first_j = bounds[0, 0], bounds[1, 0]
    reached = np.zeros((bounds[0, 1] - first_i + 1, bounds[1, 1] - first_j + 1), np.bool_)
    for n in range(down * right):
        for i in range(spans[n, 0, 0], spans[n, 0, 1] + 1):
            for j in range(spans[n, 1, 0], spans[n, 1, 1] + 1):
                reached[i - first_i, j - first_j] = True
    blocks = np.empty((reached.size, 2), np.int64)
    count = 0
    for i in range(reached.shape[0]):
        for j in range(reached.shape[1]):
            if reached[i, j]:
                blocks[count, 0], blocks[count, 1] = first_i + i, first_j + j
                count += 1
    return blocks[:count]


@loop
def populate(layout: Layout, blocks: NDArray[np.int64], buildings_only: bool) -> NDArray[Any]:
    """The objects (n,) of dtype OBJECT of some blocks (m, 2), block by block."""
    objects = np.zeros(blocks.shape[0] * CAPACITY, OBJECT)
    total = 0
    for n in range(blocks.shape[0]):
        i, j = blocks[n, 0], blocks[n, 1]
        own = objects[total : total + CAPACITY]
        count = add_buildings(layout, block_key(layout, i, j), i, j, own)
        if not buildings_only:
            houses = count
            count = _add_garden_trees(layout, i, j, own, count, houses)
            for side in range(4):
                count = _add_along_street(layout, i, j, side, own, count, houses)
        total += count
    return objects[:total]


@rule
def block_key(layout: Layout, i: int, j: int) -> np.uint64:
    """The key from which everything in a block is drawn."""
    return bits(layout.key, BLOCK_STREAM, i, j)


@loop
def _add_garden_trees(layout: Layout, i: int, j: int, own: NDArray[Any], count: int, houses: int) -> int:
    """Scatter trees over a block, clear of walls and streets; returns the number of objects."""
    kind, key = block_kind(layout, i, j), block_key(layout, i, j)
    low_u, high_u, low_v, high_v = block_levels(layout, i, j)
    share = 150.0 if kind == PARK else 340.0 if kind == RESIDENTIAL else 900.0
    wanted = int(layout.trees * (high_u - low_u) * (high_v - low_v) / share)
    for n in range(min(wanted, CAPACITY // 2)):
        draw = draws(key, GARDEN + n)
        u, v = low_u + (high_u - low_u) * draw[0], low_v + (high_v - low_v) * draw[1]
        x, y = position(layout, u, v)
        u, v, ux, uy, vx, vy = chart(layout, x, y)
        if street_distance(layout, u, v, ux, uy, vx, vy) > 2.5 and _is_clear(own, houses, x, y):
            _plant(layout, own[count], x, y, 1.4 + 3.8 * draw[2] * draw[2], draw)
            count += 1
    return count


@rule
def _is_clear(own: NDArray[Any], houses: int, x: float, y: float) -> bool:
    """Whether a trunk at a position stands clear of the block's walls."""
    clear = True
    for n in range(houses):
        clear = clear and not inside(own[n], x, y, WALL_CLEARANCE)
    return clear


@rule
def _plant(layout: Layout, item: Any, x: float, y: float, radius: float, draw: NDArray[np.float64]) -> None:
    """Describe a tree in ``item``."""
    item.kind, item.building = TREE, 0
    item.x, item.y, item.half_length, item.half_width = x, y, radius, radius
    item.base, item.eaves = terrain(layout, x, y), 1.2 * radius
    item.rise = radius * (1.0 + 0.8 * draw[4])
    item.tone, item.hue = draw[5], draw[6]
    bearing = 2.0 * math.pi * draw[7]
    item.cos, item.sin = math.cos(bearing), math.sin(bearing)


@loop
def _add_along_street(layout: Layout, i: int, j: int, side: int, own: NDArray[Any], count: int, houses: int) -> int:
    """Trees and parked cars along one side of a block: 0, 1 its two u streets, 2, 3 its two v streets."""
    family, far = side // 2, side % 2
    index = (i if family == 0 else j) + far
    level, half = street_level(layout, family, index), 0.5 * street_width(layout, family, index)
    first = j if family == 0 else i
    start = street_level(layout, 1 - family, first)
    length = street_level(layout, 1 - family, first + 1) - start
    towards = -1.0 if far else 1.0
    key = block_key(layout, i, j)
    spacing = 11.0 + 6.0 * draws(key, SIDE + side)[0]
    for n in range(int(length / spacing)):
        draw = draws(key, STREET_TREE + 4 * n + side)
        if draw[0] < 0.5 * layout.trees and count < CAPACITY:
            x, y, _, _ = _beside(layout, family, level, start + (n + 0.5) * spacing, towards * (half + 1.1))
            u, v, ux, uy, vx, vy = chart(layout, x, y)
            if street_distance(layout, u, v, ux, uy, vx, vy) > 0.8 and _is_clear(own, houses, x, y):
                _plant(layout, own[count], x, y, 1.6 + 2.8 * draw[2], draw)
                count += 1
    for n in range(int(length / PARKING_SPACING) if half > 3.6 or far == 0 else 0):
        draw = draws(key, CARS + 4 * n + side)
        if draw[0] < 0.33 * layout.cars and count < CAPACITY:
            along = start + (n + 0.3 + 0.4 * draw[1]) * PARKING_SPACING
            x, y, _, _ = _beside(layout, family, level, along, towards * (half + 0.4))
            u, v, ux, uy, vx, vy = chart(layout, x, y)
            # Beyond the border there is street only at a junction, where nobody parks.
            if street_distance(layout, u, v, ux, uy, vx, vy) > 0.2:
                item = own[count]
                item.x, item.y, item.cos, item.sin = _beside(layout, family, level, along, towards * (half - 1.3))
                _park(layout, item, draw)
                count += 1
    return count


@rule
def _beside(
    layout: Layout, family: int, level: float, along: float, offset: float
) -> tuple[float, float, float, float]:
    """Position ``offset`` metres beside the point ``along`` a centerline, and the street's direction."""
    x, y = position(layout, level, along) if family == 0 else position(layout, along, level)
    _, _, ux, uy, vx, vy = chart(layout, x, y)
    normal_x, normal_y = (ux, uy) if family == 0 else (vx, vy)
    length = math.hypot(normal_x, normal_y)
    normal_x, normal_y = normal_x / length, normal_y / length
    return x + offset * normal_x, y + offset * normal_y, -normal_y, normal_x


@rule
def _park(layout: Layout, item: Any, draw: NDArray[np.float64]) -> None:
    """Describe a parked car in ``item``, but for its place."""
    item.kind, item.building = CAR, 0
    item.half_length, item.half_width = 2.0 + 0.4 * draw[2], 0.9
    item.base, item.eaves, item.rise = terrain(layout, item.x, item.y), 1.0, 0.5
    item.tone, item.hue = draw[3], draw[4]
