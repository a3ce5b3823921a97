"""Publish a raster that is computed window by window as a raster layer."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import crs_of_dataset
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.rasters.raster_crs import keep_crs
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
        File to write; appears only when whole, with a file beside it where a GeoTIFF cannot hold the CRS.
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

    Examples
    --------
    A raster of heights that is computed window by window: each row is one metre higher than the one above.

    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.io.rasters.cog import write_cog
    >>> from tilepipe.io.rasters.georeference import Geometry
    >>> from tilepipe.io.rasters.raster import open_raster
    >>> geometry = Geometry("EPSG:32633", 392000, 5820000, pixel=0.5, shape=(600, 600), metres=1, height_metres=1)
    >>> def heights(window):
    ...     return np.broadcast_to(np.arange(window.top, window.bottom, dtype=np.float32)[:, None], window.shape)
    >>> write_cog(Path("heights.tif"), heights, "float32", geometry, nodata=float("nan"))
    >>> open_raster(["heights.tif"]).geometry.resolution
    0.5
    """
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window as FileWindow

    rows, columns = geometry.shape
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
    with atomic_write(path) as aside:
        tiled = aside.with_name(f"{aside.name}.tiled")
        with rasterio.open(tiled, "w", **profile) as target:
            for tile in TileGrid(geometry.shape, _STRIP).tiles():
                part = tile.core
                target.write(read(part), 1, window=FileWindow(part.left, part.top, part.columns, part.rows))
        keep_crs(tiled, geometry.crs)
        _copy(tiled, aside, "nearest", "ZSTD", threads)


def cog_from_tiled(
    source: str | os.PathLike[str],
    destination: str | os.PathLike[str],
    *,
    overview: str = "nearest",
    compression: str = "ZSTD",
    threads: int | None = None,
) -> Path:
    """Write a cloud-optimised GeoTIFF from any raster GDAL reads; the bytes are the same for any `threads`.

    Blocks of 512 x 512, overviews down to one block, BigTIFF where needed, blocks of nodata left out.

    Parameters
    ----------
    source
        The raster to copy; a tiled one is read fastest. Its bands, dtype, CRS and nodata are kept.
    destination
        The file to write.
    overview
        Resampling of the overviews: ``"nearest"`` for labels, ``"average"`` for measurements.
    compression
        ``"ZSTD"``, or ``"DEFLATE"`` for readers without Zstandard.
    threads
        Threads that compress; by default all cores.

    Raises
    ------
    InputError
        The destination cannot be written or the disk is full.

    Examples
    --------
    >>> import rasterio
    >>> from tilepipe.io.rasters.cog import cog_from_tiled
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=512, columns=512), layers=["streets"], truth=False)
    >>> with rasterio.open(cog_from_tiled(written["streets"], "cog.tif")) as cog:
    ...     cog.shape, cog.block_shapes, cog.crs.to_epsg()
    ((512, 512), [(512, 512)], 32633)
    """
    destination = Path(destination)
    if destination.exists() and destination.samefile(source):
        raise InputError(f"cannot write {destination}: it is the raster to be copied; choose another name")
    with atomic_write(destination) as aside:
        _copy(source, aside, overview, compression, threads)
    return destination


def _copy(source: str | os.PathLike[str], aside: Path, overview: str, compression: str, threads: int | None) -> None:
    """Write the file ``aside`` as `cog_from_tiled` says."""
    import rasterio
    import rasterio.shutil

    with rasterio.open(source) as raster:
        is_float = raster.dtypes[0].startswith("float")
        crs = crs_of_dataset(raster)
    with rasterio.Env():
        rasterio.shutil.copy(
            str(source),
            str(aside),
            driver="COG",
            COMPRESS=compression,
            LEVEL=3,
            # Differences of neighbouring labels compress worse than the labels (measured: 38 % larger files).
            PREDICTOR="YES" if is_float else "NO",
            BLOCKSIZE=512,
            OVERVIEW_RESAMPLING=overview.upper(),
            BIGTIFF="IF_SAFER",
            SPARSE_OK="TRUE",
            NUM_THREADS=threads or "ALL_CPUS",
        )
        _check_copy(source, aside)
        if crs is not None:
            keep_crs(aside, crs)


def _check_copy(source: str | os.PathLike[str], copy: Path) -> None:
    """Read a raster back and compare: the COG driver reports no error when the disk fills up."""
    import rasterio
    from rasterio.errors import RasterioIOError
    from rasterio.windows import Window

    whole = True
    try:
        with rasterio.open(source) as old, rasterio.open(copy, NUM_THREADS="ALL_CPUS") as new:
            for row in range(0, old.height, 512):
                window = Window(0, row, old.width, min(512, old.height - row))
                whole &= old.read(window=window).tobytes() == new.read(window=window).tobytes()
            levels = len(new.overviews(1))
        for level in range(levels):
            with rasterio.open(copy, overview_level=level, NUM_THREADS="ALL_CPUS") as new:
                for _, window in new.block_windows(1):
                    new.read(window=window)
    except RasterioIOError:
        whole = False
    if not whole:
        raise OSError(errno.ENOSPC, "the copy is incomplete", str(copy))
