"""Lidar intensity of a scene: mean, texture and speckle."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.hashing import bits, mixed
from tilepipe_kernels.city.objects import CAR, TREE
from tilepipe_kernels.core.compiled import loop

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout, Window

SPECKLE_STREAM = 63

#: Mean intensity of grass, meadow, concrete, pavement, street and marking, and how far texture moves it.
GROUND_INTENSITY = np.array([150, 158, 116, 96, 45, 90], np.float32)
GROUND_TEXTURE = np.array([16, 20, 8, 6, 4, 4], np.float32)
TREE_INTENSITY, CAR_INTENSITY = np.float32(132), np.float32(205)
ROOF_DARKEST, ROOF_RANGE = 68.0, 140.0
SPECKLE_STEPS = 4096
LARGEST = np.float32(255)


def object_intensities(objects: NDArray[Any]) -> NDArray[np.float32]:
    """Mean intensity of each object, shape (n,); objects of dtype `OBJECT`."""
    return np.where(
        objects["kind"] == TREE,
        TREE_INTENSITY + 30 * (objects["tone"] - 0.5),
        np.where(
            objects["kind"] == CAR,
            CAR_INTENSITY + 60 * (objects["tone"] - 0.5),
            ROOF_DARKEST + ROOF_RANGE * objects["tone"],
        ),
    ).astype(np.float32)


@lru_cache(maxsize=8)
def speckle_table(deviation: float) -> NDArray[np.float32]:
    """Quantiles of gamma-distributed speckle of mean 1 and the given standard deviation; float32, shape (4096,).

    Examples
    --------
    >>> from tilepipe_kernels.city.intensity import speckle_table
    >>> speckle = speckle_table(0.16)
    >>> round(float(speckle.mean()), 2), round(float(speckle.std()), 2)
    (1.0, 0.16)
    """
    if deviation == 0:
        return np.ones(SPECKLE_STEPS, np.float32)
    from scipy.special import gammaincinv

    shape = 1 / deviation**2
    quantiles = gammaincinv(shape, (np.arange(SPECKLE_STEPS) + 0.5) / SPECKLE_STEPS) / shape
    return np.asarray(quantiles, np.float32)


@loop
def speckled(
    layout: Layout, window: Window, ground: NDArray[np.uint8], visible: NDArray[np.int32],
    tones: NDArray[np.float32], fine: NDArray[np.float32], coarse: NDArray[np.float32],
    voids: NDArray[np.bool_], quantiles: NDArray[np.float32],
) -> NDArray[np.uint8]:  # fmt: skip
    """Lidar intensity: the mean of what is seen, its texture, and multiplicative speckle; 0 where void.

    Parameters
    ----------
    layout
        The city.
    window
        First row, first column, rows and columns in global pixels.
    ground, visible
        Of the window's `Scene`, shape (rows, columns).
    tones
        Mean intensity of each object, shape (n,).
    fine, coarse
        Textures in [-1, 1], shape (rows, columns).
    voids
        Pixels without a return, shape (rows, columns).
    quantiles
        Those of the speckle, see `speckle_table`.

    Returns
    -------
    ndarray
        uint8, shape (rows, columns): 0 where void, else 1 to 255.
    """
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.uint8)
    half = np.float32(0.5)
    for r in range(rows):
        key = bits(layout.key, SPECKLE_STREAM, row + r, 0)
        for c in range(columns):
            item, kind = visible[r, c], ground[r, c]
            natural = (fine[r, c] + coarse[r, c]) * half
            mean = tones[item] * (np.float32(1) + np.float32(0.06) * natural)
            if item < 0:
                mean = GROUND_INTENSITY[kind] + GROUND_TEXTURE[kind] * natural
            place = np.int64(mixed(key ^ np.uint64(column + c)) >> np.uint64(52))
            value = min(max(mean * quantiles[place] + half, np.float32(1)), LARGEST)
            result[r, c] = np.uint8(0) if voids[r, c] else np.uint8(value)
    return result
