"""The pass of `objects` that traces the arcs between the merged regions of a tile."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.gathering import most_cracks
from tilepipe.engine.pipeline import Gathered, Pass
from tilepipe.engine.tiles.relabel import read_relabelled
from tilepipe.engine.tiles.state import StateArray
from tilepipe.engine.work import Work
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe.pipelines.objects.reconcile_regions import LOOKUP
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid, Window
from tilepipe_kernels.polylines.arcs import trace_arcs

ARC_COLUMNS = ("offsets", "vertices", "left", "right", "cut")
"""Facts of the pass: the columns of `ArcFragments`."""


@dataclass(frozen=True)
class RegionContext:
    """What the pass needs to know; picklable."""

    grid: TileGrid
    labels: StateArray
    lookup: Path
    offsets: tuple[int, ...]

    @classmethod
    def of(cls, run: Work, leaves: Leaves) -> RegionContext:
        """Of a run whose leaves have merged."""
        return cls(run.grid, run.state("labels"), run.folder / LOOKUP, tuple(leaves.numbering.offsets.tolist()))

    def read(self, window: Window) -> NDArray[np.uint32]:
        """Region ids of a window, 0 = nodata."""
        return read_relabelled(self.labels, self.lookup, self.offsets, window)


def trace_borders(context: RegionContext, tile: Tile) -> Facts:
    """Tile function (halo 1): facts are the fragments of arcs that the tile owns."""
    fragments = trace_arcs(context.read(tile.padded), core=tile.core_in_padded.as_tuple(), origin=tile.padded.origin)
    return {name: getattr(fragments, name) for name in ARC_COLUMNS}


# it traces on the host, from labels that lie on disk
BORDERS = Pass(
    "borders",
    trace_borders,
    halo=1,
    # of regions of single pixels
    bytes_per_pixel=110,
    # measured on noise: joined, simplified, assembled and written as polygons
    gathers=(
        Gathered("borders", "left", bytes_per_row=96, most=most_cracks),
        Gathered("corners of borders", "vertices", bytes_per_row=48, most=lambda setting: 2 * most_cracks(setting)),
    ),
    fewer="join more of the regions (minimum_area, merge_height)",
    on_device=False,
)
