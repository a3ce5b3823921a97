"""The street network as level sets of smooth functions, and the terrain under it.

Two coordinates ``u(x, y)`` and ``v(x, y)`` are a rotated frame bent by sine waves.  A street of the first
family is where ``u`` takes one value, of the second where ``v`` does, and a boulevard where ``BOULEVARD_U u +
BOULEVARD_V v`` does.  The waves are gentle enough for (u, v) to be a one-to-one map of the plane, so a street
is exact everywhere.  Block (i, j) lies between streets i and i + 1 of the first family and j and j + 1 of the
second.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.hashing import uniform
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout

STREET_WAVES, TERRAIN_WAVES = 6, 5
HALF_WAVES = STREET_WAVES // 2
#: Upper bound of the length of the gradients of u and v.
STEEPEST = 1.34
#: Mean distance of the streets of each family in metres, and how far a street strays from the middle of its
#: slot.
SPACING = (98.0, 146.0, 830.0)
STRAY = (0.17, 0.19, 0.3)
BOULEVARD_U, BOULEVARD_V = math.cos(0.62), math.sin(0.62)
#: No object reaches farther out of its block than this, in metres: the widest crown, as all stand inside.
REACH = 7.0
#: Mean height of the terrain in metres.
GROUND_LEVEL = 60.0
NEWTON_STEPS = 30
NEWTON_TOLERANCE = 1e-10

RESIDENTIAL, URBAN, COMMERCIAL, PARK = 0, 1, 2, 3
DEAD_END_WIDTH = 6.0
DEAD_END_SHARE, DEAD_END_REACH = 0.35, 0.62
DEAD_END_SHORTEST_BLOCK = 110.0
#: Streams of random numbers that this module draws from.
POSITION_STREAM, WIDTH_STREAM, DISTRICT_STREAM, KIND_STREAM, DEAD_END_STREAM = 10, 13, 16, 17, 18


@rule
def wave(layout: Layout, n: int, x: float, y: float) -> tuple[float, float, float]:
    """Height of the n-th sine wave at a position and its derivatives along x and y."""
    amplitude, kx, ky = layout.waves[n, 0], layout.waves[n, 1], layout.waves[n, 2]
    angle = kx * x + ky * y + layout.waves[n, 3]
    change = amplitude * math.cos(angle)
    return amplitude * math.sin(angle), kx * change, ky * change


@rule
def chart(layout: Layout, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Coordinates u and v at a position and their derivatives: u, v, du/dx, du/dy, dv/dx, dv/dy."""
    u, ux, uy = layout.cos * x + layout.sin * y, layout.cos, layout.sin
    v, vx, vy = layout.cos * y - layout.sin * x, -layout.sin, layout.cos
    for n in range(HALF_WAVES):
        height, slope_x, slope_y = wave(layout, n, x, y)
        u, ux, uy = u + height, ux + slope_x, uy + slope_y
        height, slope_x, slope_y = wave(layout, HALF_WAVES + n, x, y)
        v, vx, vy = v + height, vx + slope_x, vy + slope_y
    return u, v, ux, uy, vx, vy


@rule
def position(layout: Layout, u: float, v: float) -> tuple[float, float]:
    """The position (x, y) with the given coordinates, by Newton's method to NEWTON_TOLERANCE metres."""
    x, y = layout.cos * u - layout.sin * v, layout.sin * u + layout.cos * v
    for _ in range(NEWTON_STEPS):
        at_u, at_v, ux, uy, vx, vy = chart(layout, x, y)
        miss_u, miss_v = u - at_u, v - at_v
        determinant = ux * vy - uy * vx
        step_x = (vy * miss_u - uy * miss_v) / determinant
        step_y = (ux * miss_v - vx * miss_u) / determinant
        x, y = x + step_x, y + step_y
        if abs(step_x) + abs(step_y) < NEWTON_TOLERANCE:
            break
    return x, y


