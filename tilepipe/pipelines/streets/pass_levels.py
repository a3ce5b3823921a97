"""The grey scale of a raster and its dark class, from one pass that counts values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Pass
from tilepipe.errors import InputError
from tilepipe.io.rasters.raster import Raster
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile
from tilepipe.tiling.histograms import added, as_facts
from tilepipe.tiling.noise import count_differences, noise
from tilepipe_kernels.core.arrays import Backend, to_backend
from tilepipe_kernels.image.grey_levels import LARGEST_GREY, stretch
from tilepipe_kernels.image.histogram import bin_values, histogram, otsu_classes, percentile


@dataclass(frozen=True)
class GreyScale:
    """How values become grey levels 0–255, and the two classes of the raster.

    ``darkest`` and ``brightest`` are the values that become 0 and 255; ``threshold`` parts dark from bright grey
    levels; ``dark`` and ``bright`` are the mean grey levels of the two classes; ``noise`` is the standard deviation
    of the noise in grey levels.
    """

    darkest: float
    brightest: float
    threshold: float
    dark: float
    bright: float
    noise: float

    def apply(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Stretch values to grey levels, clipped to 0–255; NaN stays."""
        return stretch(values, self.darkest, self.brightest)


@dataclass(frozen=True)
class CountContext:
    """What the pass needs to know; picklable."""

    raster: Raster
    backend: Backend = "numpy"


def count_values(context: CountContext, tile: Tile) -> Facts:
    """Tile function (halo 1): histograms of the valid values and of their differences to the right neighbour."""
    values = to_backend(context.raster.read(tile.padded), context.backend)
    counted = {
        "value": histogram(values[tile.core_in_padded.slices]),
        "difference": count_differences(values, tile),
    }
    return as_facts(counted)


LEVELS = Pass("levels", count_values, halo=1, bytes_per_pixel=16)


def grey_scale(facts: Iterable[Facts], parameters: StreetParameters, name: str) -> GreyScale:
    """Reconcile the histograms of all tiles.

    Raises
    ------
    InputError
        When the raster holds only nodata or a single value.
    """
    facts = list(facts)
    counts = added(facts, "value")
    filled = np.flatnonzero(counts)
    if filled.size == 0:
        raise InputError(f"{name}: holds nothing but nodata; check the file and its nodata value")
    if filled.size == 1:
        raise InputError(f"{name}: holds the single value {bin_values(filled)[0]:g}; nothing to find in it")
    darkest = percentile(counts, parameters.lowest_percentile)
    brightest = percentile(counts, parameters.highest_percentile)
    if not brightest > darkest:
        darkest, brightest = (float(value) for value in bin_values(filled[[0, -1]]))
    plain = GreyScale(darkest, brightest, 0.0, 0.0, 0.0, 0.0)
    grey = np.rint(plain.apply(bin_values(filled)[None])[0]).astype(np.int64)
    split, dark, bright = otsu_classes(_counted(grey, counts[filled]))
    deviation = noise(added(facts, "difference")) * LARGEST_GREY / (brightest - darkest)
    threshold = split + 0.5 if parameters.darkness is None else parameters.darkness
    return GreyScale(darkest, brightest, threshold, dark, bright, deviation)


def _counted(grey: NDArray[np.int64], counts: NDArray[Any]) -> NDArray[np.int64]:
    result = np.zeros(int(LARGEST_GREY) + 1, np.int64)
    np.add.at(result, grey, counts)
    return result
