"""How the values of arrays are stored: nodata values, scale and offset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.rasters.validity import Mask, decoded, is_colour, is_nodata, void_pixels

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Packing:
    """How the values of an array are stored.

    Attributes
    ----------
    nodata
        Stored values that mean nodata; NaN always does.
    scale, offset
        A value is scale · stored + offset.
    dtype
        What the bits of stored values mean, if other than the dtype of the array says.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.rasters.packing import Packing
    >>> Packing((-32768,), 0.01, 100.0).unpack(np.array([-32768, 0, 150], np.int16)).tolist()
    [nan, 100.0, 101.5]
    """

    nodata: tuple[float, ...] = ()
    scale: float = 1.0
    offset: float = 0.0
    dtype: np.dtype[Any] | None = None

    def stored(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of an array as what their bits mean."""
        return values if self.dtype is None else values.view(self.dtype)

    def missing(self, values: NDArray[Any]) -> Mask | None:
        """Where stored values mean nodata; None = nowhere."""
        values = self.stored(values)
        masks = [is_nodata(values, nodata) for nodata in self.nodata]
        return np.logical_or.reduce(masks) if masks else None

    def unpack(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Stored values of one band as float32 with NaN for nodata; see `decoded`."""
        block, missing = decoded(self.stored(values), self.scale, self.offset), self.missing(values)
        if missing is not None:
            block[missing] = np.nan
        return block


def unpack_bands(
    bands: Sequence[NDArray[Any]], packings: Sequence[Packing], alpha: NDArray[Any] | None = None
) -> Iterator[NDArray[np.float32]]:
    """Values of bands that make up one pixel together, band after band; NaN where the pixel is void, in all alike.

    Parameters
    ----------
    bands
        Stored values, each of shape (rows, columns).
    packings
        How each band is stored.
    alpha
        Opacity, 0 = void.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.rasters.packing import Packing, unpack_bands
    >>> red, blue = np.array([[0, 200]], np.uint8), np.array([[0, 0]], np.uint8)
    >>> [block.tolist() for block in unpack_bands([red, blue], [Packing((0,))] * 2)]
    [[[nan, 200.0]], [[nan, 0.0]]]
    """
    missing = [packing.missing(values) for values, packing in zip(bands, packings, strict=True)]
    colours = [
        all(is_colour(nodata, packing.dtype or values.dtype) for nodata in packing.nodata)
        for values, packing in zip(bands, packings, strict=True)
    ]
    void = void_pixels(missing, colours, None if alpha is None else alpha <= 0)
    if len(bands) > 1:
        for values in bands:
            if values.dtype.kind == "f":
                unknown = ~np.isfinite(decoded(values))
                void = unknown if void is None else void | unknown
    for values, packing in zip(bands, packings, strict=True):
        block = decoded(packing.stored(values), packing.scale, packing.offset)
        if void is not None:
            block[void] = np.nan
        yield block


def packing_of(array: xr.DataArray, name: str) -> Packing:
    """How an xarray array of one band is stored, by its attributes; what has decoded an array has moved them away.

    Nodata are ``_FillValue`` (or as `rioxarray` finds it) and every ``missing_value`` of CF. ``_Unsigned`` (NetCDF
    Users Guide) says that integers have, or have no, sign, whatever their dtype. The fill value of a Zarr
    array of format 2 is its ``_FillValue``; that of format 3 only says what a chunk holds that was never written.

    Parameters
    ----------
    array
        Of one band; with its number as coordinate ``band`` where the bands of its file are packed differently.
    name
        Of the array, for messages.

    Raises
    ------
    InputError
        A scale or an offset is no number, or that of the band is not known.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.packing import packing_of
    >>> packed = xr.DataArray(np.zeros((3, 3), np.int16), dims=("y", "x"))
    >>> packing_of(packed.assign_attrs(scale_factor=0.01, _FillValue=-32768), "heights")
    Packing(nodata=(-32768,), scale=0.01, offset=0.0, dtype=None)
    """
    import rioxarray  # noqa: F401

    try:
        declared = array.rio.nodata
    except (OverflowError, ValueError):  # no value of this dtype can be that one; NaN is no integer
        declared = None
    found = np.ravel(array.attrs.get("missing_value", ())).tolist()
    found = [value for value in found if isinstance(value, (int, float))]
    nodata = ([] if declared is None else [np.asarray(declared).item()]) + found
    scale, offset = (
        _of_band(array, one, each, unchanged, name)
        for one, each, unchanged in (("scale_factor", "scales", 1.0), ("add_offset", "offsets", 0.0))
    )
    dtype = _meant_dtype(array)
    if dtype is not None:
        nodata = [_reinterpreted(value, dtype) for value in nodata]
    return Packing(tuple(dict.fromkeys(value for value in nodata if value == value)), scale, offset, dtype)


def _meant_dtype(array: xr.DataArray) -> np.dtype[Any] | None:
    """Dtype of integers whose attribute ``_Unsigned`` says that it is another one than theirs; else None."""
    said = str(array.attrs.get("_Unsigned", "")).lower()
    kind = {"true": "u", "false": "i"}.get(said, array.dtype.kind)
    if array.dtype.kind not in "iu" or kind == array.dtype.kind:
        return None
    return np.dtype(f"{array.dtype.byteorder.replace('|', '')}{kind}{array.dtype.itemsize}")


def _reinterpreted(value: float, dtype: np.dtype[Any]) -> float:
    """A nodata value, which has the bits of a stored one, as another dtype of integers reads these."""
    if value != value or value != int(value):
        return value
    values: int = 2 ** (8 * dtype.itemsize)
    unsigned = int(value) % values
    return unsigned - values if dtype.kind == "i" and unsigned >= values // 2 else unsigned


def _of_band(array: xr.DataArray, one: str, each: str, unchanged: float, name: str) -> float:
    """Scale or offset of an array: its own attribute, else that which `rioxarray` keeps for each band of a file."""
    value = array.attrs.get(one, unchanged)
    if one not in array.attrs and each in array.attrs:
        values = dict(enumerate(np.ravel(array.attrs[each]).tolist(), 1))
        band = int(array["band"]) if "band" in array.coords and array["band"].ndim == 0 else None
        if len(set(values.values())) > 1 and band not in values:
            raise InputError(f"{name}: its bands have different {each}; open it with mask_and_scale=True")
        value = values[band] if band in values else values[1]
    try:
        return float(np.asarray(value).item())
    except ValueError:
        raise InputError(f"{name}: its attribute {one} must be one number, not {value!r}") from None