@loop
def positions(layout: Layout, coordinates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions of pairs of coordinates.

    Parameters
    ----------
    layout
        The city.
    coordinates
        Pairs (u, v), float64, shape (n, 2).

    Returns
    -------
    ndarray
        Pairs (x, y) in metres right of and below the corner of pixel (0, 0), shape (n, 2).

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.city.chart import chart, positions
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> city = city_layout(3, (400, 400), 0.5)
    >>> (x, y), = positions(city, np.array([[100.0, 50.0]]))
    >>> np.round(chart(city, x, y)[:2], 9).tolist()
    [100.0, 50.0]
    """
    result = np.empty_like(coordinates)
    for n in range(coordinates.shape[0]):
        result[n] = position(layout, coordinates[n, 0], coordinates[n, 1])
    return result


@rule
def terrain(layout: Layout, x: float, y: float) -> float:
    """Height of the ground in metres."""
    height = GROUND_LEVEL
    for n in range(STREET_WAVES, STREET_WAVES + TERRAIN_WAVES):
        height += wave(layout, n, x, y)[0]
    return height


@rule
def street_level(layout: Layout, family: int, index: int) -> float:
    """The coordinate value of a street's centerline, inside its slot [index, index + 1) times the spacing."""
    stray = STRAY[family] * (2.0 * uniform(layout.key, POSITION_STREAM + family, index, 0) - 1.0)
    return (index + 0.5 + stray) * SPACING[family]


@rule
def street_width(layout: Layout, family: int, index: int) -> float:
    """Width of a street in metres, 6 to 16: one street in six is an avenue, every boulevard is wide."""
    draw = uniform(layout.key, WIDTH_STREAM + family, index, 0)
    if family == 2:
        return 14.0 + 2.0 * draw
    return 6.0 + 6.0 * draw if draw < 0.83 else 12.0 + 23.0 * (draw - 0.83)


@rule
def street_before(layout: Layout, family: int, value: float) -> int:
    """Index of the last street of a family whose level is not above a coordinate value."""
    index = int(math.floor(value / SPACING[family]))
    return index if street_level(layout, family, index) <= value else index - 1


@rule
def block_levels(layout: Layout, i: int, j: int) -> tuple[float, float, float, float]:
    """Levels of the four streets around a block: low and high u, low and high v."""
    levels = np.empty(4)
    for side in range(4):
        levels[side] = street_level(layout, side // 2, (i if side < 2 else j) + side % 2)
    return levels[0], levels[1], levels[2], levels[3]


@rule
def block_kind(layout: Layout, i: int, j: int) -> int:
    """What a block is built with; neighbouring blocks of one district tend to be alike."""
    district = uniform(layout.key, DISTRICT_STREAM, i >> 2, j >> 2)
    draw = uniform(layout.key, KIND_STREAM, i, j)
    if draw < 0.09:
        return PARK
    if draw < 0.18:
        return COMMERCIAL
    return URBAN if 0.6 * district + 0.4 * (draw - 0.18) / 0.82 > 0.62 else RESIDENTIAL


@rule
def has_dead_end(layout: Layout, i: int, j: int) -> bool:
    """Whether a dead end leads from street j of the second family into the middle of the block."""
    if block_kind(layout, i, j) != RESIDENTIAL or uniform(layout.key, DEAD_END_STREAM, i, j) > DEAD_END_SHARE:
        return False
    low_u, high_u, low_v, high_v = block_levels(layout, i, j)
    return high_v - low_v > DEAD_END_SHORTEST_BLOCK and high_u - low_u > 0.8 * SPACING[0]


@rule
def between_streets(value: float, metres: float, low: float, high: float, low_half: float, high_half: float) -> float:
    """Distance in metres to the nearer border of two streets of one family, negative on a street.

    ``metres`` is the ground length of one unit of the coordinate, the reciprocal of its gradient's length.
    """
    return min((value - low) * metres - low_half, (high - value) * metres - high_half)


@rule
def off_dead_end(across: float, beyond: float) -> float:
    """Distance in metres to the border of a dead end from the offsets across it and beyond its round end."""
    beyond = max(beyond, 0.0)
    return math.sqrt(across * across + beyond * beyond) - 0.5 * DEAD_END_WIDTH


@rule
def street_distance(layout: Layout, u: float, v: float, ux: float, uy: float, vx: float, vy: float) -> float:
    """Distance in metres from a position, given its chart, to the nearest street border, negative inside.

    It is the level's offset over the gradient's length: exact to first order, as streets are narrow for their
    curves.
    """
    values = (u, v, BOULEVARD_U * u + BOULEVARD_V * v)
    wx, wy = BOULEVARD_U * ux + BOULEVARD_V * vx, BOULEVARD_U * uy + BOULEVARD_V * vy
    metres = (1.0 / math.hypot(ux, uy), 1.0 / math.hypot(vx, vy), 1.0 / math.hypot(wx, wy))
    distance = math.inf
    i, j = 0, 0
    for family in range(3):
        n, value = street_before(layout, family, values[family]), values[family]
        i, j = n if family == 0 else i, n if family == 1 else j
        distance = min(distance, _family_distance(layout, family, n, value, metres[family]))
    if has_dead_end(layout, i, j):
        low_u, high_u, low_v, high_v = block_levels(layout, i, j)
        middle, end = dead_end(low_u, high_u, low_v, high_v)
        distance = min(distance, off_dead_end((u - middle) * metres[0], (v - end) * metres[1]))
    return distance


@rule
def dead_end(low_u: float, high_u: float, low_v: float, high_v: float) -> tuple[float, float]:
    """The level of u that the dead end of a block follows, and the value of v where it ends."""
    return 0.5 * (low_u + high_u), low_v + DEAD_END_REACH * (high_v - low_v)


@rule
def _family_distance(layout: Layout, family: int, index: int, value: float, metres: float) -> float:
    """``between_streets`` of streets ``index`` and ``index + 1`` of a family."""
    low, high = street_level(layout, family, index), street_level(layout, family, index + 1)
    low_half = 0.5 * street_width(layout, family, index)
    high_half = 0.5 * street_width(layout, family, index + 1)
    return between_streets(value, metres, low, high, low_half, high_half)
