"""First pass of `objects`: the quadtree leaves of a tile, their contacts, and what the seams need to know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Gathered, Pass, Setting, State
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.engine.work import Work
from tilepipe.io.rasters.raster import Raster
from tilepipe.pipelines.objects.leaf_features import TICKS_PER_METRE, ReliefGauge
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe.tiling.seams import border_facts
from tilepipe_kernels.core.arrays import Backend, namespace, to_backend
from tilepipe_kernels.regions import adjacency, extremes, quadtree
from tilepipe_kernels.regions.quadtree_sums import MISSING

_FARTHEST = 30_000
"""No height lies farther from zero, in metres."""

SUMMED = ("count", "total", "squares")
"""Columns of a leaf that are sums over its pixels."""


@dataclass(frozen=True)
class LeafContext:
    """What the pass needs to know; picklable."""

    raster: Raster
    parameters: ObjectParameters
    grid: TileGrid
    labels: StateArray
    backend: Backend = "numpy"

    @classmethod
    def of(cls, run: Work) -> LeafContext:
        """Of a run that begins."""
        return cls(run.raster, run.parameters, run.grid, run.state("labels"), run.backend)

    @property
    def sides(self) -> tuple[int, int]:
        """Sides of the smallest and the largest leaf in pixels."""
        return self.parameters.leaf_sides(self.raster.geometry.resolution)

    @property
    def relief(self) -> ReliefGauge:
        """How the ground and the shape of the surface are measured."""
        return ReliefGauge(self.raster.geometry.resolution, self.parameters.largest_building)


def halo(setting: Setting) -> int:
    """Pixels around a core that the pass reads."""
    p = setting.parameters
    return ReliefGauge(setting.resolution, p.largest_building).halo if p.buildings else 0


def to_ticks(
    heights: NDArray[np.float32], metres: float, largest_leaf: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Heights in a unit of ``metres`` as whole millimetres, NaN as `MISSING`; and which were none.

    What is farther than 30 km from zero, or than leaves of ``largest_leaf`` pixels can add up, is no height: it
    becomes missing as well and is marked.  Arrays of a device stay there.
    """
    xp = namespace(heights)
    scaled = xp.rint(heights.astype(np.float64) * (metres * TICKS_PER_METRE))
    most = min(_FARTHEST * TICKS_PER_METRE, quadtree.REACH // largest_leaf)
    absurd = xp.abs(scaled) > most
    ticks = xp.where(absurd | xp.isnan(scaled), MISSING, scaled).astype(np.int32)
    return ticks, absurd


def find_leaves(context: LeafContext, tile: Tile) -> Facts:
    """Tile function: facts are the leaves, their relief, their contacts, and the labels along the seams.

    All arrays lie where the context's backend has them, until they are written.
    """
    core, inner = tile.core, tile.core_in_padded.slices
    smallest, largest = context.sides
    heights = to_backend(context.raster.read(tile.padded), context.backend)
    xp = namespace(heights)
    around, absurd = to_ticks(heights, context.raster.geometry.height_metres, largest)
    ticks = xp.ascontiguousarray(around[inner])
    threshold = (context.parameters.split_deviation * TICKS_PER_METRE) ** 2
    labels, leaves = quadtree.split(
        ticks, threshold=threshold, smallest=smallest, largest=largest, origin=(core.top, core.left)
    )
    edges, length = adjacency.contacts(labels, leaves.first.size)
    row, column = xp.divmod(leaves.first, core.columns)
    facts: Facts = {name: getattr(leaves, name) for name in SUMMED}
    facts["first"] = (row + core.top) * context.grid.shape[1] + column + core.left
    lowest, highest = extremes.label_extremes(labels, ticks, leaves.first.size)
    facts |= {"edges": edges, "length": length, "lowest": lowest, "highest": highest}
    facts["absurd"] = xp.sum(absurd[inner], dtype=np.int64, keepdims=True).reshape(1)
    if context.parameters.buildings:
        facts |= context.relief.measure(around, labels, leaves.count, tile)
    return facts | write_state({"labels": context.labels}, tile, {"labels": labels}) | border_facts("label", labels)


def _smallest_side(setting: Setting) -> int:
    p: ObjectParameters = setting.parameters
    return p.leaf_sides(setting.resolution)[0]


def smallest_squares(setting: Setting) -> int:
    """Smallest squares that cover the raster."""
    smallest = _smallest_side(setting)
    rows, columns = setting.shape
    return -(-rows // smallest) * -(-columns // smallest)


def bytes_per_pixel(setting: Setting) -> int:
    """Peak memory of the pass per pixel, as measured: heights and their relief, and the leaves of noise."""
    return 70 + 110 // _smallest_side(setting) ** 2


LEAVES = Pass(
    "leaves",
    find_leaves,
    halo=halo,
    bytes_per_pixel=bytes_per_pixel,
    writes={"labels": State("int32")},
    # measured on noise: the graph, its sampler, and what of the leaves stays until the tables are written
    gathers=(
        Gathered("leaves", "first", bytes_per_row=120, most=smallest_squares),
        # each takes a side of a smallest square
        Gathered("contacts", "edges", bytes_per_row=60, most=lambda setting: 2 * smallest_squares(setting)),
    ),
    fewer="use larger leaves (smallest_leaf, split_deviation)",
)
