"""What an object of a city is: a building, tree or car with its place, shape and look."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.compiled import rule

FLAT, GABLED, HIPPED, TREE, CAR = 0, 1, 2, 3, 4
ROOFS = ("flat", "gabled", "hipped")
OBJECT = np.dtype(
    [
        ("kind", "i8"),
        ("building", "i8"),  # id, 0 for trees and cars
        ("x", "f8"),
        ("y", "f8"),
        ("cos", "f8"),  # bearing of the long axis
        ("sin", "f8"),
        ("half_length", "f8"),  # of a tree: radius of the crown
        ("half_width", "f8"),
        ("base", "f8"),  # absolute height of the foot
        ("eaves", "f8"),  # height of the walls, above the foot
        ("rise", "f8"),  # of the roof or crown above the eaves
        ("tone", "f8"),  # draw in [0, 1) for brightness
        ("hue", "f8"),  # draw in [0, 1) for colour
    ]
)
#: Height in metres that nothing reaches.
TALLEST = 27.0


@rule
def inside(item: Any, x: float, y: float, margin: float) -> bool:
    """Whether a position lies in an object's rectangle grown by ``margin``."""
    along = (x - item.x) * item.cos + (y - item.y) * item.sin
    across = (y - item.y) * item.cos - (x - item.x) * item.sin
    return bool(abs(along) <= item.half_length + margin and abs(across) <= item.half_width + margin)
