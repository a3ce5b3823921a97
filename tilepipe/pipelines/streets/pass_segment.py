"""First pass of `streets`: smooth a tile, grow its dark regions, and say what the seams need to know."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Gathered, Pass, Setting, State
from tilepipe.engine.request import AlignedRaster
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.engine.work import Work
from tilepipe.io.rasters.raster import Raster
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.pipelines.streets.pass_levels import GreyScale
from tilepipe.pipelines.streets.reconcile_regions import SUMMED
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe.tiling.seams import border_facts, raster_borders, touches_seam
from tilepipe_kernels.core.arrays import Backend, namespace, to_backend
from tilepipe_kernels.image import diffusion, grey_levels, morphology
from tilepipe_kernels.image.fill import fill_voids
from tilepipe_kernels.regions import growing, region_table

_EDGE_PER_NOISE, _LEAST_EDGE = 0.6, 4.0
"""An edge is steeper than this share of the noise (found on five scenes), and than so many grey levels per pixel."""


@dataclass(frozen=True)
class SegmentContext:
    """What the pass needs to know; picklable."""

    raster: Raster
    heights: AlignedRaster | None
    scale: GreyScale
    parameters: StreetParameters
    grid: TileGrid
    labels: StateArray
    grey: StateArray
    backend: Backend = "numpy"

    @classmethod
    def of(cls, run: Work, scale: GreyScale) -> SegmentContext:
        """Of a run whose grey scale is known."""
        return cls(
            run.raster,
            run.input("heights"),
            scale,
            run.parameters,
            run.grid,
            run.state("labels"),
            run.state("grey"),
            run.backend,
        )

    @property
    def rectangle(self) -> tuple[int, int]:
        """Rows and columns of a rectangle."""
        return self.parameters.rectangle_rows, self.parameters.rectangle_columns


def reach_in_pixels(parameters: StreetParameters, resolution: float) -> int:
    """Reach over which voids are bridged, in pixels."""
    return math.floor(parameters.void_reach / resolution)


def halo(setting: Setting) -> int:
    """Pixels that the pass reads around a core."""
    parameters, resolution = setting.parameters, setting.resolution
    steps = diffusion.halo(
        parameters.diffusion_steps, parameters.gradient_sigma / resolution, parameters.diffusion_model
    )
    return max(
        steps + reach_in_pixels(parameters, resolution),
        ground_reach(parameters, resolution) if "heights" in setting.inputs else 0,
    )


def ground_reach(parameters: StreetParameters, resolution: float) -> int:
    """Pixels around a core that decide the ground height in it."""
    return 2 * math.ceil(parameters.ground_window / resolution / 2)


def segment(context: SegmentContext, tile: Tile) -> Facts:
    """Tile function: diffuse, grow regions, keep both; facts are the region table and edges."""
    values = to_backend(context.raster.read(tile.padded), context.backend)
    missing = namespace(values).isnan(values[tile.core_in_padded.slices])
    grey = context.scale.apply(values)
    smooth = _smooth(context, tile, grey)
    if context.heights is not None:
        smooth[_is_raised(context, tile)] = np.nan
    rows, columns = context.rectangle
    centres = growing.rectangle_centers(smooth, rows, columns)
    labels = growing.grow_regions(centres, context.parameters.tolerance, maximum=context.scale.threshold)
    kept, table = _kept_regions(context, tile, labels, centres)
    labels = region_table.select_labels(labels, kept)
    packed = grey_levels.store(smooth, missing)
    facts = write_state({"labels": context.labels, "grey": context.grey}, tile, {"labels": labels, "grey": packed})
    return facts | table | border_facts("label", labels) | border_facts("grey", centres)


def most_regions(setting: Setting) -> int:
    """Regions that are large enough, and those that reach a seam, at most."""
    p: StreetParameters = setting.parameters
    rows, columns = -(-setting.shape[0] // p.rectangle_rows), -(-setting.shape[1] // p.rectangle_columns)
    seams = 2 * (rows * -(-setting.shape[1] // setting.tile) + columns * -(-setting.shape[0] // setting.tile))
    return min(rows * columns, rows * columns // minimum_rectangles(p, setting.resolution) + seams)


SEGMENT = Pass(
    "segment",
    segment,
    halo=halo,
    bytes_per_pixel=60,
    writes={"labels": State("uint32", per_cell=True), "grey": State("uint16", grey_levels.NO_GREY)},
    gathers=(Gathered("regions", "first", bytes_per_row=250, most=most_regions),),
    fewer="drop more of the regions (minimum_size)",
)


def _smooth(context: SegmentContext, tile: Tile, grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Grey levels of the core after bridging small voids and diffusion."""
    p = context.parameters
    resolution = context.raster.geometry.resolution
    conductance = edge_gradient(context)
    if p.diffusion_model == "curvature":
        conductance = p.conductance / conductance**2
    return diffusion.diffuse(
        fill_voids(grey, reach_in_pixels(p, resolution)),
        steps=p.diffusion_steps,
        time_step=p.time_step,
        conductance=conductance,
        gradient_sigma=p.gradient_sigma / resolution,
        fidelity=p.fidelity,
        model=p.diffusion_model,
        core=tile.core_in_padded.as_tuple(),
    )


