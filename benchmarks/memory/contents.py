"""What a raster can hold that is worst for memory: noise, patterns as fine as its pixels, nodata, one value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

NODATA = 0
DARK, BRIGHT = 20, 220
HEIGHT = 1 / 8
"""Metres of a step of a value, where values are heights."""

Values = NDArray[Any]


def _places(side: int) -> tuple[Values, Values]:
    return np.ogrid[:side, :side]


def _chosen(bright: Values) -> Values:
    return np.where(bright, BRIGHT, DARK)


def noise(side: int) -> Values:
    """White noise of 255 values."""
    return np.random.default_rng(0).integers(1, 256, (side, side))


def checkerboard(side: int, square: int) -> Values:
    """Squares of two values."""
    row, column = _places(side)
    return _chosen((row // square + column // square) % 2)


def stripes(side: int) -> Values:
    """Columns of two values."""
    row, column = _places(side)
    return _chosen((column + 0 * row) % 2)


def salt_and_pepper(side: int) -> Values:
    """One value, and a tenth of the pixels at the ends of the scale."""
    chance = np.random.default_rng(0).random((side, side))
    return np.select([chance < 0.05, chance > 0.95], [1, 255], 120)


def alternating_nodata(side: int) -> Values:
    """Noise of which every second pixel is nodata."""
    row, column = _places(side)
    return np.where((row + column) % 2, noise(side), NODATA)


def one_region(side: int) -> Values:
    """One dark region with a bright rim, ramps in it so that there are levels to tell apart."""
    row, column = _places(side)
    inside = (row > 0) & (column > 0) & (row < side - 1) & (column < side - 1)
    return np.where(inside, 10 + 4 * row // side + 4 * column // side, BRIGHT)


def four_levels(side: int) -> Values:
    """Pixels of four values in turn, so that each is a region of its own."""
    row, column = _places(side)
    return DARK + 60 * (row % 2 * 2 + column % 2)


CONTENTS: dict[str, Callable[[int], Values]] = {
    "white noise": noise,
    "checkerboard of 1 px": lambda side: checkerboard(side, 1),
    "checkerboard of 2 px": lambda side: checkerboard(side, 2),
    "four levels in turn": four_levels,
    "stripes": stripes,
    "salt and pepper": salt_and_pepper,
    "alternating nodata": alternating_nodata,
    "one region": one_region,
    "constant": lambda side: np.full((side, side), DARK),
    "all nodata": lambda side: np.full((side, side), NODATA),
}


def write_content(folder: Path, name: str, side: int, *, heights: bool) -> Path:
    """Write a content as a raster of half a metre, of grey values or of heights; the same file serves again."""
    import rasterio
    from rasterio.transform import from_origin

    path = folder / f"{name.replace(' ', '-')}-{side}-{'heights' if heights else 'grey'}.tif"
    if path.exists():
        return path
    values = CONTENTS[name](side)
    profile = {
        "driver": "GTiff",
        "width": side,
        "height": side,
        "count": 1,
        "dtype": "float32" if heights else "uint8",
        "crs": "EPSG:32633",
        "transform": from_origin(392000, 5820000, 0.5, 0.5),
        "nodata": NODATA,
        "tiled": True,
    }
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write((values * HEIGHT if heights else values).astype(profile["dtype"]), 1)
    return path
