"""The sources behind a raster: what they offer, and files read by rasterio."""

from __future__ import annotations

import os
import shlex
import threading
import warnings
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import crs_of_dataset
from tilepipe.io.files.gdal_options import input_options
from tilepipe.io.files.identity import Files, digest_of, file_state, files_of
from tilepipe.io.files.paths import (
    SIDE,
    absolute_name,
    file_of,
    gdal_name,
    is_local,
    is_of_driver,
    is_remote,
    location,
    one_line,
)
from tilepipe.io.rasters.bands import Choice
from tilepipe.io.rasters.file_bands import bands_of, read_bands
from tilepipe.io.rasters.georeference import Geometry, check_geometry
from tilepipe.io.rasters.sources.arrays import ARRAY, array_source
from tilepipe.io.rasters.sources.tiff_blocks import end_of_pixels
from tilepipe.io.rasters.sources.vrt import Behind, files_behind, vrt_text
from tilepipe.io.rasters.sources.zarr_source import zarr_source
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr

_OPEN_FILES = 32
"""Datasets that one thread keeps open."""

_PACKED = (".gz", ".tar", ".tgz", ".7z", ".rar", ".bz2", ".xz", ".zst")

_local = threading.local()


class Source(Protocol):
    """One raster file or array: its geometry, a name for messages, a stamp that changes with its content, a reader."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    @property
    def geometry(self) -> Geometry:
        """Where the pixels lie."""
        ...

    @property
    def content(self) -> str:
        """Digest of what it holds, as far as that can be known without reading all, whenever it was written."""
        ...

    @property
    def stamp(self) -> str:
        """Digest of all that is known of it: changes when it is written to."""
        ...

    @property
    def lines(self) -> list[str]:
        """Size, time, digest and name of each file behind it, for the record of an unfinished run."""
        ...

    @property
    def is_known(self) -> bool:
        """Whether an equal stamp proves that it is the same; else only reading it again does."""
        ...

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files and folders of this machine that are read."""
        ...

    @property
    def elsewhere(self) -> tuple[str, ...]:
        """What is read on the network, and files that a VRT takes for raw pixels, whatever they are."""
        ...

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """Values of a window, band after band; NaN where the pixel that they make up is void, in all bands alike."""
        ...

    def check(self, window: Window | None = None) -> None:
        """Raise `tilepipe.io.files.identity.ChangedInputError` when what is behind a window, or all, has changed."""
        ...


def open_source(item: str | Path | xr.DataArray, *, crs: str | None, choice: Choice) -> Source:
    """Open one input of a mosaic; see `open_raster`."""
    if not isinstance(item, (str, Path)):
        return array_source(item, ARRAY, crs=crs, choice=choice)
    if is_of_driver(item):
        raise InputError(f"{item}: names a part of a file; write it out first: {_write_out(str(item))}")
    name = location(item)
    path = Path(name)
    if is_local(name) and not path.exists():
        array = "; a run from an array in memory cannot be repeated from its record" if item == ARRAY else ""
        raise InputError(f"{path}: no such file; check the path{array}")
    if path.suffix.lower() in (".las", ".laz"):
        raise InputError(f"{name}: is a point cloud; make a raster of it with tilepipe grid first")
    if path.is_dir() or (not is_local(name) and path.suffix.lower() == ".zarr"):
        return zarr_source(name, crs=crs, choice=choice)
    return _file_source(name, crs=crs, choice=choice)


@dataclass(frozen=True)
class FileSource:
    """A raster file that GDAL reads; each thread opens its own handle, since handles are not safe to share."""

    name: str
    geometry: Geometry
    path: str
    bands: tuple[int, ...]
    files: Files
    elsewhere: tuple[str, ...] = ()

    @cached_property
    def content(self) -> str:
        """See `Source.content`."""
        return digest_of(f"{self.files.content} {self.bands}")

    @cached_property
    def stamp(self) -> str:
        """See `Source.stamp`."""
        return self.files.stamp

    @property
    def lines(self) -> list[str]:
        """See `Source.lines`."""
        return self.files.lines

    @property
    def is_known(self) -> bool:
        """See `Source.is_known`; some servers do not tell."""
        return self.files.is_known

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `Source.paths`."""
        return self.files.paths

    def check(self, window: Window | None = None) -> None:
        """See `Source.check`."""
        self.files.check(window)

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """See `Source.read_bands`."""
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as FileWindow

        part = FileWindow(window.left, window.top, window.columns, window.rows)
        place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
        try:
            values: Iterator[NDArray[np.float32]] | None = None
            while True:
                # options belong to the thread: they must not hold while somebody else uses a band
                with input_options():
                    values = values or read_bands(_dataset(self.path, self.stamp), self.bands, window=part)
                    block = next(values, None)
                if block is None:
                    return
                yield block
        except RasterioError as error:
            # a file that is being replaced is no damaged one
            self.check(window)
            raise InputError(f"{self.name}: {_unreadable(self.path, place, error)}") from error


def _unreadable(path: str, place: str, error: Exception) -> str:
    """What is wrong with a raster of which a part cannot be read, and what can be done about it."""
    if is_remote(path):
        return f"its {place} cannot be read ({one_line(error)}); check the network and run the same command again"
    return f"is damaged, its {place} cannot be read; {'pack' if file_of(path) != path else 'copy'} the file anew"


def _dataset(path: str, stamp: str) -> Any:
    """This thread's handle of a file; a file that was written anew since gets a new one."""
    import rasterio

    cache: OrderedDict[tuple[str, str], Any] = getattr(_local, "datasets", None) or OrderedDict()
    _local.datasets = cache
    key = path, stamp
    if key in cache:
        cache.move_to_end(key)
        return cache[key]
    cache[key] = rasterio.open(path)
    if len(cache) > _OPEN_FILES:
        cache.popitem(last=False)[1].close()
    return cache[key]


