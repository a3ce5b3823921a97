"""What covers each pixel of a window: ground, building, tree or car."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.blocks import blocks_near, populate
from tilepipe_kernels.city.ground import lay_ground
from tilepipe_kernels.city.objects import FLAT, GABLED, HIPPED, TREE
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout, Window

#: Distance between the points at which the blocks near a window are looked for.
STRIDE_METRES = 16.0
NOTHING = -1
LOWEST = np.float32(-1e9)


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
    """Lay the ground of a window and put up the objects that show in it.

    Parameters
    ----------
    layout
        The city.
    window
        First row, first column, rows and columns in global pixels.

    Returns
    -------
    Scene
        The same pixels whatever the window.

    Examples
    --------
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> from tilepipe_kernels.city.scene import scene
    >>> city = city_layout(3, (400, 400), 0.5)
    >>> whole, part = scene(city, (0, 0, 400, 400)), scene(city, (100, 50, 30, 40))
    >>> bool((whole.ground[100:130, 50:90] == part.ground).all())
    True
    """
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
