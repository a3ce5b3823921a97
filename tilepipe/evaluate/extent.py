"""Where a run has had data, so that a truth that reaches farther is not held against its result."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tilepipe.evaluate.results import extent_raster
from tilepipe.io.crs.systems import crs_of_dataset
from tilepipe.io.files.record import RECORD
from tilepipe.io.rasters.file_bands import read_bands
from tilepipe.io.vectors.tables import POLYGONS, VectorLayer, in_metres, read_layer

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

_MOST_CELLS = 2048
"""Cells on the longer side to which a larger raster is reduced before it is outlined."""


def scored_area(
    result: str | os.PathLike[str] | VectorLayer,
    area: str | os.PathLike[str] | VectorLayer | None,
    layer: str | None = None,
) -> VectorLayer | None:
    """Layer of the polygons to score in: those given, else the extent of the data of the result's run, if any.

    Parameters
    ----------
    result
        As given to `tilepipe.evaluate.lines`; a layer already read has no run.
    area
        A vector file of polygons, or a layer already read.
    layer
        Name of the layer of a file of several.
    """
    if area is not None:
        return read_layer(area, "area", layer)
    return None if isinstance(result, VectorLayer) else data_extent(Path(result))


def area_in_metres(area: VectorLayer, crs: Any, metres: float) -> BaseGeometry:
    """Union of a layer's polygons in metres, reprojected to ``crs``, whose unit has so many metres.

    Raises
    ------
    InputError
        The layer holds other geometries.

    Examples
    --------
    >>> import geopandas
    >>> import shapely
    >>> from tilepipe.evaluate.extent import area_in_metres
    >>> from tilepipe.io.vectors.tables import VectorLayer
    >>> table = geopandas.GeoDataFrame(geometry=[shapely.box(0, 0, 100, 50)], crs="EPSG:2222")
    >>> round(area_in_metres(VectorLayer("district", table), "EPSG:2222", 0.3048).area, 2)  # of 5000 square feet
    464.52
    """
    import shapely

    polygons = area.of(POLYGONS).reprojected(crs)
    union: BaseGeometry = shapely.union_all(in_metres(shapely.make_valid(polygons), metres))
    return union


def data_extent(result: Path) -> VectorLayer | None:
    """Outlines of the pixels with data in the raster of a run; None where there is no finished run.

    Holes are filled: what lies in a void of the data counts.  A raster of more than 2048 pixels on a side is reduced
    to so many, so that the outlines of its data are off by up to one of these cells; those along its own sides are
    exact.

    Parameters
    ----------
    result
        Folder of a run, or a table in it.
    """
    import geopandas
    import rasterio
    import shapely
    from rasterio.features import shapes

    folder = result if result.is_dir() else result.parent
    raster = extent_raster(folder) if (folder / RECORD).is_file() else None
    if raster is None:
        return None
    with rasterio.open(raster) as source:
        share = max(1.0, max(source.shape) / _MOST_CELLS)
        rows, columns = (max(1, round(size / share)) for size in source.shape)
        known = np.isfinite(next(read_bands(source, [1], out_shape=(rows, columns)))).astype(np.uint8)
        transform = source.transform * source.transform.scale(source.width / columns, source.height / rows)
        crs = crs_of_dataset(source)
    outlines = [shapely.Polygon(shape["coordinates"][0]) for shape, _ in shapes(known, known > 0, transform=transform)]
    extent = shapely.union_all(outlines)
    return VectorLayer(f"extent of the data of {raster}", geopandas.GeoDataFrame(geometry=[extent], crs=crs))
