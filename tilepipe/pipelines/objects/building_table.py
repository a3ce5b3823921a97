"""The table of buildings: regions dissolved along the borders they share with the objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe.io.vectors.geoparquet import ParquetWriter
from tilepipe.pipelines.objects.layers import BUILDINGS
from tilepipe.pipelines.objects.reconcile_buildings import Buildings
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe.pipelines.objects.reconcile_regions import Merged
from tilepipe_kernels.polylines.dissolve import dissolved
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons


def write_buildings(
    path: Path,
    exact: Arcs,
    arcs: Arcs,
    leaves: Leaves,
    merged: Merged,
    buildings: Buildings,
    geometry: Geometry,
    smallest_hole: float,
) -> Path:
    """Write ``buildings.parquet``, one multipolygon per building.

    Parameters
    ----------
    path
        File to write.
    exact, arcs
        Arcs of all regions, along the pixels and as the objects have them.
    leaves, merged, buildings
        What the buildings are made of.
    geometry
        Grid of the raster.
    smallest_hole
        Smaller holes are filled (m²): pixels without height, chimneys, shafts of light.
    """
    group = np.concatenate([np.zeros(1, np.uint32), buildings.building])
    rings = assemble_polygons(dissolved(exact, group))
    ids, found = region_polygons(rings, dissolved(arcs, group), geometry.transform)
    polygons = without_holes(found, smallest_hole / geometry.metres**2)
    with ParquetWriter(path, BUILDINGS.dtypes, geometry.crs, BUILDINGS.geometry) as table:
        table.append(_columns(ids.astype(np.int64), polygons, leaves, merged, buildings, geometry.metres), polygons)
    return path


def without_holes(polygons: NDArray[Any], least: float) -> NDArray[Any]:
    """Multipolygons of polygons and multipolygons, without their holes of less than an area."""
    import shapely

    parts, owner = shapely.get_parts(polygons, return_index=True)
    if not len(parts):
        return np.asarray(parts)
    rings, part = shapely.get_rings(parts, return_index=True)
    shell = np.diff(part, prepend=-1) > 0
    kept = shell | (shapely.area(shapely.polygons(rings)) >= least)
    filled = shapely.multipolygons(shapely.polygons(rings[kept], indices=part[kept]), indices=owner)
    # what stood in a hole by itself is then part of the whole
    nested = ~shapely.is_valid(filled)
    for number in np.flatnonzero(nested):
        whole = shapely.unary_union(shapely.get_parts(filled[number]))
        filled[number] = shapely.multipolygons(shapely.get_parts(whole))
    return np.asarray(filled)


def _columns(
    ids: NDArray[np.int64],
    polygons: NDArray[Any],
    leaves: Leaves,
    merged: Merged,
    buildings: Buildings,
    metres: float,
) -> dict[str, NDArray[Any]]:
    """Attributes of the buildings; areas and perimeters are those of the polygons as written."""
    import shapely

    members = np.flatnonzero(buildings.building)
    number = np.searchsorted(ids, buildings.building[members])
    pixels, height = (values[members] for values in (merged.graph.statistics.count, merged.graph.statistics.mean))
    total = np.bincount(number, pixels, ids.size)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(number, pixels * values, ids.size) / total

    above = buildings.above[members]
    highest, highest_above = np.full((2, ids.size), -np.inf)
    np.maximum.at(highest_above, number, buildings.highest_above[members])
    of_leaf = buildings.building[merged.region]
    np.maximum.at(highest, np.searchsorted(ids, of_leaf[of_leaf > 0]), leaves.highest[of_leaf > 0])
    return {
        "building_id": ids,
        "probability": mean(buildings.probability[members]),
        "area_m2": shapely.area(polygons) * metres**2,
        "perimeter_m": shapely.length(polygons) * metres,
        "height_above_ground": mean(above),
        "height_above_ground_max": highest_above,
        "ground_height": mean(height - above),
        "height_mean": mean(height),
        "height_max": highest,
        "regions": np.bincount(number, minlength=ids.size),
    }
