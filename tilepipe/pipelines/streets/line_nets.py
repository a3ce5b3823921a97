"""How many lines tiles can hold at most, and the memory that they take."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from tilepipe.engine.pipeline import Gathered, Setting


@dataclass(frozen=True)
class Net:
    """The densest net of lines that tiles can hold: crossing lines at the least distance from each other, in pixels."""

    spacing: int

    @classmethod
    def of_ridges(cls, setting: Setting) -> Net:
        """A Gaussian leaves no two lines apart that are nearer than its σ."""
        return cls(max(2, math.floor(setting.parameters.sigma_in_pixels(setting.resolution))))

    @classmethod
    def of_axes(cls, setting: Setting) -> Net:
        """Between two axes there are half of each opened street and a gap."""
        return cls(2 + 2 * math.floor(setting.parameters.opening_radius / setting.resolution))

    def fragments(self, setting: Setting) -> int:
        """Fragments of all tiles: two to each crossing."""
        rows, columns = setting.shape
        tiles = -(-rows // setting.tile) * -(-columns // setting.tile)
        crossings = [-(-min(setting.tile, side) // self.spacing) + 1 for side in (rows, columns)]
        return 2 * tiles * math.prod(crossings)

    def points(self, setting: Setting) -> int:
        """Their points, each with both its crossings."""
        return self.fragments(setting) * (self.spacing + 1)


def bytes_per_pixel(setting: Setting) -> int:
    """Peak memory of the pass per pixel, as measured: images and distances, and 32 bytes for each point of a line."""
    points = Net.of_ridges(setting).points(setting) + Net.of_axes(setting).points(setting)
    return 60 + math.ceil(32 * points / math.prod(setting.shape))


def gathered(prefix: str, net: Callable[[Setting], Net]) -> tuple[Gathered, Gathered]:
    """What one way to centerlines leaves: the graph of the streets and the points of a few tiles, measured on nets."""
    return (
        Gathered(
            f"pieces of {prefix} lines", f"{prefix}:end_kind", 600, lambda setting: net(setting).fragments(setting)
        ),
        Gathered(f"points of {prefix} lines", f"{prefix}:pixels", 80, lambda setting: net(setting).points(setting)),
    )
