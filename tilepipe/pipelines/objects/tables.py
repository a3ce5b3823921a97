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
from tilepipe.io.geometries import line_strings, region_polygons
from tilepipe.io.geoparquet import ParquetWriter
from tilepipe.io.georeference import Geometry
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
    with ThreadPoolExecutor(min(len(tables), run.options.workers)) as pool:
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
    with ParquetWriter(path, OBJECTS.dtypes, geometry.crs, OBJECTS.geometry) as table:
        columns = _object_columns(ids.astype(np.int64), polygons, leaves, merged, geometry)
        table.append(columns | _building_columns(ids, buildings), polygons)


def _write_boundaries(path: Path, arcs: Arcs, merged: Merged, geometry: Geometry) -> None:
    with ParquetWriter(path, BOUNDARIES.dtypes, geometry.crs, BOUNDARIES.geometry) as table:
        table.append(
            _boundary_columns(arcs, merged, geometry.resolution),
            line_strings(replace(arcs, vertices=geometry.coordinates(arcs.vertices))),
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
