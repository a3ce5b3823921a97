"""Publish a state array as a raster layer."""

from __future__ import annotations

from pathlib import Path

from tilepipe.export import cog_from_tiled
from tilepipe.georeference import Geometry
from tilepipe.grid import Window
from tilepipe.passes import StateArray

_BLOCK = 512


def write_cog(path: Path, array: StateArray, geometry: Geometry, *, nodata: float) -> None:
    """Write a state array as a cloud-optimised GeoTIFF with overviews.

    Parameters
    ----------
    path
        File to write; appears only when whole.
    array
        Whole raster; read one row of blocks at a time, so that memory does not grow with its height.
    geometry
        Grid of the raster.
    nodata
        Value that means nodata.
    """
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window as FileWindow

    rows, columns = array.grid.shape
    tiled = path.with_suffix(".tiled.tif")
    profile = {
        "driver": "GTiff",
        "width": columns,
        "height": rows,
        "count": 1,
        "dtype": array.dtype,
        "crs": geometry.crs,
        "transform": Affine(*geometry.transform),
        "nodata": nodata,
        "tiled": True,
        "blockxsize": _BLOCK,
        "blockysize": _BLOCK,
        "compress": "zstd",
        "zstd_level": 1,
        "bigtiff": "if_safer",
    }
    try:
        with rasterio.open(tiled, "w", **profile) as target:
            for top in range(0, rows, _BLOCK):
                part = Window(top, 0, min(rows, top + _BLOCK), columns)
                target.write(array.read(part), 1, window=FileWindow(0, top, columns, part.rows))
        cog_from_tiled(tiled, path)
    finally:
        tiled.unlink(missing_ok=True)
