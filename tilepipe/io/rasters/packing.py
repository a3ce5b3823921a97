"""How the values of arrays are stored: nodata values, scale and offset."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.rasters.validity import Mask, decoded, is_colour, is_nodata, void_pixels

if TYPE_CHECKING:
    import xarray as xr

HOW_STORED = ("scale_factor", "add_offset", "scales", "offsets", "valid_range", "valid_min", "valid_max")
"""Attributes that tell what stored values mean, beside those of nodata; what is computed of the values has none."""

_PACKED = (("scale_factor", 1.0), ("add_offset", 0.0))
"""Attributes of a packed array, and what they are where it has none."""


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
    valid
        Least and greatest valid value, None = any.
    valid_unpacked
        Whether these two are values, not stored ones.

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
    valid: tuple[float, float] | None = None
    valid_unpacked: bool = False

    def stored(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of an array as what their bits mean."""
        return values if self.dtype is None else values.view(self.dtype)

    def missing(self, values: NDArray[Any]) -> Mask | None:
        """Where stored values mean nodata; None = nowhere."""
        values = self.stored(values)
        masks = [is_nodata(values, nodata) for nodata in self.nodata]
        if self.valid is not None:
            masks.append(_outside(self._decoded(values) if self.valid_unpacked else values, self.valid))
        return np.logical_or.reduce(masks) if masks else None

    def unpack(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Stored values of one band as float32 with NaN for nodata; see `decoded`."""
        block, missing = self._decoded(self.stored(values)), self.missing(values)
        if missing is not None:
            block[missing] = np.nan
        return block

    def may_be_colour(self, dtype: np.dtype[Any]) -> bool:
        """Whether what is missing of an array of a dtype can as well be the value of one band of a photograph."""
        return self.valid is None and all(is_colour(nodata, self.dtype or dtype) for nodata in self.nodata)

    def _decoded(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        return decoded(stored, self.scale, self.offset)


def _outside(values: NDArray[Any], valid: tuple[float, float]) -> Mask:
    """Where values lie outside a range, which counts in the precision of the values; what is no number does not."""
    least, greatest = valid if values.dtype.kind in "biu" else np.asarray(valid).astype(values.dtype)
    outside: Mask = (values < least) | (values > greatest)
    return outside


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
    colours = [packing.may_be_colour(values.dtype) for values, packing in zip(bands, packings, strict=True)]
    void = void_pixels(missing, colours, None if alpha is None else alpha <= 0)
    if len(bands) > 1:
        for values in bands:
            if values.dtype.kind == "f":
                unknown = ~np.isfinite(decoded(values))
                void = unknown if void is None else void | unknown
    for values, packing in zip(bands, packings, strict=True):
        block = packing._decoded(packing.stored(values))
        if void is not None:
            block[void] = np.nan
        yield block


def packing_of(array: xr.DataArray, name: str) -> Packing:
    """How an xarray array of one band is stored, by its attributes; what has decoded an array has moved them away.

    Nodata are ``_FillValue`` (or as `rioxarray` finds it) and every ``missing_value`` of CF. ``_Unsigned`` (NetCDF
    Users Guide) says that integers have, or have no, sign, whatever their dtype. Void is also what lies outside
    ``valid_range`` or ``valid_min`` and ``valid_max`` (CF 1.11, section 2.5.1).

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
    Packing(nodata=(-32768,), scale=0.01, offset=0.0, dtype=None, valid=None, valid_unpacked=False)
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
    dtype = _meant_dtype(array.dtype, array.attrs.get("_Unsigned"))
    if dtype is not None:
        nodata = [_reinterpreted(value, dtype) for value in nodata]
    nodata = list(dict.fromkeys(value for value in nodata if value == value))
    return Packing(tuple(nodata), scale, offset, dtype, *_valid_range(array, dtype, name))


def _valid_range(
    array: xr.DataArray, dtype: np.dtype[Any] | None, name: str
) -> tuple[tuple[float, float] | None, bool]:
    """Range of valid values by the attributes of CF, and whether it is one of unpacked values.

    It is one of stored values, unless these are integers and its bounds are floats, as their scale is (NetCDF Users
    Guide, appendix A.1).  What has decoded an array has left its range as it was.
    """
    attributes = array.attrs
    given = attributes.get("valid_range", (attributes.get("valid_min"), attributes.get("valid_max")))
    bounds = [None if value is None else np.asarray(value) for value in (given if np.ndim(given) else [given])]
    numbers = all(value is None or (value.size == 1 and value.dtype.kind in "iuf") for value in bounds)
    if len(bounds) != 2 or not numbers:
        raise InputError(f"{name}: its attribute valid_range must be two numbers, not {given!r}; correct or remove it")
    if all(value is None for value in bounds):
        return None, False
    floats = any(value is not None and value.dtype.kind == "f" for value in bounds)
    least, greatest = (
        end if value is None else value.item() for value, end in zip(bounds, (-np.inf, np.inf), strict=True)
    )
    if dtype is None and "_Unsigned" in array.encoding:
        dtype = _meant_dtype(np.dtype(array.encoding.get("dtype", array.dtype)), array.encoding["_Unsigned"])
    if dtype is not None:
        least, greatest = (_reinterpreted(value, dtype) if np.isfinite(value) else value for value in (least, greatest))
    if array.dtype.kind != "f":
        return (least, greatest), floats and _is_packed(array.attrs)
    if not floats and _is_packed(array.encoding):
        scale, offset = (float(array.encoding.get(key, unchanged)) for key, unchanged in _PACKED)
        least, greatest = sorted((least * scale + offset, greatest * scale + offset))
    return (least, greatest), False


def _is_packed(described: Mapping[Any, Any]) -> bool:
    return any(key in described for key, _ in _PACKED)


def _meant_dtype(stored: np.dtype[Any], unsigned: Any) -> np.dtype[Any] | None:
    """Dtype of integers of which ``_Unsigned`` says that it is another one than that of what is stored; else None."""
    kind = {"true": "u", "false": "i"}.get(str(unsigned).lower(), stored.kind)
    if stored.kind not in "iu" or kind == stored.kind:
        return None
    return np.dtype(f"{stored.byteorder.replace('|', '')}{kind}{stored.itemsize}")


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
