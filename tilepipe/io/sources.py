"""The sources behind a raster: what they offer, and files read by rasterio."""

from __future__ import annotations

import os
import threading
import warnings
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.arrays import ARRAY, array_source, zarr_source
from tilepipe.io.bands import Choice
from tilepipe.io.file_bands import bands_of, read_bands
from tilepipe.io.georeference import Geometry, check_geometry
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr

_OPEN_FILES = 32
"""Datasets that one thread keeps open."""

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
    def stamp(self) -> str:
        """Changes when the content does (size and time of change of a file)."""
        ...

    def read(self, window: Window) -> NDArray[np.float32]:
        """Values of ``window`` (inside the source's shape) with NaN for nodata, of the first band that was chosen."""
        ...

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """Values of each band that was chosen; NaN where the pixel that they make up is void, in all bands alike."""
        ...


def open_source(item: str | Path | xr.DataArray, *, crs: str | None, choice: Choice) -> Source:
    """Open one input of a mosaic; see `open_raster`."""
    if not isinstance(item, (str, Path)):
        return array_source(item, ARRAY, crs=crs, choice=choice)
    path = Path(item)
    if not path.exists():
        array = "; a run from an array in memory cannot be repeated from its record" if item == ARRAY else ""
        raise InputError(f"{path}: no such file; check the path{array}")
    if path.suffix.lower() in (".las", ".laz"):
        raise InputError(f"{path}: is a point cloud; make a raster of it with tilepipe grid first")
    if path.is_dir():
        source = zarr_source(path, crs=crs, choice=choice)
        return replace(source, files=_stamp(file for file in path.rglob("*") if file.is_file()))
    return _file_source(path, crs=crs, choice=choice)


@dataclass(frozen=True)
class FileSource:
    """A raster file that GDAL reads; each thread opens its own handle, since handles are not safe to share."""

    name: str
    geometry: Geometry
    path: str
    bands: tuple[int, ...]
    stamp: str

    def read(self, window: Window) -> NDArray[np.float32]:
        """See `Source.read`."""
        return next(self.read_bands(window))

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """See `Source.read_bands`."""
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as FileWindow

        part = FileWindow(window.left, window.top, window.columns, window.rows)
        place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
        try:
            yield from read_bands(_dataset(self.path, self.stamp), self.bands, window=part)
        except RasterioError as error:
            raise InputError(f"{self.name}: is damaged, its {place} cannot be read; copy the file anew") from error


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


def _stamp(files: Iterable[str | Path]) -> str:
    """Changes when one of the files does: their number, their sizes and the last time of change."""
    found = [status for status in map(_status, files) if status is not None]
    return f"{len(found)}:{sum(s.st_size for s in found)}:{max((s.st_mtime_ns for s in found), default=0)}"


def _status(file: str | Path) -> os.stat_result | None:
    try:
        return os.stat(file)
    except OSError:
        return None


def _file_source(path: Path, *, crs: str | None, choice: Choice) -> FileSource:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            # a file without georeferencing is refused below
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            bands = choice.of(bands_of(dataset), str(path))
            if any(np.dtype(dataset.dtypes[band - 1]).kind == "c" for band in bands):
                raise InputError(f"{path}: holds complex numbers; use a raster of real values")
            # without georeferencing rasterio reports the identity, which is south-up and would confuse the message
            transform = dataset.transform
            if dataset.crs is None and transform.is_identity:
                raise InputError(f"{path}: has no georeferencing; give it an origin and a pixel size with gdal_edit")
            system = dataset.crs.to_wkt() if dataset.crs else None
            shape, unit = (dataset.height, dataset.width), dataset.units[bands[0] - 1]
            geometry = check_geometry(str(path), system, tuple(transform)[:6], shape, crs, unit)
            _check_whole(path, dataset, bands[0])
            # the sources of a VRT count, statistics and overviews that other programs leave beside a file do not
            files = [name for name in dataset.files if not name.endswith((".aux.xml", ".ovr"))]
    except RasterioError as error:
        raise InputError(
            f"{path}: is no raster that GDAL can read, or is damaged; use GeoTIFF, COG, VRT or Zarr, or copy it anew"
        ) from error
    return FileSource(str(path), geometry, str(path), bands, _stamp(files))


def _check_whole(path: Path, dataset: Any, band: int) -> None:
    """Refuse a TIFF that ends before its last block does, as a broken transfer leaves it."""
    if dataset.driver != "GTiff":
        return
    size, end, (rows, columns) = path.stat().st_size, 0, dataset.block_shapes[band - 1]
    for row in range(-(-dataset.height // rows)):
        for column in range(-(-dataset.width // columns)):
            # a block that was never written has none of the two
            offset, length = (
                dataset.get_tag_item(f"BLOCK_{item}_{column}_{row}", "TIFF", bidx=band) for item in ("OFFSET", "SIZE")
            )
            end = max(end, int(offset or 0) + int(length or 0))
    if end > size:
        raise InputError(
            f"{path}: is damaged, it has {size:,} bytes but its pixels reach to {end:,}; copy the file anew"
        )


def files_behind(path: Path) -> list[Path]:
    """All files that reading a raster file reads, itself and the sources of a VRT among them; none of a folder.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.sources import files_behind
    >>> from tilepipe.synthetic import City, write_city
    >>> city = write_city(".", City(rows=512, columns=512), layers=["intensity"], truth=False)
    >>> files_behind(city["intensity"])
    [PosixPath('intensity.tif')]
    """
    import rasterio
    from rasterio.errors import RasterioError

    found: list[Path] = []
    pending = [path] if path.is_file() else []
    while pending:
        try:
            with rasterio.open(pending.pop()) as dataset:
                files = [Path(name) for name in dataset.files]
        # what cannot be opened is refused where it is read
        except RasterioError:
            continue
        new = [file for file in files if file not in found]
        found += new
        pending += [file for file in new if file.suffix.lower() == ".vrt" and file != path]
    return found
