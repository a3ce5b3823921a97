"""The grey scale of a raster and its dark class, from one pass that counts values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.grid import Tile
from tilepipe.ledger import Facts
from tilepipe.raster import Raster
from tilepipe.street_parameters import StreetParameters
from tilepipe_kernels import levels

LARGEST_GREY = 255.0

_RESIDUAL_STEPS = 8
_RESIDUAL_BINS = 256 * _RESIDUAL_STEPS


@dataclass(frozen=True)
class GreyScale:
    """How values become grey levels 0–255, and the two classes of the raster.

    ``darkest`` and ``brightest`` are the values that become 0 and 255; ``threshold`` parts dark from bright grey
    levels; ``dark`` and ``bright`` are the mean grey levels of the two classes.
    """

    darkest: float
    brightest: float
    threshold: float
    dark: float
    bright: float

    def apply(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Stretch values to grey levels, clipped to 0–255; NaN stays."""
        scale = np.float32(LARGEST_GREY / (self.brightest - self.darkest))
        grey = (values - np.float32(self.darkest)) * scale
        return np.clip(grey, np.float32(0), np.float32(LARGEST_GREY), out=grey)


def count_values(raster: Raster, tile: Tile) -> Facts:
    """Tile function: histogram of the valid values as filled bins and their counts."""
    counts = levels.histogram(raster.read(tile.core))
    bins = np.flatnonzero(counts)
    return {"bins": bins.astype(np.int32), "counts": counts[bins]}


def grey_scale(facts: list[Facts], parameters: StreetParameters, name: str) -> GreyScale:
    """Reconcile the histograms of all tiles.

    Raises
    ------
    InputError
        When the raster holds only nodata or a single value.
    """
    counts = np.zeros(levels.BINS, np.int64)
    for tile in facts:
        counts[tile["bins"]] += tile["counts"]
    filled = np.flatnonzero(counts)
    if filled.size == 0:
        raise InputError(f"{name}: holds nothing but nodata; check the file and its nodata value")
    if filled.size == 1:
        raise InputError(f"{name}: holds the single value {levels.bin_values(filled)[0]:g}; nothing to find in it")
    darkest = levels.percentile(counts, parameters.lowest_percentile)
    brightest = levels.percentile(counts, parameters.highest_percentile)
    if not brightest > darkest:
        darkest, brightest = (float(value) for value in levels.bin_values(filled[[0, -1]]))
    plain = GreyScale(darkest, brightest, 0.0, 0.0, 0.0)
    grey = np.rint(plain.apply(levels.bin_values(filled))).astype(np.int64)
    split, dark, bright = levels.otsu_classes(_counted(grey, counts[filled]))
    threshold = split + 0.5 if parameters.darkness is None else parameters.darkness
    return GreyScale(darkest, brightest, threshold, dark, bright)


def _counted(grey: NDArray[np.int64], counts: NDArray[Any]) -> NDArray[np.int64]:
    result = np.zeros(int(LARGEST_GREY) + 1, np.int64)
    np.add.at(result, grey, counts)
    return result


def residual_counts(grey: NDArray[np.float32], smooth: NDArray[np.float32]) -> NDArray[np.int64]:
    """Count how far smoothing moved the grey levels, in steps of 1/8, where both are valid."""
    moved = np.abs(grey - smooth)
    bins = (moved[~np.isnan(moved)] * np.float32(_RESIDUAL_STEPS)).astype(np.int32)
    return np.bincount(np.minimum(bins, _RESIDUAL_BINS - 1), minlength=_RESIDUAL_BINS)


def residual_noise(facts: list[Facts]) -> float:
    """Standard deviation of the grey levels' noise from the median residual (a normal one's is 0.6745 of it)."""
    counts = np.sum([f["residuals"] for f in facts], axis=0)
    total = int(counts.sum())
    if total == 0:
        return 0.0
    middle = int(np.searchsorted(np.cumsum(counts), (total + 1) // 2))
    return (middle + 0.5) / _RESIDUAL_STEPS / 0.6745
