"""The sources behind a raster: files read by rasterio, and Zarr stores or xarray arrays."""

from __future__ import annotations

import os
import threading
import warnings
import zlib
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.georeference import Geometry, check_geometry
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr

ARRAY = "the array"
"""Name of an input that is no file."""

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)

_UNEVEN = 0.1
"""Largest deviation of the spacing of coordinates that is taken for rounding, in pixels."""

_OPEN_FILES = 32
"""Datasets that one thread keeps open."""

_ROWS = 1024
"""Rows of an array that are read at once for its checksum."""

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
        """Values of ``window`` (inside the source's shape) with NaN for nodata."""
        ...


def open_source(item: str | Path | xr.DataArray, *, crs: str | None, band: int | None) -> Source:
    """Open one input of a mosaic; see `open_raster`."""
    if not isinstance(item, (str, Path)):
        return array_source(item, ARRAY, crs=crs, band=band)
    path = Path(item)
    if not path.exists():
        array = "; a run from an array in memory cannot be repeated from its record" if item == ARRAY else ""
        raise InputError(f"{path}: no such file; check the path{array}")
    if path.suffix.lower() in (".las", ".laz"):
        raise InputError(f"{path}: is a point cloud; make a raster of it with tilepipe grid first")
    if path.is_dir():
        return _zarr_source(path, crs=crs, band=band)
    return _file_source(path, crs=crs, band=band)


@dataclass(frozen=True)
class FileSource:
    """A raster file that GDAL reads; each thread opens its own handle, since handles are not safe to share."""

    name: str
    geometry: Geometry
    path: str
    band: int
    stamp: str

    def read(self, window: Window) -> NDArray[np.float32]:
        """See `Source.read`."""
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as FileWindow

        part = FileWindow(window.left, window.top, window.columns, window.rows)
        place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
        try:
            dataset = _dataset(self.path, self.stamp)
            values = dataset.read(self.band, window=part)
            block = as_block(values, dataset.nodatavals[self.band - 1])
            if _has_mask(dataset, self.band):
                block[dataset.read_masks(self.band, window=part) == 0] = np.nan
        except RasterioError as error:
            raise InputError(f"{self.name}: is damaged, its {place} cannot be read; copy the file anew") from error
        return _unpacked(block, dataset.scales[self.band - 1], dataset.offsets[self.band - 1])


def as_block(values: NDArray[Any], nodata: float | None) -> NDArray[np.float32]:
    """Values of any real dtype as float32 with NaN for nodata, infinities and what float32 cannot hold."""
    with np.errstate(over="ignore"):
        block = values.astype(np.float32)
        if nodata is not None:
            block[values == nodata] = np.nan
    if values.dtype.kind == "f":
        block[np.isinf(block)] = np.nan
    return block


def _unpacked(block: NDArray[np.float32], scale: float, offset: float) -> NDArray[np.float32]:
    """Values that a file stores as scale · stored + offset."""
    return block if (scale, offset) == (1, 0) else block * np.float32(scale) + np.float32(offset)


def _has_mask(dataset: Any, band: int) -> bool:
    """Whether a band has a mask of its own or an alpha band, beside its nodata value."""
    from rasterio.enums import MaskFlags

    return not {MaskFlags.all_valid, MaskFlags.nodata} & set(dataset.mask_flag_enums[band - 1])


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


def _file_source(path: Path, *, crs: str | None, band: int | None) -> FileSource:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            # a file without georeferencing is refused below
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            band = _choose_band(str(path), dataset.count, band)
            if np.dtype(dataset.dtypes[band - 1]).kind == "c":
                raise InputError(f"{path}: holds complex numbers; use a raster of real values")
            # without georeferencing rasterio reports the identity, which is south-up and would confuse the message
            transform = dataset.transform
            if dataset.crs is None and transform.is_identity:
                raise InputError(f"{path}: has no georeferencing; give it an origin and a pixel size with gdal_edit")
            system = dataset.crs.to_wkt() if dataset.crs else None
            shape, unit = (dataset.height, dataset.width), dataset.units[band - 1]
            geometry = check_geometry(str(path), system, tuple(transform)[:6], shape, crs, unit)
            _check_whole(path, dataset, band)
            # the sources of a VRT count, statistics and overviews that other programs leave beside a file do not
            files = [name for name in dataset.files if not name.endswith((".aux.xml", ".ovr"))]
    except RasterioError as error:
        raise InputError(
            f"{path}: is no raster that GDAL can read, or is damaged; use GeoTIFF, COG, VRT or Zarr, or copy it anew"
        ) from error
    return FileSource(str(path), geometry, str(path), band, _stamp(files))


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


