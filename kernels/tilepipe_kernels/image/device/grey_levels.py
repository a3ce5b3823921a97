"""`grey_levels` on the device: one thread for each pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.grey_levels import level_of, restored_in_street, stored, stretched


@grid
def _stretch(count: int, values: Any, darkest: np.float32, scale: np.float32, grey: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        grey[p] = stretched(values[p], darkest, scale)


@grid
def _to_levels(count: int, values: Any, starts: Any, slopes: Any, levels: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        value = values[p]
        k = 0
        for level in range(1, slopes.size):
            k += value >= starts[level]
        levels[p] = level_of(value, k, starts[k], slopes[k])


@grid
def _store(count: int, grey: Any, missing: Any, packed: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        packed[p] = stored(grey[p], missing[p])


@grid
def _street_image(
    count: int, mask: Any, ids: Any, packed: Any, dark: np.float32, limit: np.float32, bright: np.float32, image: Any
) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        image[p] = restored_in_street(mask[p], ids[p], packed[p], dark, limit, bright)


def stretch(values: Any, darkest: np.float32, scale: np.float32) -> Any:
    """See `grey_levels.stretch`."""
    xp = namespace(values)
    grey = xp.empty(values.shape, xp.float32)
    _stretch(values.size, xp.ascontiguousarray(values).reshape(-1), darkest, scale, grey.reshape(-1))
    return grey


def to_levels(grey: Any, starts: Any, slopes: Any) -> Any:
    """See `grey_levels.to_levels`; the few levels come from the host."""
    xp = namespace(grey)
    levels = xp.empty(grey.shape, xp.float32)
    values = xp.ascontiguousarray(grey, dtype=xp.float32).reshape(-1)
    _to_levels(grey.size, values, xp.asarray(starts), xp.asarray(slopes), levels.reshape(-1))
    return levels


def store(grey: Any, missing: Any) -> Any:
    """See `grey_levels.store`."""
    xp = namespace(grey, missing)
    packed = xp.empty(grey.shape, xp.uint16)
    flat = (xp.ascontiguousarray(each).reshape(-1) for each in (grey, missing))
    _store(grey.size, *flat, packed.reshape(-1))
    return packed


def street_image(mask: Any, ids: Any, packed: Any, dark: np.float32, limit: np.float32, bright: np.float32) -> Any:
    """See `grey_levels.street_image`."""
    xp = namespace(mask, ids, packed)
    image = xp.empty(mask.shape, xp.float32)
    flat = (xp.ascontiguousarray(each).reshape(-1) for each in (mask, ids, packed))
    _street_image(mask.size, *flat, dark, limit, bright, image.reshape(-1))
    return image
