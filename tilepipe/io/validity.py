"""Which pixels of a raster are valid, and what their stored values mean."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError


def as_block(values: NDArray[Any], nodata: float | None) -> NDArray[np.float32]:
    """Values of any real dtype as float32 with NaN for nodata, infinities and what float32 cannot hold."""
    with np.errstate(over="ignore"):
        block = values.astype(np.float32)
        if nodata is not None:
            block[values == nodata] = np.nan
    if values.dtype.kind == "f":
        block[np.isinf(block)] = np.nan
    return block


def unpacked(block: NDArray[np.float32], scale: float, offset: float) -> NDArray[np.float32]:
    """Values that a file stores as scale · stored + offset."""
    return block if (scale, offset) == (1, 0) else block * np.float32(scale) + np.float32(offset)


def choose_band(name: str, count: int, band: int | None) -> int:
    """The band to read, counted from 1."""
    if band is None and count > 1:
        raise InputError(f"{name}: has {count} bands; choose one with --band n (band=n)")
    if band is not None and not 1 <= band <= count:
        raise InputError(f"{name}: has no band {band}; it has {count}")
    return band or 1