def edge_gradient(context: SegmentContext) -> float:
    """Gradient that makes an edge, in grey levels per pixel: as given, or in proportion to the raster's noise."""
    given = context.parameters.edge_gradient
    return given if given is not None else max(_LEAST_EDGE, _EDGE_PER_NOISE * context.scale.noise)


def _is_raised(context: SegmentContext, tile: Tile) -> NDArray[np.bool_]:
    """Where the height raster says that the core's pixels lie above the ground (trees, roofs)."""
    assert context.heights is not None
    p = context.parameters
    resolution = context.raster.geometry.resolution
    around = tile.core.padded(ground_reach(p, resolution), context.grid.shape)
    heights = context.heights.read(around)
    heights *= np.float32(context.heights.raster.geometry.height_metres)
    heights = to_backend(heights, context.backend)
    ground = morphology.open_grey(heights, math.ceil(p.ground_window / resolution / 2))
    inner = tile.core.relative_to(around).slices
    raised: NDArray[np.bool_] = heights[inner] - ground[inner] > np.float32(p.maximum_height)
    return raised


def _kept_regions(
    context: SegmentContext, tile: Tile, labels: NDArray[np.int32], centres: NDArray[np.float32]
) -> tuple[NDArray[np.uint32], Facts]:
    """Drop regions that are too small and touch no seam; the new number of each label and the table of the kept."""
    grid = context.labels.grid
    borders = raster_borders(grid, tile.number)
    xp = namespace(labels)
    count = int(labels.max()) if labels.size else 0
    table = region_table.region_table(labels, centres, count, borders=borders)
    keep = table.count >= minimum_rectangles(context.parameters, context.raster.geometry.resolution)
    reaches_seam = touches_seam(labels, count, borders)
    keep |= reaches_seam[1:]
    numbers = xp.concatenate([xp.zeros(1, xp.int64), xp.where(keep, xp.cumsum(keep), 0)])
    row, column = xp.divmod(table.first, labels.shape[1])
    top, left = grid.tile(tile.number).core.origin
    facts: Facts = {name: getattr(table, name)[keep] for name in SUMMED}
    facts["first"] = ((row + top) * grid.shape[1] + column + left)[keep]
    facts["contacts"] = region_table.region_contacts(labels, reaches_seam)
    facts["contacts"][:, :2] = numbers[facts["contacts"][:, :2]]
    return numbers.astype(np.uint32), facts


def minimum_rectangles(parameters: StreetParameters, resolution: float) -> int:
    """Smallest number of rectangles of a region."""
    rectangle = parameters.rectangle_rows * parameters.rectangle_columns * resolution**2
    return max(1, math.ceil(parameters.minimum_size / rectangle - 1e-9))
