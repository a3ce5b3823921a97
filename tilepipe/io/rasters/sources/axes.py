"""The axes of arrays: which dimensions are rows and columns of a map, which way they run, and in which CRS."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import understood_crs

if TYPE_CHECKING:
    import xarray as xr
    from pyproj import CRS

_NAMES = (("y", "x"), ("latitude", "longitude"), ("lat", "lon"), ("northing", "easting"))
"""What rows and columns of a map are called, in small or capital letters, where no attributes of CF tell them."""

_DEGREES = ("latitude", "lat")

_GDAL_CRS = "_CRS"
"""Attribute in which GDAL writes the CRS of a Zarr array, in the forms below, of which it reads the first."""

_FORMS = ("url", "wkt", "projjson")


def spatial_dims(array: xr.DataArray) -> tuple[Hashable, Hashable] | None:
    """Dimensions of an array that are the rows and columns of a map, None where it is not known which.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import spatial_dims
    >>> spatial_dims(xr.DataArray(np.zeros((4, 5)), dims=("X", "Y"))), spatial_dims(xr.DataArray(np.zeros((4, 5))))
    (('Y', 'X'), None)
    """
    dims = {str(dim).lower(): dim for dim in array.dims}
    return _known_dims(array) or next(((dims[y], dims[x]) for y, x in _NAMES if y in dims and x in dims), None)


def _known_dims(array: xr.DataArray) -> tuple[Hashable, Hashable] | None:
    """Rows and columns as `rioxarray` knows them, by usual names or attributes of CF."""
    import rioxarray  # noqa: F401
    from rioxarray.exceptions import MissingSpatialDimensionError

    try:
        return array.rio.y_dim, array.rio.x_dim
    except MissingSpatialDimensionError:
        return None


def with_usual_names(array: xr.DataArray) -> xr.DataArray:
    """An array whose rows and columns are called as `rioxarray` knows them, where it is known which they are.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import with_usual_names
    >>> with_usual_names(xr.DataArray(np.zeros((4, 5)), dims=("Y", "X"))).dims
    ('y', 'x')
    """
    found = spatial_dims(array)
    if found is None or _known_dims(array) == found:
        return array
    usual = ("latitude", "longitude") if str(found[0]).lower() in _DEGREES else ("y", "x")
    taken = [name for name in usual if name in array.coords and name not in found]
    return array.drop_vars(taken).rename(dict(zip(found, usual, strict=True)))


def bands_first(array: xr.DataArray, name: str, band: Hashable = "__band__") -> xr.DataArray:
    """An array with dims ``(band, y, x)``, whatever these are called, from one of two or three dims in any order.

    Parameters
    ----------
    array
        Of any dims.
    name
        Of the array, for messages.
    band
        Dimension of the only band of an array that has none for bands.

    Raises
    ------
    InputError
        It has no spatial dims, or others than these and one of bands.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import bands_first
    >>> bands_first(xr.DataArray(np.zeros((4, 5, 3)), dims=("y", "x", "colour")), "photograph").dims
    ('colour', 'y', 'x')
    """
    array = with_usual_names(array)
    found = spatial_dims(array)
    if found is None:
        raise InputError(f"{name}: has no spatial dimensions; name them y and x")
    others = [dim for dim in array.dims if dim not in found]
    if len(others) > 1:
        raise InputError(f"{name}: has dimensions {array.dims}; select one raster of two dimensions")
    if not others:
        array, others = array.expand_dims(band), [band]
    return array.transpose(*others, *found)


def rows_first(array: xr.DataArray) -> xr.DataArray:
    """An array of two dims as (y, x) where it is known which is which, else as it is.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import rows_first
    >>> rows_first(xr.DataArray(np.zeros((5, 4)), dims=("x", "y"))).dims
    ('y', 'x')
    """
    found = spatial_dims(array)
    return array if found is None else array.transpose(*found)


def map_order(array: xr.DataArray) -> tuple[slice, slice]:
    """Slices of rows and columns that let them run from north to south and from west to east.

    Parameters
    ----------
    array
        Dims ``(y, x)``, last if there are others; a dimension without coordinates is taken to run so.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import map_order
    >>> south_first = xr.DataArray(np.zeros((2, 3)), {"y": [10.0, 11.0], "x": [5.0, 6.0, 7.0]}, ("y", "x"))
    >>> map_order(south_first)
    (slice(None, None, -1), slice(None, None, None))
    """
    rows, columns = (_first_and_last(array, dim) for dim in array.dims[-2:])
    backwards, onwards = slice(None, None, -1), slice(None)
    return backwards if rows[0] < rows[1] else onwards, backwards if columns[0] > columns[1] else onwards


def _first_and_last(array: xr.DataArray, dim: Hashable) -> tuple[float, float]:
    if dim not in array.coords or array.sizes[dim] < 2 or array[dim].dtype.kind not in "iuf":
        return 0.0, 0.0
    ends = np.asarray(array[dim][[0, -1]], np.float64)
    return float(ends[0]), float(ends[1])


def array_crs(array: xr.DataArray, name: str) -> CRS | None:
    """CRS of an array: as `rioxarray` finds it, else as GDAL writes it; None where it has none.

    Coordinates in degrees that name no CRS are taken for WGS 84, as GDAL takes those of netCDF.

    Raises
    ------
    InputError
        It is not understood.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.axes import array_crs
    >>> array = xr.DataArray(np.zeros((4, 5)), dims=("y", "x"))
    >>> array_crs(array, "a.zarr") is None
    True
    >>> url = "http://www.opengis.net/def/crs/EPSG/0/28992"
    >>> array_crs(array.assign_attrs(_CRS={"url": url}), "a.zarr").name
    'Amersfoort / RD New'
    """
    import rioxarray  # noqa: F401

    if array.rio.crs:
        return understood_crs(array.rio.crs, name)
    named: Any = array.attrs.get(_GDAL_CRS)
    if isinstance(named, dict):
        named = next((named[form] for form in _FORMS if form in named), None)
    if named is None and _in_degrees(array):
        named = "EPSG:4326"
    return None if named is None else understood_crs(named, name)


def _in_degrees(array: xr.DataArray) -> bool:
    units = [str(array[dim].attrs.get("units", "")) for dim in array.dims[-2:] if dim in array.coords]
    return array.dims[-2] in _DEGREES or any(unit.startswith("degree") for unit in units)
