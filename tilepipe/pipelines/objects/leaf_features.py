"""What the leaves tell of buildings: how high they lie above the ground, and how even their surface is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile
from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.heights import ground, region_means, surface_shape

TICKS_PER_METRE = 1000
"""Heights are counted in millimetres, so that all sums are exact and do not depend on the tiling."""

_HIGHEST = surface_shape.LARGEST_TICK / TICKS_PER_METRE
"""Heights in m whose surface can be measured."""


@dataclass(frozen=True)
class Relief:
    """Relief of leaves, float32 each.

    Attributes
    ----------
    above
        Mean height above the ground in m.
    planarity, bend
        Mean natural logarithms of the measures of `surface.SurfaceShape`; NaN where a leaf has none.
    """

    above: NDArray[np.float32]
    planarity: NDArray[np.float32]
    bend: NDArray[np.float32]

    @classmethod
    def of_facts(cls, facts: list[Facts], order: NDArray[np.int64]) -> Relief | None:
        """Joined from the facts of all tiles in an order of their leaves; None where it was not measured."""
        if "above" not in facts[0]:
            return None
        return cls(*(np.concatenate([f[name] for f in facts])[order] for name in ("above", "planarity", "bend")))


@dataclass(frozen=True)
class ReliefGauge:
    """Measures the relief of leaves at a ``resolution`` in m; objects up to ``largest`` m wide are no ground."""

    resolution: float
    largest: float

    @property
    def halo(self) -> int:
        """Pixels around a tile that the relief of its leaves depends on."""
        return max(
            ground.halo(self.resolution, self.largest), surface_shape.halo(surface_shape.half_width_at(self.resolution))
        )

    def measure(
        self, around: NDArray[np.int32], labels: NDArray[np.int32], count: NDArray[np.int32], tile: Tile
    ) -> Facts:
        """Relief of the leaves of a tile as facts.

        Every sum is one of whole numbers over pixels of one tile, so the tiling does not show.

        Parameters
        ----------
        around
            Ticks of the tile with its halo.
        labels
            Leaves of its core, 1 … n; 0 = nodata.
        count
            Pixels of each leaf.
        tile
            Where they lie.

        Arrays of a device stay there.
        """
        xp = namespace(around, labels, count)
        inner = tile.core_in_padded
        heights = around.astype(np.float32)
        heights /= TICKS_PER_METRE
        heights[around == surface_shape.MISSING] = np.nan
        earth = ground.ground_height(
            heights, resolution=self.resolution, largest_object=self.largest, origin=tile.padded.origin
        )
        core = inner.slices
        facts: Facts = {"above": region_means.mean_above(labels, around[core], earth[core], count, TICKS_PER_METRE)}
        half_width = surface_shape.half_width_at(self.resolution)
        near = inner.padded(surface_shape.halo(half_width), around.shape)
        ticks = xp.where(xp.abs(heights[near.slices]) < _HIGHEST, around[near.slices], np.int32(surface_shape.MISSING))
        shape = surface_shape.surface_shape(ticks, half_width=half_width)
        core = inner.relative_to(near).slices
        for name in ("planarity", "bend"):
            facts[name] = region_means.mean_logarithms(labels, getattr(shape, name)[core], count.size)
        return facts
