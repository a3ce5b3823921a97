"""The sources behind a raster: files read by rasterio, and Zarr stores or xarray arrays."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.georeference import Geometry, check_geometry
from tilepipe.grid import Window

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
        """Values of ``window`` (inside the source's shape) with NaN for nodata."""
        ...


def open_source(item: str | Path | xr.DataArray, *, crs: str | None, band: int | None) -> Source:
    """Open one input of a mosaic; see `open_raster`."""
    if not isinstance(item, (str, Path)):
        return array_source(item, "the array", crs=crs, band=band)
    path = Path(item)
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
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

    @property
    def stamp(self) -> str:
        """Size and time of change of the file."""
        status = Path(self.path).stat()
        return f"{status.st_size}:{status.st_mtime_ns}"

    def read(self, window: Window) -> NDArray[np.float32]:
        """See `Source.read`."""
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as FileWindow

        dataset = _dataset(self.path)
        part = FileWindow(window.left, window.top, window.columns, window.rows)
        try:
            values = dataset.read(self.band, window=part)
            block: NDArray[np.float32] = values.astype(np.float32)
            # a nodata value is part of the file, so masks cost a second read only where there is a mask band
            nodata = dataset.nodatavals[self.band - 1]
            if nodata is not None:
                block[values == nodata] = np.nan
            elif _has_mask(dataset, self.band):
                block[dataset.read_masks(self.band, window=part) == 0] = np.nan
        except RasterioError as error:
            raise InputError(f"{self.name}: cannot be read ({error}); the file is damaged, copy it anew") from error
        if values.dtype.kind == "f":
            block[~np.isfinite(block)] = np.nan
        return block


def _has_mask(dataset: Any, band: int) -> bool:
    from rasterio.enums import MaskFlags

    return MaskFlags.all_valid not in dataset.mask_flag_enums[band - 1]


def _dataset(path: str) -> Any:
    """This thread's handle of a file."""
    import rasterio

    cache: OrderedDict[str, Any] = getattr(_local, "datasets", None) or OrderedDict()
    _local.datasets = cache
    if path in cache:
        cache.move_to_end(path)
        return cache[path]
    cache[path] = rasterio.open(path)
    if len(cache) > _OPEN_FILES:
        cache.popitem(last=False)[1].close()
    return cache[path]


def _file_source(path: Path, *, crs: str | None, band: int | None) -> FileSource:
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as dataset:
            band = _choose_band(str(path), dataset.count, band)
            if np.dtype(dataset.dtypes[band - 1]).kind == "c":
                raise InputError(f"{path}: holds complex numbers; use a raster of real values")
            # without georeferencing rasterio reports the identity, which is south-up and would confuse the message
            transform = dataset.transform
            if dataset.crs is None and transform.is_identity:
                raise InputError(f"{path}: has no georeferencing; give it an origin and a pixel size with gdal_edit")
            system = dataset.crs.to_wkt() if dataset.crs else None
            geometry = check_geometry(str(path), system, tuple(transform)[:6], (dataset.height, dataset.width), crs)
    except RasterioError as error:
        raise InputError(f"{path}: is no raster that GDAL can read; use GeoTIFF, COG, VRT or Zarr") from error
    return FileSource(str(path), geometry, str(path), band)


def _choose_band(name: str, count: int, band: int | None) -> int:
    if band is None and count > 1:
        raise InputError(f"{name}: has {count} bands; choose one with --band n (band=n)")
    if band is not None and not 1 <= band <= count:
        raise InputError(f"{name}: has no band {band}; it has {count}")
    return band or 1


@dataclass(frozen=True)
class ArraySource:
    """An xarray array (in memory, over dask, or a Zarr store) with dims ``(y, x)`` and north first."""

    name: str
    geometry: Geometry
    array: Any
    nodata: float | None
    stamp: str = "array"

    def read(self, window: Window) -> NDArray[np.float32]:
        """See `Source.read`."""
        part = self.array[window.slices].data
        if hasattr(part, "compute"):
            part = part.compute(scheduler="synchronous")
        block = np.array(part, dtype=np.float32)
        if self.nodata is not None:
            block[np.asarray(part) == self.nodata] = np.nan
        block[~np.isfinite(block)] = np.nan
        return block


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
    if y not in array.coords and "transform" not in array.rio.grid_mapping:
        raise InputError(f"{name}: has no coordinates; give it x and y coordinates of the pixel centres")
    system = array.rio.crs.to_wkt() if array.rio.crs else None
    transform = tuple(array.rio.transform(recalc=True))[:6]
    geometry = check_geometry(name, system, transform, (array.sizes[y], array.sizes[x]), crs)
    nodata = array.rio.nodata
    return ArraySource(name, geometry, array, None if nodata is None or np.isnan(nodata) else float(nodata))


def _zarr_source(path: Path, *, crs: str | None, band: int | None) -> ArraySource:
    import xarray as xr

    try:
        dataset = xr.open_zarr(path, mask_and_scale=False, decode_coords="all")
    except Exception as error:
        raise InputError(f"{path}: is a folder but no Zarr raster; name raster files or a Zarr store") from error
    names = [str(name) for name, item in dataset.data_vars.items() if item.ndim >= 2]
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"{path}: must hold one raster variable, it holds {found}; keep only one")
    source = array_source(dataset[names[0]], str(path), crs=crs, band=band)
    files = sorted(p for p in path.rglob("*") if p.is_file())
    stamp = f"{len(files)}:{sum(p.stat().st_size for p in files)}:{max(p.stat().st_mtime_ns for p in files)}"
    return ArraySource(source.name, source.geometry, source.array, source.nodata, stamp)
