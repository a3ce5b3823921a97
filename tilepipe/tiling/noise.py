"""The noise of an image, from a histogram of the differences of neighbours that adds up over tiles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.grid import Tile, Window
from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.image.histogram import histogram, percentile

_ROWS = 4
"""The noise is measured on every so-maniest global row."""

_MEDIAN_DIFFERENCE = 0.6745 * math.sqrt(2)
"""Median absolute difference of two values with normal noise of standard deviation 1."""


def count_differences(values: NDArray[np.float32], tile: Tile) -> NDArray[np.int64]:
    """Histogram (`image.histogram.histogram`) of the differences of a tile's pixels to their right neighbours.

    Parameters
    ----------
    values
        Image of the tile's padded window; NaN = nodata. The halo is one pixel at least.
    tile
        The tile.
    """
    core = tile.core_in_padded
    beside = Window(core.top, core.left, core.bottom, min(core.right + 1, values.shape[1]))
    xp = namespace(values)
    return histogram(xp.abs(xp.diff(values[beside.slices][-tile.core.top % _ROWS :: _ROWS], axis=1)))


def noise(counts: NDArray[np.int64]) -> float:
    """Standard deviation of the noise from the median difference of neighbours: edges do not move it.

    Parameters
    ----------
    counts
        Sum of `count_differences` over all tiles.

    Returns
    -------
    float
        In the unit of the image.

    Examples
    --------
    A street beside a roof, with noise of 5 grey levels on both: the edge between them does not count.

    >>> import numpy as np
    >>> from tilepipe.tiling.grid import TileGrid
    >>> from tilepipe.tiling.noise import count_differences, noise
    >>> from tilepipe_kernels.core.random import normals
    >>> image = np.repeat([60, 200], 32) + 5 * normals(np.arange(64 * 64).reshape(64, 64), seed=0)
    >>> tile = TileGrid((64, 64), (64, 64)).tile(0, halo=1)
    >>> round(noise(count_differences(image.astype(np.float32), tile)))
    5
    """
    return percentile(counts, 50.0) / _MEDIAN_DIFFERENCE if counts.any() else 0.0
