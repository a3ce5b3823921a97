"""What covers each pixel of a window: ground, building, tree or car; natural texture and missing returns.

A window is ``(first_row, first_column, rows, columns)`` in global pixels and may reach over the city's
border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.synthetic.blocks import blocks_near, populate
from tilepipe.synthetic.ground import lay_ground
from tilepipe.synthetic.hashing import HIGH_BITS, UNIT, bits, draws, mixed, uniform
from tilepipe.synthetic.objects import FLAT, GABLED, HIPPED, TREE
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe.synthetic.city import Layout

Window = tuple[int, int, int, int]

#: Share of pixels without a return, mesh of the lattice of larger voids and share of its cells that hold one.
SPECK_SHARE, VOID_MESH, VOID_SHARE = 0.0012, 170.0, 0.3
VOID_REACH = 16.0
#: Distance between the points at which the blocks near a window are looked for.
STRIDE_METRES = 16.0
SPECK_STREAM, VOID_STREAM = 70, 71
NOTHING = -1
LOWEST = np.float32(-1e9)
TWO, THREE = np.float32(2), np.float32(3)


@dataclass(frozen=True)
class Scene:
    """What covers a window; all rasters have its shape.

    Attributes
    ----------
    objects
        Objects near the window, dtype ``blocks.OBJECT``.
    ground
        uint8, the kind of ground (``GRASS`` ... ``MARKING``) below everything.
    visible
        int32, number of the object seen from above, or -1.
    footprint
        int32, number of the building that stands there whatever hides it, or -1.
    top
        float32, absolute height in metres of the visible object.
    """

    objects: NDArray[Any]
    ground: NDArray[np.uint8]
    visible: NDArray[np.int32]
    footprint: NDArray[np.int32]
    top: NDArray[np.float32]


def scene(layout: Layout, window: Window) -> Scene:
    """Lay the ground of a window and put up the objects that show in it."""
    row, column, rows, columns = window
    stride = max(1, int(STRIDE_METRES / layout.resolution))
    objects = populate(layout, blocks_near(layout, row, column, rows, columns, stride), False)
    visible, footprint = (
        np.full((rows, columns), NOTHING, np.int32),
        np.full((rows, columns), NOTHING, np.int32),
    )
    top = np.full((rows, columns), LOWEST, np.float32)
    paint(layout.resolution, row, column, objects, visible, footprint, top)
    return Scene(objects, lay_ground(layout, row, column, rows, columns), visible, footprint, top)


@loop
def paint(
    resolution: float, row: int, column: int, objects: NDArray[Any],
    visible: NDArray[np.int32], footprint: NDArray[np.int32], top: NDArray[np.float32],
) -> None:  # fmt: skip
    """Paint objects into the rasters of a window: the highest is seen, of equals the first."""
    rows, columns = top.shape
    for n in range(objects.shape[0]):
        item = objects[n]
        reach = 1.15 * item.half_length
        if item.kind != TREE:
            reach = math.hypot(item.half_length, item.half_width)
        low_row = max(0, int(math.floor((item.y - reach) / resolution)) - row)
        high_row = min(rows, int(math.ceil((item.y + reach) / resolution)) - row)
        low_column = max(0, int(math.floor((item.x - reach) / resolution)) - column)
        high_column = min(columns, int(math.ceil((item.x + reach) / resolution)) - column)
        for r in range(low_row, high_row):
            y = (row + r + 0.5) * resolution - item.y
            for c in range(low_column, high_column):
                x = (column + c + 0.5) * resolution - item.x
                along, across = x * item.cos + y * item.sin, y * item.cos - x * item.sin
                if item.kind == TREE:
                    share = crown_share(along, across, item.half_length)
                    if share >= 1.0:
                        continue
                    height = item.eaves + item.rise * math.sqrt(1.0 - share)
                else:
                    if abs(along) > item.half_length or abs(across) > item.half_width:
                        continue
                    height = item.eaves + item.rise * roof_share(
                        item.kind, along, across, item.half_length, item.half_width
                    )
                    if item.building > 0:
                        footprint[r, c] = n
                height = np.float32(item.base + height)
                if height > top[r, c]:
                    top[r, c], visible[r, c] = height, n


@rule
def crown_share(along: float, across: float, radius: float) -> float:
    """Squared distance from the trunk over that of the border of a crown with three and five lobes."""
    square = along * along + across * across
    distance = math.sqrt(square) + 1e-9
    cos, sin = along / distance, across / distance
    lobes = 1.0 + 0.08 * sin * (3.0 - 4.0 * sin * sin) + 0.06 * cos * (16.0 * cos**4 - 20.0 * cos * cos + 5.0)
    return square / (radius * radius * lobes * lobes)


@rule
def roof_share(kind: int, along: float, across: float, half_length: float, half_width: float) -> float:
    """Height of a roof between its eaves, 0, and its ridge, 1."""
    if kind == FLAT:
        return 0.0
    slope = 1.0 - abs(across) / half_width
    if kind == HIPPED:
        slope = min(slope, (half_length - abs(along)) / half_width)
    elif kind != GABLED:
        slope = min(1.0, 2.0 * (1.0 - abs(along) / half_length))
    return slope


@loop
def texture(layout: Layout, window: Window, mesh: float, stream: int) -> NDArray[np.float32]:
    """Value noise in [-1, 1]: random values on a lattice of ``mesh`` metres, smoothly interpolated."""
    row, column, rows, columns = window
    step = layout.resolution / mesh
    first_row, first_column = int(math.floor(row * step)), int(math.floor(column * step))
    high, wide = int(rows * step) + 3, int(columns * step) + 3
    lattice = np.empty((high, wide), np.float32)
    for r in range(high):
        for c in range(wide):
            lattice[r, c] = np.float32(2.0 * uniform(layout.key, stream, first_row + r, first_column + c) - 1.0)
    places, shares = np.empty(columns, np.int64), np.empty(columns, np.float32)
    for c in range(columns):
        place = (column + c + 0.5) * step
        places[c] = int(math.floor(place)) - first_column
        shares[c] = smooth(np.float32(place - math.floor(place)))
    result = np.empty((rows, columns), np.float32)
    line = np.empty(wide, np.float32)
    for r in range(rows):
        place = (row + r + 0.5) * step
        below = int(math.floor(place)) - first_row
        share = smooth(np.float32(place - math.floor(place)))
        for c in range(wide):
            line[c] = lattice[below, c] + share * (lattice[below + 1, c] - lattice[below, c])
        for c in range(columns):
            left = line[places[c]]
            result[r, c] = left + shares[c] * (line[places[c] + 1] - left)
    return result


@rule
def smooth(share: np.float32) -> np.float32:
    """The cubic step 3 s^2 - 2 s^3."""
    return share * share * (THREE - TWO * share)


@loop
def find_voids(layout: Layout, window: Window) -> NDArray[np.bool_]:
    """Pixels without a return: single specks, and blobs as over water or below other missing swath."""
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.bool_)
    for r in range(rows):
        key = bits(layout.key, SPECK_STREAM, row + r, 0)
        for c in range(columns):
            speck = float(mixed(key ^ np.uint64(column + c)) >> HIGH_BITS) * UNIT
            result[r, c] = speck < SPECK_SHARE * layout.voids
    metres = layout.resolution
    for i in range(
        int(math.floor((row * metres - VOID_REACH) / VOID_MESH)),
        int(math.floor(((row + rows) * metres + VOID_REACH) / VOID_MESH)) + 1,
    ):
        for j in range(
            int(math.floor((column * metres - VOID_REACH) / VOID_MESH)),
            int(math.floor(((column + columns) * metres + VOID_REACH) / VOID_MESH)) + 1,
        ):
            key = bits(layout.key, VOID_STREAM, i, j)
            draw = draws(key, 0)
            if draw[0] >= VOID_SHARE * layout.voids:
                continue
            y, x = (i + draw[1]) * VOID_MESH, (j + draw[2]) * VOID_MESH
            _punch(result, row, column, metres, y, x, 2.0 + 10.0 * draw[3] * draw[3])
    return result


@rule
def _punch(
    result: NDArray[np.bool_], row: int, column: int, resolution: float, y: float, x: float, radius: float
) -> None:
    """Mark a lobed blob in a mask."""
    reach = 1.15 * radius
    for r in range(
        max(0, int(math.floor((y - reach) / resolution)) - row),
        min(result.shape[0], int(math.ceil((y + reach) / resolution)) - row),
    ):
        for c in range(
            max(0, int(math.floor((x - reach) / resolution)) - column),
            min(result.shape[1], int(math.ceil((x + reach) / resolution)) - column),
        ):
            down, right = (row + r + 0.5) * resolution - y, (column + c + 0.5) * resolution - x
            if crown_share(right, down, radius) < 1.0:
                result[r, c] = True