def _file_source(name: str, *, crs: str | None, choice: Choice) -> FileSource:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    path = gdal_name(name)
    path = absolute_name(path)
    text = vrt_text(path)
    # before opening, so that a missing source is named
    behind = files_behind(path, text) if text is not None else []
    before = file_state(path)
    try:
        with warnings.catch_warnings(), input_options():
            # a file without georeferencing is refused below
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            parts = dataset.subdatasets
            if len(parts) > 1 or not dataset.count:
                # of the pages of a TIFF GDAL shows the first, as if it were all
                which = f"{len(parts)} rasters; write one out first: {_write_out(parts[0])}" if parts else "no raster"
                raise InputError(f"{name}: holds {which}")
            bands = choice.of(bands_of(dataset), name)
            if any(np.dtype(dataset.dtypes[band - 1]).kind == "c" for band in bands):
                raise InputError(f"{name}: holds complex numbers; use a raster of real values")
            # what rasterio reports without georeferencing, south-up, which would confuse the message
            transform = dataset.transform
            if transform.is_identity:
                raise InputError(f"{name}: {_unplaced(name, dataset)}")
            system = crs_of_dataset(dataset)
            shape, unit = (dataset.height, dataset.width), dataset.units[bands[0] - 1]
            geometry = check_geometry(name, system, tuple(transform)[:6], shape, crs, unit)
            _check_whole(path, name, dataset)
            if text is None and dataset.driver == "VRT":
                behind = files_behind(path, dataset.tags(ns="xml:VRT")["xml:VRT"])
            beside = [file for file in dataset.files if not file.endswith((SIDE, ".ovr"))]
    except RasterioError as error:
        raise InputError(f"{name}: {_unopened(path, error)}") from error
    known = {path, *(item.name for item in behind)}
    parts = [(path, None), *((item.name, item.window) for item in behind)]
    files = files_of(name, [*parts, *((file, None) for file in beside if file not in known)])
    if files.files[0][1] != before:
        raise InputError(f"{name}: has changed while it was opened; try again when nothing writes to it any more")
    return FileSource(name, geometry, path, bands, files, _elsewhere(path, behind))


def _write_out(name: str) -> str:
    """Command that makes a GeoTIFF of what only a driver of GDAL finds."""
    return f"gdal_translate {shlex.quote(name)} OUT.tif"


def _unplaced(name: str, dataset: Any) -> str:
    """What is wrong with a dataset that has no origin and no pixel size, and what can be done about it."""
    ties = (
        ("ground control points", dataset.gcps[0]),
        ("rational polynomial coefficients", dataset.rpcs),
        ("geolocation arrays", dataset.tags(ns="GEOLOCATION")),
    )
    tied = next((what for what, found in ties if found), None)
    if tied is not None:
        return f"is tied to the map by {tied} only; warp it first: gdalwarp -t_srs EPSG:n {shlex.quote(name)} OUT.tif"
    return "has no georeferencing; give it an origin and a pixel size with gdal_edit"


def _unopened(path: str, error: Exception) -> str:
    """What is wrong with what GDAL cannot open, and what can be done about it."""
    if is_remote(path):
        return f"cannot be opened ({one_line(error)}); check the address, the network, and the right to read there"
    if file_of(path) != path:
        return f"cannot be opened in its archive ({one_line(error)}); check the path"
    if path.lower().endswith(_PACKED):
        return "is packed; unpack it first, or name the raster in it by a /vsi path of GDAL"
    return "is no raster that GDAL can read, or is damaged; use GeoTIFF, COG, VRT or Zarr, or copy it anew"


def _elsewhere(path: str, behind: Sequence[Behind]) -> tuple[str, ...]:
    named = [(path, False), *((item.name, item.raw) for item in behind)]
    found = [f"{name} (raw pixels)" if raw else name for name, raw in named if raw or is_remote(name)]
    return tuple(dict.fromkeys(found))


def _check_whole(path: str, name: str, dataset: Any) -> None:
    """Refuse a TIFF that ends before its last block does, as a broken transfer leaves it."""
    if dataset.driver != "GTiff" or file_of(path) != path:
        return
    size, end = os.path.getsize(path), end_of_pixels(Path(path))
    if end > size:
        raise InputError(
            f"{name}: is damaged, it has {size:,} bytes but its pixels reach to {end:,}; copy the file anew"
        )
