"""Buildings on the lots of a block, aligned to its streets, clear of them and of one another."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.chart import (
    COMMERCIAL,
    PARK,
    RESIDENTIAL,
    STEEPEST,
    URBAN,
    block_kind,
    chart,
    has_dead_end,
    position,
    street_distance,
    street_level,
    street_width,
    terrain,
)
from tilepipe_kernels.city.hashing import draws
from tilepipe_kernels.city.objects import FLAT, GABLED, HIPPED, TALLEST
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout

#: Most building lots of a block, and most of them side by side.
LOTS, LOTS_ACROSS = 128, 16
#: Distance of buildings from the street border and of lots from one another, in metres.
SETBACK, LOT_GAP = 3.2, 0.8
FIT_SAMPLES, FIT_TRIES, FIT_SHRINKS = 5, 4, 0.82


@rule
def lot_size(kind: int) -> tuple[float, float]:
    """Frontage along u and v of a lot in metres."""
    if kind == COMMERCIAL:
        return 44.0, 52.0
    return (20.0, 24.0) if kind == URBAN else (17.0, 19.0)


@loop
def add_buildings(layout: Layout, key: np.uint64, i: int, j: int, own: NDArray[Any]) -> int:
    """Put a building on the lots of a block; returns the number of objects."""
    kind = block_kind(layout, i, j)
    if kind == PARK:
        return 0
    low_u, high_u, low_v, high_v = inner_levels(layout, i, j)
    frontage_u, frontage_v = lot_size(kind)
    lots_u = min(8, int((high_u - low_u) / frontage_u))
    lots_v = min(LOTS_ACROSS, int((high_v - low_v) / frontage_v))
    filled = kind == COMMERCIAL or has_dead_end(layout, i, j)
    number = (i - layout.first_block) * layout.blocks_across + j - layout.first_block_across
    count = 0
    for a in range(lots_u):
        for b in range(lots_v):
            if not (filled or a == 0 or a == lots_u - 1 or b == 0 or b == lots_v - 1):
                continue
            side_u, side_v = (high_u - low_u) / lots_u, (high_v - low_v) / lots_v
            item = own[count]
            item.building = number * LOTS + a * LOTS_ACROSS + b + 1
            along_u = (b > 0 and b < lots_v - 1 and (a == 0 or a == lots_u - 1)) or (kind == RESIDENTIAL and filled)
            count += _build(
                layout, key, a * LOTS + b, kind, along_u,
                low_u + a * side_u, side_u, low_v + b * side_v, side_v, item,
            )  # fmt: skip
    return count


@rule
def inner_levels(layout: Layout, i: int, j: int) -> tuple[float, float, float, float]:
    """``chart.block_levels`` moved inwards until surely off the streets and their pavements."""
    levels = np.empty(4)
    for side in range(4):
        index = (i if side < 2 else j) + side % 2
        inwards = STEEPEST * (0.5 * street_width(layout, side // 2, index) + SETBACK)
        levels[side] = street_level(layout, side // 2, index) + (1 - 2 * (side % 2)) * inwards
    return levels[0], levels[1], levels[2], levels[3]


@rule
def _build(
    layout: Layout, key: np.uint64, lot: int, kind: int, along_u: bool,
    low_u: float, side_u: float, low_v: float, side_v: float, item: Any,
) -> int:  # fmt: skip
    """Fit one building into a lot and describe it in ``item``; returns 1, or 0 where the lot stays empty."""
    draw = draws(key, lot)
    if draw[0] < (0.12 if kind == RESIDENTIAL else 0.05):
        return 0
    fill = 0.86 if kind == URBAN else 0.74 if kind == COMMERCIAL else 0.56
    spread = 0.1 if kind == URBAN else 0.2
    fill_u = fill + spread * (draw[1] - 0.5)
    fill_v = fill + spread * (draw[2] - 0.5)
    shift_u = (1.0 - fill_u) * 0.6 * (draw[3] - 0.5)
    shift_v = (1.0 - fill_v) * 0.6 * (draw[4] - 0.5)
    x, y = position(layout, low_u + (0.5 + shift_u) * side_u, low_v + (0.5 + shift_v) * side_v)
    _, _, ux, uy, vx, vy = chart(layout, x, y)
    half_u, half_v = 0.5 * fill_u * side_u / math.hypot(ux, uy), 0.5 * fill_v * side_v / math.hypot(vx, vy)
    # The axis points along the street in front: where u stays the same, or where v does.
    axis_x, axis_y = (-uy, ux) if along_u else (vy, -vx)
    half_along, half_across = (half_v, half_u) if along_u else (half_u, half_v)
    length = math.hypot(axis_x, axis_y)
    cos, sin = axis_x / length, axis_y / length
    if half_along < half_across:
        cos, sin, half_along, half_across = -sin, cos, half_across, half_along
    item.x, item.y, item.cos, item.sin = x, y, cos, sin
    item.half_length, item.half_width = half_along, half_across
    for _ in range(FIT_TRIES):
        if _fits(layout, item, low_u, low_u + side_u, low_v, low_v + side_v):
            break
        item.half_length, item.half_width = FIT_SHRINKS * item.half_length, FIT_SHRINKS * item.half_width
    else:
        return 0
    _roof(draw, kind, item)
    item.base = terrain(layout, x, y)
    return 1 if item.half_width > 2.5 else 0


@rule
def _fits(layout: Layout, item: Any, low_u: float, high_u: float, low_v: float, high_v: float) -> bool:
    """Whether a building lies in its lot and off every street, tested on a lattice of points."""
    for a in range(FIT_SAMPLES):
        for b in range(FIT_SAMPLES):
            along = item.half_length * (2.0 * a / (FIT_SAMPLES - 1) - 1.0)
            across = item.half_width * (2.0 * b / (FIT_SAMPLES - 1) - 1.0)
            x = item.x + along * item.cos - across * item.sin
            y = item.y + along * item.sin + across * item.cos
            u, v, ux, uy, vx, vy = chart(layout, x, y)
            if u < low_u + LOT_GAP or u > high_u - LOT_GAP or v < low_v + LOT_GAP or v > high_v - LOT_GAP:
                return False
            if street_distance(layout, u, v, ux, uy, vx, vy) < SETBACK - 0.5:
                return False
    return True


@rule
def _roof(draw: NDArray[np.float64], kind: int, item: Any) -> None:
    """Draw the shape, height and look of a building."""
    shape, storeys = draw[5], draw[6]
    item.tone, item.hue = draw[7], draw[8]
    pitch = 0.45 + 0.4 * draw[9]
    if kind == RESIDENTIAL:
        item.kind = FLAT if shape < 0.12 else HIPPED if shape < 0.4 else GABLED
        item.eaves = 3.0 + 3.5 * storeys
    elif kind == URBAN:
        item.kind = FLAT if shape < 0.55 else HIPPED if shape < 0.7 else GABLED
        item.eaves = 9.0 + 3.0 * math.floor(4.0 * storeys)
    else:
        item.kind = FLAT if shape < 0.8 else GABLED
        item.eaves = 6.0 + 6.0 * storeys
        pitch = 0.2
    item.rise = 0.0 if item.kind == FLAT else min(pitch * item.half_width, TALLEST - item.eaves)
