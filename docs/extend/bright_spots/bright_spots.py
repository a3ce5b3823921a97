"""Bright spots of a raster as boxes: a whole pipeline for tilepipe, in a package of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import ndimage

from tilepipe.engine.layers import Column, RasterLayer, TableLayer
from tilepipe.engine.pipeline import Pass, Pipeline, State
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.relabel import read_relabelled
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.engine.work import Work
from tilepipe.io.rasters.raster import Raster
from tilepipe.io.vectors.geoparquet import ParquetWriter
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, Window
from tilepipe.tiling.numbering import Numbering
from tilepipe.tiling.seams import border_facts, seam_sides
from tilepipe_kernels.core.components import connected_components


class SpotParameters(BaseModel):
    """What is bright, and how large a spot is at least."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    threshold: float = Field(200.0, description="values from here on are bright")
    minimum_area: float = Field(4.0, ge=0, description="smallest spot (m²)")


# --- the pass: everything that one tile can know


@dataclass(frozen=True)
class SpotContext:
    """What the pass needs to know; picklable, so that it can run anywhere."""

    raster: Raster
    parameters: SpotParameters
    labels: StateArray


def mark_spots(context: SpotContext, tile: Tile) -> Facts:
    """Number the spots of a tile; facts are their pixels, boxes and first pixels, and the labels along the seams."""
    values = context.raster.read(tile.core)
    labels, count = ndimage.label(values >= context.parameters.threshold)
    numbers = np.arange(1, count + 1)
    found = ndimage.find_objects(labels)
    boxes = np.array([[part.start for part in box] + [part.stop for part in box] for box in found]).reshape(-1, 4)
    row, column = np.indices(labels.shape) + np.reshape(tile.core.origin, (2, 1, 1))
    site = row * context.raster.shape[1] + column
    facts: Facts = {
        "pixels": np.bincount(labels.reshape(-1), minlength=count + 1)[1:],
        "boxes": boxes.astype(np.int64) + np.tile(tile.core.origin, 2),
        "first": ndimage.minimum(site, labels, numbers).astype(np.int64) if count else np.empty(0, np.int64),
    }
    return facts | write_state({"labels": context.labels}, tile, {"labels": labels}) | border_facts("label", labels)


MARK = Pass(
    "mark",
    mark_spots,
    halo=0,
    bytes_per_pixel=24,
    writes={"labels": State("int32")},
    on_device=False,
)


# --- the reconciliation: what the seams have cut


class Spots(NamedTuple):
    """Spots of the raster by their first pixels, and the id of every local number, 0 = too small."""

    pixels: NDArray[np.int64]
    boxes: NDArray[np.int64]
    ids: NDArray[np.uint32]
    offsets: tuple[int, ...]


def join_spots(run: Work, ledger: Ledger) -> Spots:
    """Join the spots of all tiles; everything is a sum, a minimum or a maximum of integers, so no tiling shows."""
    facts = ledger.all_facts()
    numbering = Numbering.of_counts(np.array([found["pixels"].size for found in facts]))
    pairs = [np.empty((0, 2), np.int64)]
    for seam, first, second in seam_sides(run.grid, facts, "label"):
        both = (first > 0) & (second > 0)
        ends = numbering.globalise(seam.first, first[both]), numbering.globalise(seam.second, second[both])
        pairs.append(np.stack(ends, axis=1))
    spot = connected_components(numbering.total, np.concatenate(pairs))
    count = int(spot.max(initial=-1)) + 1
    pixels = np.zeros(count, np.int64)
    np.add.at(pixels, spot, np.concatenate([found["pixels"] for found in facts]))
    boxes = np.tile([np.iinfo(np.int64).max, np.iinfo(np.int64).max, 0, 0], (count, 1))
    parts = np.concatenate([found["boxes"] for found in facts])
    np.minimum.at(boxes[:, :2], spot, parts[:, :2])
    np.maximum.at(boxes[:, 2:], spot, parts[:, 2:])
    first = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(first, spot, np.concatenate([found["first"] for found in facts]))
    # ids come from the content, the first pixel, and not from the tile that has seen a spot first
    order = np.argsort(first)
    kept = order[pixels[order] * run.resolution**2 >= run.parameters.minimum_area]
    ids = np.zeros(count, np.uint32)
    ids[kept] = np.arange(1, kept.size + 1)
    return Spots(pixels[kept], boxes[kept], ids[spot], tuple(numbering.offsets.tolist()))


# --- the layers, and the recipe that strings all together

RASTER = RasterLayer("spots.tif", "uint32", 0, "number of the spot")
TABLE = TableLayer(
    "spots",
    "Polygon",
    {"spot_id": Column("int64", "number of the spot in `spots.tif`"), "area_m2": Column("float64", "area", "m²")},
    "box around a bright spot",
    scored=True,
)


def write_boxes(run: Work, spots: Spots) -> Path:
    """Write the table into the state folder."""
    corners = run.geometry.coordinates(spots.boxes.reshape(-1, 2)).reshape(-1, 4)
    boxes = shapely.box(corners[:, 0], corners[:, 3], corners[:, 2], corners[:, 1])
    path = run.folder / "spots.parquet"
    with ParquetWriter(path, TABLE.dtypes, run.geometry.crs, TABLE.geometry) as table:
        columns = {"spot_id": np.arange(1, len(boxes) + 1), "area_m2": spots.pixels * run.resolution**2}
        table.append(columns, boxes)
    return path


def recipe(run: Work) -> list[Path]:
    """Mark, join, write."""
    labels = run.state("labels")
    spots = join_spots(run, run.over_tiles(MARK, SpotContext(run.raster, run.parameters, labels)))
    lookup = run.folder / "ids.npy"
    np.save(lookup, spots.ids)

    def read(window: Window) -> NDArray[np.uint32]:
        return read_relabelled(labels, lookup, spots.offsets, window)

    return [run.write_raster("spots.tif", read), *run.in_format([write_boxes(run, spots)])]


PIPELINE = Pipeline(
    name="spots",
    summary="Bright spots of a raster as boxes.",
    parameters=SpotParameters,
    passes=(MARK,),
    recipe=recipe,
    layers=(RASTER, TABLE),
    operators="spot_operators:SpotOperators",
)
