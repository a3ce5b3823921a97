"""Publish a raster that is computed window by window as a raster layer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from tilepipe.io.formats import cog_from_tiled
from tilepipe.io.georeference import Geometry
from tilepipe.tiling.grid import TileGrid, Window

_BLOCK = 512
_STRIP = (_BLOCK, 8 * _BLOCK)
"""Windows that are asked for: whole blocks, so that each is written once, and few, so that memory is small."""


def write_cog(
    path: Path,
    read: Callable[[Window], NDArray[Any]],
    dtype: str,
    geometry: Geometry,
    *,
    nodata: float,
    threads: int | None = None,
) -> None:
    """Write a cloud-optimised GeoTIFF with overviews.

    Parameters
    ----------
    path
        File to write; appears only when whole.
    read
        Gives the values of any window; asked for one small window after the other.
    dtype
        Type of the values.
    geometry
        Grid of the raster.
    nodata
        Value that means nodata.
    threads
        Threads that compress; by default all cores.
    """
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window as FileWindow

    rows, columns = geometry.shape
    tiled = path.with_suffix(".tiled.tif")
    profile = {
        "driver": "GTiff",
        "width": columns,
        "height": rows,
        "count": 1,
        "dtype": dtype,
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
            for tile in TileGrid(geometry.shape, _STRIP).tiles():
                part = tile.core
                target.write(read(part), 1, window=FileWindow(part.left, part.top, part.columns, part.rows))
        cog_from_tiled(tiled, path, threads=threads)
    finally:
        tiled.unlink(missing_ok=True)
