"""Zarr stores as sources behind a raster, as xarray or GDAL write them."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tilepipe.errors import InputError
from tilepipe.io.files.paths import OF_A_STORE, is_local, one_line
from tilepipe.io.rasters.bands import Choice
from tilepipe.io.rasters.sources.arrays import ArraySource, array_source
from tilepipe.io.rasters.sources.axes import with_usual_names
from tilepipe.io.rasters.sources.stores import Axis, store_files

if TYPE_CHECKING:
    import xarray as xr


def zarr_source(path: str, *, crs: str | None, choice: Choice) -> ArraySource:
    """A source over the only raster variable of a Zarr store, also of one on a server; errors as for `open_raster`."""
    dataset = _opened(path)
    names = sorted(str(name) for name, item in dataset.data_vars.items() if item.ndim >= 2)
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"{path}: must hold one raster variable, it holds {found}; keep only one")
    stored = with_usual_names(_with_nodata(dataset[names[0]], path, names[0]))
    source = array_source(stored, path, crs=crs, choice=choice)
    if not is_local(path):
        return source
    _, y, x = source.array.dims
    upside_down = y in stored.coords and bool(stored[y][0] != source.array[y][0])
    roles: dict[Any, Axis] = {y: "-y" if upside_down else "y", x: "x"}
    axes = [roles.get(dim, "all") for dim in stored.dims]
    return replace(source, files=store_files(Path(path), path, names[0], axes))


def _opened(path: str) -> xr.Dataset:
    import xarray as xr

    try:
        _check_described(path)
        dataset: xr.Dataset = xr.open_zarr(path, mask_and_scale=False, decode_coords="all", consolidated=False)
    except ImportError as error:
        raise InputError(f"{path}: cannot be read without another package: {one_line(error)}") from error
    except Exception as error:
        reason = one_line(error)
        if not is_local(path):
            raise InputError(
                f"{path}: is no Zarr store that can be read ({reason}); check the address and the network"
            ) from error
        if any(Path(path, name).exists() for name in OF_A_STORE):
            raise InputError(
                f"{path}: is no Zarr raster that can be read ({reason}); write it anew, with xarray or as GeoTIFF, "
                f"for example with: gdal_translate {shlex.quote(path)} OUT.tif"
            ) from error
        raise InputError(f"{path}: is a folder but no Zarr store; name raster files, or a store") from error
    return dataset


def _check_described(path: str) -> None:
    """Open each array of a store of this machine by itself, since a group leaves out those that it cannot read."""
    import zarr

    if is_local(path):
        for described in sorted(Path(path).glob("*/zarr.json")):
            try:
                zarr.open(str(described.parent), mode="r")
            except KeyError as error:
                raise ValueError(f"{described.parent.name}/zarr.json has no {error.args[0]}") from error


def _with_nodata(array: xr.DataArray, path: str, variable: str) -> xr.DataArray:
    """An array of a store with the nodata value that its fill value is, where `xarray` does not take it for one.

    For GDAL it always is one. In format 3 arrays are filled with 0 by default, which thus says nothing.
    """
    import zarr

    stored = zarr.open_array(f"{path.rstrip('/')}/{variable}", mode="r")
    fill = stored.fill_value
    if stored.metadata.zarr_format == 2 or "_FillValue" in array.attrs or not fill:
        return array
    return array.assign_attrs(_FillValue=fill)