def _choose_band(name: str, count: int, band: int | None) -> int:
    if band is None and count > 1:
        raise InputError(f"{name}: has {count} bands; choose one with --band n (band=n)")
    if band is not None and not 1 <= band <= count:
        raise InputError(f"{name}: has no band {band}; it has {count}")
    return band or 1


@dataclass(frozen=True)
class ArraySource:
    """An xarray array (in memory, over dask, or a Zarr store) with dims ``(y, x)`` and north first.

    Scale and offset are those that CF attributes name; where xarray has applied them it has moved them elsewhere.
    """

    name: str
    geometry: Geometry
    array: Any
    nodata: float | None
    files: str | None = None

    @property
    def stamp(self) -> str:
        """Stamp of the files of a store, name of the graph of a lazy array, checksum of the values of any other."""
        if self.files is not None:
            return self.files
        if self.array.chunks is not None:
            return str(self.array.data.name)
        total = 0
        for top in range(0, self.array.shape[0], _ROWS):
            rows = np.ascontiguousarray(self.array[top : top + _ROWS].data)
            total = zlib.crc32(rows.view(np.uint8).data, total)
        return f"{total:08x}"

    def read(self, window: Window) -> NDArray[np.float32]:
        """See `Source.read`."""
        part = self.array[window.slices].data
        if hasattr(part, "compute"):
            part = part.compute(scheduler="synchronous")
        scale, offset = (self.array.attrs.get(*name) for name in (("scale_factor", 1.0), ("add_offset", 0.0)))
        return _unpacked(as_block(np.asarray(part), self.nodata), scale, offset)


def array_source(array: xr.DataArray, name: str, *, crs: str | None, band: int | None) -> ArraySource:
    """A source over an xarray array: dims in any order, y up or down, CRS as rioxarray finds it.

    Raises
    ------
    InputError
        See `open_raster`.
    """
    import rioxarray  # noqa: F401

    try:
        y, x = array.rio.y_dim, array.rio.x_dim
    except Exception as error:
        raise InputError(f"{name}: has no spatial dimensions; name them y and x") from error
    others = [dim for dim in array.dims if dim not in (y, x)]
    if len(others) > 1:
        raise InputError(f"{name}: has dimensions {array.dims}; select one raster of two dimensions")
    if others:
        array = array.isel({others[0]: _choose_band(name, array.sizes[others[0]], band) - 1})
    array = array.transpose(y, x)
    if array.sizes[y] > 1 and y in array.coords and float(array[y][0]) < float(array[y][-1]):
        array = array.isel({y: slice(None, None, -1)})
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: holds {array.dtype} values; use a raster of real numbers")
    system = array.rio.crs.to_wkt() if array.rio.crs else None
    shape, unit = (array.sizes[y], array.sizes[x]), array.attrs.get("units")
    unit = unit if isinstance(unit, str) else None
    geometry = check_geometry(name, system, _transform(array, name), shape, crs, unit)
    return ArraySource(name, geometry, array, nodata_of(array))


def _transform(array: Any, name: str) -> tuple[float, ...]:
    """Affine coefficients from the coordinates of an array, which must be evenly spaced, or from its GeoTransform."""
    for dim in (array.rio.y_dim, array.rio.x_dim):
        if dim not in array.coords:
            transform = tuple(array.rio.transform())[:6]
            if transform == _IDENTITY:
                raise InputError(f"{name}: has no coordinates; give it x and y coordinates of the pixel centres")
            return transform
        centres = np.asarray(array[dim], dtype=np.float64)
        steps = np.diff(centres)
        if steps.size and not np.all(np.abs(steps - steps.mean()) <= _UNEVEN * abs(steps.mean())):
            raise InputError(f"{name}: its {dim} coordinates are not evenly spaced; reindex or resample it first")
    return tuple(array.rio.transform(recalc=True))[:6]


def nodata_of(array: Any) -> float | None:
    """Value of an array that means nodata; NaN always does."""
    import rioxarray  # noqa: F401

    try:
        nodata = array.rio.nodata
    except (OverflowError, ValueError):  # no value of this dtype can be that one; NaN is no integer
        return None
    return None if nodata is None or np.isnan(nodata) else float(nodata)


def _zarr_source(path: Path, *, crs: str | None, band: int | None) -> ArraySource:
    import xarray as xr

    try:
        dataset = xr.open_zarr(path, mask_and_scale=False, decode_coords="all", consolidated=False)
    except Exception as error:
        raise InputError(f"{path}: is a folder but no Zarr raster; name raster files or a Zarr store") from error
    names = sorted(str(name) for name, item in dataset.data_vars.items() if item.ndim >= 2)
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"{path}: must hold one raster variable, it holds {found}; keep only one")
    source = array_source(dataset[names[0]], str(path), crs=crs, band=band)
    return replace(source, files=_stamp(p for p in path.rglob("*") if p.is_file()))
