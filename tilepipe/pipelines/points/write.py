"""The raster of a gridding job as a GeoTIFF, written tile by tile and read back."""

from __future__ import annotations

import errno
import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray

from tilepipe.io.crs.systems import crs_text
from tilepipe.io.rasters.raster_crs import keep_crs
from tilepipe.pipelines.points.plan import GridPlan
from tilepipe.pipelines.points.survey import BLOCK_BITS

_GDAL_CACHE = 64 << 20


class TileWriter:
    """Writes the tiles of a raster, remembering what they were."""

    def __init__(self, plan: GridPlan, dataset: rasterio.DatasetBase) -> None:
        self.plan, self.dataset = plan, dataset
        self.checksums: dict[int, int] = {}

    def write(self, tile: int, values: NDArray[np.float32]) -> None:
        """Write a tile, of which the raster may not need all."""
        window = self.plan.window(tile)
        block = np.ascontiguousarray(values[: window.height, : window.width])
        self.checksums[tile] = zlib.crc32(block.data)
        self.dataset.write(block, 1, window=window)


@contextmanager
def tile_writer(plan: GridPlan, raster: Path, workers: int) -> Iterator[TileWriter]:
    """A raster open for its tiles, and checked when it is closed.

    Raises
    ------
    OSError
        If the raster read back differs from what was written.
    """
    job, (top, left) = plan.job, plan.extent.origin
    with (
        rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE),
        rasterio.open(
            raster,
            "w",
            driver="GTiff",
            dtype="float32",
            nodata=math.nan,
            count=1,
            height=plan.extent.shape[0],
            width=plan.extent.shape[1],
            crs=crs_text(job.crs),
            transform=Affine(job.cell, 0.0, left * job.cell, 0.0, -job.cell, -top * job.cell),
            tiled=True,
            blockxsize=1 << BLOCK_BITS,
            blockysize=1 << BLOCK_BITS,
            compress="deflate",
            predictor=3,
            zlevel=1,
            num_threads=workers,
            bigtiff="if_safer",
            sparse_ok=True,
        ) as dataset,
    ):
        dataset.set_band_description(1, f"{job.value} ({job.method})")
        if job.value == "height":
            dataset.units = (job.vertical_unit,)
        writer = TileWriter(plan, dataset)
        yield writer
    keep_crs(raster, job.crs)
    _verify(plan, raster, writer.checksums, workers)


def _verify(plan: GridPlan, raster: Path, checksums: dict[int, int], workers: int) -> None:
    """Read the raster back: GDAL tells nobody that a write failed while it closed a file."""
    with (
        rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE),
        rasterio.open(raster, num_threads=workers) as dataset,
    ):
        for tile, checksum in checksums.items():
            if zlib.crc32(dataset.read(1, window=plan.window(tile))) != checksum:
                raise OSError(errno.EIO, "the raster read back differs from what was written")
