"""Which pixels of a raster are valid, by the rules of GDAL, and what stored values are worth.

Where one pixel is made of several bands, it is void where all of them are, as GDAL's dataset mask has it: a roof
without any blue is no void in a photograph whose nodata value is 0.  All readers, of files and of arrays, ask here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

_TOLERANCE = 2 * float(np.finfo(np.float32).eps)
"""Largest difference of a float from a nodata value, in shares of their sum (GDAL's ``ARE_REAL_EQUAL``)."""


def decoded(values: NDArray[Any], scale: float = 1.0, offset: float = 0.0) -> NDArray[np.float32]:
    """Stored values of any real dtype as float32: scale · stored + offset.

    Parameters
    ----------
    values
        Of any shape and real dtype.
    scale, offset
        As the raster declares them.

    Returns
    -------
    ndarray of float32, shape of ``values``
        NaN for infinities and for what float32 cannot hold.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.rasters.validity import decoded
    >>> decoded(np.array([0, 150], np.int16), scale=0.01, offset=100.0).tolist()
    [100.0, 101.5]
    """
    with np.errstate(over="ignore"):
        if (scale, offset) == (1, 0):
            block = values.astype(np.float32)
        else:
            # float64 until the end: an offset may take away most digits
            exact = values.astype(np.float64)
            exact *= scale
            exact += offset
            block = exact.astype(np.float32)
    if values.dtype.kind == "f" or (scale, offset) != (1, 0):
        block[np.isinf(block)] = np.nan
    return block


def is_nodata(values: NDArray[Any], nodata: float) -> Mask:
    """Where stored values are a nodata value, as GDAL compares them: integers exactly, any floats as float32.

    Parameters
    ----------
    values
        Stored values of any shape and real dtype.
    nodata
        The value; one that the dtype cannot hold is none.  A Python integer is compared exactly.

    Returns
    -------
    ndarray of bool, shape of ``values``

    Examples
    --------
    The lowest float32, and its nodata value as text of 12 digits.

    >>> import numpy as np
    >>> from tilepipe.io.rasters.validity import is_nodata
    >>> is_nodata(np.array([np.finfo(np.float32).min, 17.5], np.float32), -3.40282346639e38).tolist()
    [True, False]
    """
    if values.dtype.kind != "f":
        bounds = (0, 1) if values.dtype.kind == "b" else (np.iinfo(values.dtype).min, np.iinfo(values.dtype).max)
        if nodata != nodata or not bounds[0] <= nodata <= bounds[1] or nodata != int(nodata):
            return np.zeros(values.shape, np.bool_)
        same: Mask = np.equal(values, values.dtype.type(int(nodata)))
        return same
    if nodata != nodata:
        return np.isnan(values)  # type: ignore[no-any-return]
    kind: Any = np.float32 if values.dtype.itemsize <= 4 else np.float64
    with np.errstate(over="ignore", invalid="ignore"):
        stored, value = values.astype(kind, copy=False), kind(nodata)
        same = (stored == value) | (np.abs(stored - value) < np.abs(stored + value) * kind(_TOLERANCE))
        return same


def is_colour(nodata: float | None, dtype: np.dtype[Any]) -> bool:
    """Whether a nodata value can as well be the value of one band of a valid pixel of a photograph.

    Black can, and what an unsigned integer holds; a sentinel such as -9999 cannot.
    """
    return nodata is not None and (nodata == 0 or dtype.kind in "bu")


def void_pixels(
    missing: Sequence[Mask | None], colours: Sequence[bool], transparent: Mask | None = None
) -> Mask | None:
    """Where pixels are void, from the masks of their bands.

    Parameters
    ----------
    missing
        Where each band is nodata; None = nowhere.
    colours
        Whether that is by a nodata value which may be a colour (`is_colour`).
    transparent
        Where alpha is 0; of several bands it takes the place of their nodata values.

    Returns
    -------
    ndarray of bool, or None = nowhere

    Examples
    --------
    Red and blue of three pixels with nodata 0: a collar, a roof without blue, and grass.

    >>> import numpy as np
    >>> from tilepipe.io.rasters.validity import void_pixels
    >>> red, blue = np.array([0, 200, 90]), np.array([0, 0, 40])
    >>> void_pixels([red == 0, blue == 0], [True, True]).tolist()
    [True, False, False]
    """
    masks = [mask for mask in missing if mask is not None]
    void = np.logical_and.reduce(masks) if len(masks) == len(missing) else None
    if transparent is not None:
        void = transparent if len(missing) > 1 or void is None else void | transparent
    for mask, colour in zip(missing, colours, strict=True):
        if mask is not None and not colour:
            void = mask if void is None else void | mask
    return void
