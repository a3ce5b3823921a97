"""Zarr stores and xarray arrays as sources behind a raster."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.georeference import Geometry, check_geometry
from tilepipe.io.validity import as_block, choose_band, unpacked
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)

_UNEVEN = 0.1
"""Largest deviation of the spacing of coordinates that is taken for rounding, in pixels."""

_ROWS = 1024
"""Rows of an array that are read at once for its checksum."""


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
        return unpacked(as_block(np.asarray(part), self.nodata), scale, offset)


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
        array = array.isel({others[0]: choose_band(name, array.sizes[others[0]], band) - 1})
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


def zarr_source(path: Path, *, crs: str | None, band: int | None) -> ArraySource:
    """A source over the only raster variable of a Zarr store; errors as for `array_source`."""
    import xarray as xr

    try:
        dataset = xr.open_zarr(path, mask_and_scale=False, decode_coords="all", consolidated=False)
    except Exception as error:
        raise InputError(f"{path}: is a folder but no Zarr raster; name raster files or a Zarr store") from error
    names = sorted(str(name) for name, item in dataset.data_vars.items() if item.ndim >= 2)
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"{path}: must hold one raster variable, it holds {found}; keep only one")
    return array_source(dataset[names[0]], str(path), crs=crs, band=band)
