"""The tables of `objects`: polygons of the regions, the borders between them, and the buildings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe.io.vectors.geoparquet import ROW_GROUP, ParquetLineWriter, ParquetWriter
from tilepipe.pipelines.objects.building_table import write_buildings
from tilepipe.pipelines.objects.layers import BOUNDARIES, OBJECTS
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.pass_borders import ARC_COLUMNS
from tilepipe.pipelines.objects.reconcile_buildings import Buildings
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe.pipelines.objects.reconcile_regions import Merged
from tilepipe_kernels.polylines.arcs import ArcFragments
from tilepipe_kernels.polylines.join import Arcs, join_arcs
from tilepipe_kernels.polylines.polygons import PolygonRings, assemble_polygons
from tilepipe_kernels.polylines.regularise.regularise import regularise_arcs
from tilepipe_kernels.polylines.simplify import simplify_polylines
from tilepipe_kernels.regions.contraction import pooled

_POLYGONS_AT_ONCE = 4096
"""Regions whose polygons are objects at one time: 2 kB each, of which the table keeps the bytes alone."""


def _fragments(ledger: Ledger) -> Iterator[ArcFragments]:
    for facts in ledger.each():
        yield ArcFragments(**{name: facts[name] for name in ARC_COLUMNS})


def write_tables(run: Work, borders: Ledger, leaves: Leaves, merged: Merged, buildings: Buildings | None) -> list[Path]:
    """Write the objects, their boundaries and, where they are told, the buildings into the state folder.

    Parameters
    ----------
    run
        The run.
    borders
        Ledger of the pass that has traced the arcs.
    leaves, merged
        What the regions are made of.
    buildings
        What is known of the regions as buildings; None = nothing, and no table of them.

    Returns
    -------
    list of Path
    """
    with run.timed("polygons"):
        paths = _write_parquet(run, borders, leaves, merged, buildings)
    return run.in_format(paths)


def _write_parquet(
    run: Work, borders: Ledger, leaves: Leaves, merged: Merged, buildings: Buildings | None
) -> list[Path]:
    """The tables as GeoParquet, side by side; the number of threads does not show in them."""
    geometry: Geometry = run.geometry
    parameters: ObjectParameters = run.parameters
    exact = join_arcs(_fragments(borders))
    rings = assemble_polygons(exact)
    pixel = geometry.resolution
    simplification = parameters.simplification
    arcs = simplify_polylines(exact, simplification, pixel, pixel) if simplification > 0 else exact
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
    paths = [run.folder / f"{name}.parquet" for name in tables]
    with ThreadPoolExecutor(min(len(tables), run.options.resolved_workers)) as pool:
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

    of_regions = _region_columns(leaves, merged) | _building_columns(merged.mean.size, buildings)
    with ParquetWriter(path, OBJECTS.dtypes, geometry.crs, OBJECTS.geometry) as table:
        # as objects geometries are many times larger than as arcs, so that there are only a few of them
        for part in rings.parts(_POLYGONS_AT_ONCE):
            ids, geometries = region_polygons(part, arcs, geometry.transform)
            # nodata can part a region, so that all are written as multipolygons
            parts, owner = shapely.get_parts(geometries, return_index=True)
            polygons = shapely.multipolygons(parts, indices=owner)
            columns = {name: values[ids - 1] for name, values in of_regions.items()}
            table.append(_polygon_columns(ids.astype(np.int64), polygons, geometry.metres) | columns, polygons)


def _write_boundaries(path: Path, arcs: Arcs, merged: Merged, geometry: Geometry) -> None:
    keys = (merged.graph.edges[:, 0].astype(np.int64) << 32) | merged.graph.edges[:, 1]
    with ParquetLineWriter(path, BOUNDARIES.dtypes, geometry.crs) as table:
        for part in arcs.parts(ROW_GROUP):
            table.append(
                _boundary_columns(part, keys, merged, geometry.resolution),
                replace(part, vertices=geometry.coordinates(part.vertices)),
            )


def _polygon_columns(ids: NDArray[np.int64], polygons: NDArray[Any], metres: float) -> dict[str, NDArray[Any]]:
    """Attributes of the regions' shapes; areas and perimeters are those of the polygons as written."""
    import shapely

    area = shapely.area(polygons) * metres**2
    perimeter = shapely.length(polygons) * metres
    return {
        "region_id": ids,
        "area_m2": area,
        "perimeter_m": perimeter,
        "compactness": 4 * np.pi * area / perimeter**2,
    }


def _region_columns(leaves: Leaves, merged: Merged) -> dict[str, NDArray[Any]]:
    """Attributes of all regions, in the order of their ids."""
    region, regions = merged.region, merged.mean.size
    own = pooled(leaves.statistics, region, regions)
    lowest, highest = np.full(regions, np.inf, np.float32), np.full(regions, -np.inf, np.float32)
    np.minimum.at(lowest, region, leaves.lowest)
    np.maximum.at(highest, region, leaves.highest)
    return {
        "height_mean": own.mean,
        "height_min": lowest.astype(np.float64),
        "height_max": highest.astype(np.float64),
        "height_deviation": np.sqrt(own.spread / own.count),
        "posterior_mean": merged.mean,
        "posterior_deviation": merged.deviation,
        "leaves": np.bincount(region, minlength=regions),
    }


def _building_columns(regions: int, buildings: Buildings | None) -> dict[str, NDArray[Any]]:
    if buildings is None:
        return dict.fromkeys(("height_above_ground", "building_probability"), np.full(regions, np.nan))
    return {"height_above_ground": buildings.above, "building_probability": buildings.probability}


def _boundary_columns(arcs: Arcs, keys: NDArray[np.int64], merged: Merged, pixel: float) -> dict[str, NDArray[Any]]:
    left, right = arcs.left.astype(np.int64), arcs.right.astype(np.int64)
    inner = np.flatnonzero((left > 0) & (right > 0))
    ends = np.sort(np.stack([left[inner], right[inner]], axis=1) - 1, axis=1)
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
