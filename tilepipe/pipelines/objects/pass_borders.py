"""Second pass of `objects`: the arcs between the merged regions of a tile; and the two tables made of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.ledger import Ledger
from tilepipe.engine.relabel import read_relabelled
from tilepipe.engine.state import StateArray
from tilepipe.io.geometries import lines_from_ragged, region_polygons
from tilepipe.io.geoparquet import ParquetWriter
from tilepipe.io.georeference import Geometry
from tilepipe.pipelines.objects.building_table import write_buildings
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.reconcile_buildings import Buildings
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe.pipelines.objects.reconcile_regions import Merged
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid, Window
from tilepipe_kernels.polylines import arcs as arc_kernel
from tilepipe_kernels.polylines.join import Arcs, join_arcs
from tilepipe_kernels.polylines.polygons import PolygonRings, assemble_polygons
from tilepipe_kernels.polylines.regularise.regularise import regularise_arcs
from tilepipe_kernels.polylines.simplify import simplify_arcs
from tilepipe_kernels.regions.merging import pooled

OBJECT_COLUMNS: dict[str, str] = {
    "region_id": "int64",
    "area_m2": "float64",
    "perimeter_m": "float64",
    "compactness": "float64",
    "height_mean": "float64",
    "height_min": "float64",
    "height_max": "float64",
    "height_deviation": "float64",
    "posterior_mean": "float64",
    "posterior_deviation": "float64",
    "leaves": "int64",
    "height_above_ground": "float64",
    "building_probability": "float64",
}
"""Columns of ``objects.parquet``; heights in metres.  Without buildings the last two are null."""

BOUNDARY_COLUMNS: dict[str, str] = {
    "left_id": "int64",
    "right_id": "int64",
    "length_m": "float64",
    "height_step_m": "float64",
    "probability_one_object": "float64",
}
"""Columns of ``boundaries.parquet``; id 0 = nodata or outside the raster, where step and probability are null."""

_PIECES = ("offsets", "vertices", "left", "right", "cut")


@dataclass(frozen=True)
class RegionContext:
    """What the pass needs to know; picklable."""

    grid: TileGrid
    labels: StateArray
    lookup: Path
    offsets: tuple[int, ...]

    def read(self, window: Window) -> NDArray[np.uint32]:
        """Region ids of a window, 0 = nodata."""
        return read_relabelled(self.labels, self.lookup, self.offsets, window)


def trace_borders(context: RegionContext, tile: Tile) -> Facts:
    """Tile function (halo 1): facts are the pieces of arcs that the tile owns."""
    pieces = arc_kernel.trace_arcs(
        context.read(tile.padded), core=tile.core_in_padded.as_tuple(), origin=tile.padded.origin
    )
    return {name: getattr(pieces, name) for name in _PIECES}


def _pieces(ledger: Ledger) -> Iterator[arc_kernel.ArcPieces]:
    for facts in ledger.each():
        yield arc_kernel.ArcPieces(**{name: facts[name] for name in _PIECES})


def write_tables(
    folder: Path,
    ledger: Ledger,
    leaves: Leaves,
    merged: Merged,
    buildings: Buildings | None,
    geometry: Geometry,
    parameters: ObjectParameters,
    workers: int = 1,
) -> list[Path]:
    """Write ``objects.parquet``, ``boundaries.parquet`` and, where they are told, ``buildings.parquet``.

    Parameters
    ----------
    folder
        Where to write.
    ledger
        Of the pass `borders`.
    leaves, merged
        What the regions are made of.
    buildings
        What is known of the regions as buildings; None = nothing, and no table of them.
    geometry
        Grid of the raster.
    parameters
        Of the pipeline.
    workers
        Threads; they do not show in the tables.

    Returns
    -------
    list of Path
    """
    exact = join_arcs(_pieces(ledger))
    rings = assemble_polygons(exact)
    pixel = geometry.resolution
    simplification = parameters.simplification
    arcs = simplify_arcs(exact, simplification, pixel, pixel) if simplification > 0 else exact
    # the corners move of buildings, or of regions of that shape where nothing is known of buildings
    if parameters.regularisation > 0:
        wanted = None if buildings is None else np.concatenate([[False], buildings.building > 0])
        arcs = regularise_arcs(
            exact,
            parameters.regularisation,
            geometry.shape,
            simplification=simplification,
            pixel_height=pixel,
            pixel_width=pixel,
            regions=wanted,
        )
    tables: dict[str, Callable[..., Any]] = {
        "objects": partial(_write_objects, rings=rings, arcs=arcs, leaves=leaves, merged=merged, buildings=buildings),
        "boundaries": partial(_write_boundaries, arcs=arcs, merged=merged),
    }
    if buildings is not None:
        tables["buildings"] = partial(
            write_buildings,
            exact=exact,
            arcs=arcs,
            leaves=leaves,
            merged=merged,
            buildings=buildings,
            smallest_hole=parameters.minimum_building_area,
        )
    paths = [folder / f"{name}.parquet" for name in tables]
    with ThreadPoolExecutor(min(len(tables), workers)) as pool:
        list(pool.map(lambda write, path: write(path, geometry=geometry), tables.values(), paths))
    return paths


def _write_objects(
    path: Path,
    rings: PolygonRings,
    arcs: Arcs,
    leaves: Leaves,
    merged: Merged,
    buildings: Buildings | None,
    geometry: Geometry,
) -> None:
    import shapely

    ids, geometries = region_polygons(rings, arcs, geometry.transform)
    # nodata can part a region, so that all are written as multipolygons
    parts, owner = shapely.get_parts(geometries, return_index=True)
    polygons = shapely.multipolygons(parts, indices=owner)
    with ParquetWriter(path, OBJECT_COLUMNS, geometry.crs, "MultiPolygon") as table:
        columns = _object_columns(ids.astype(np.int64), polygons, leaves, merged, geometry)
        table.append(columns | _building_columns(ids, buildings), polygons)


def _write_boundaries(path: Path, arcs: Arcs, merged: Merged, geometry: Geometry) -> None:
    with ParquetWriter(path, BOUNDARY_COLUMNS, geometry.crs, "LineString") as table:
        table.append(
            _boundary_columns(arcs, merged, geometry.resolution),
            lines_from_ragged(geometry.coordinates(arcs.vertices), arcs.offsets),
        )


def _object_columns(
    ids: NDArray[np.int64], polygons: NDArray[Any], leaves: Leaves, merged: Merged, geometry: Geometry
) -> dict[str, NDArray[Any]]:
    """Attributes of the regions; areas and perimeters are those of the polygons as written."""
    import shapely

    region, at = merged.region, ids - 1
    regions = merged.mean.size
    own = pooled(leaves.statistics, region, regions)
    lowest, highest = np.full(regions, np.inf, np.float32), np.full(regions, -np.inf, np.float32)
    np.minimum.at(lowest, region, leaves.lowest)
    np.maximum.at(highest, region, leaves.highest)
    area = shapely.area(polygons) * geometry.metres**2
    perimeter = shapely.length(polygons) * geometry.metres
    return {
        "region_id": ids,
        "area_m2": area,
        "perimeter_m": perimeter,
        "compactness": 4 * np.pi * area / perimeter**2,
        "height_mean": own.mean[at],
        "height_min": lowest[at].astype(np.float64),
        "height_max": highest[at].astype(np.float64),
        "height_deviation": np.sqrt(own.spread / own.count)[at],
        "posterior_mean": merged.mean[at],
        "posterior_deviation": merged.deviation[at],
        "leaves": np.bincount(region, minlength=regions)[at],
    }


def _building_columns(ids: NDArray[Any], buildings: Buildings | None) -> dict[str, NDArray[Any]]:
    if buildings is None:
        return dict.fromkeys(("height_above_ground", "building_probability"), np.full(len(ids), np.nan))
    return {
        "height_above_ground": buildings.above[ids - 1],
        "building_probability": buildings.probability[ids - 1],
    }


def _boundary_columns(arcs: Arcs, merged: Merged, pixel: float) -> dict[str, NDArray[Any]]:
    left, right = arcs.left.astype(np.int64), arcs.right.astype(np.int64)
    inner = np.flatnonzero((left > 0) & (right > 0))
    ends = np.sort(np.stack([left[inner], right[inner]], axis=1) - 1, axis=1)
    keys = (merged.graph.edges[:, 0].astype(np.int64) << 32) | merged.graph.edges[:, 1]
    edge = np.searchsorted(keys, (ends[:, 0] << 32) | ends[:, 1])
    step, probability = np.full((2, left.size), np.nan)
    step[inner] = merged.mean[left[inner] - 1] - merged.mean[right[inner] - 1]
    probability[inner] = merged.probability[edge]
    return {
        "left_id": left,
        "right_id": right,
        "length_m": arcs.lengths(pixel, pixel),
        "height_step_m": step,
        "probability_one_object": probability,
    }
