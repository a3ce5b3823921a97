"""Random textures over a window: value noise and white noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.hashing import HIGH_BITS, bits, mixed, uniform
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout, Window

TWO, THREE = np.float32(2), np.float32(3)


@loop
def texture(layout: Layout, window: Window, mesh: float, stream: int) -> NDArray[np.float32]:
    """Value noise: random values on a lattice, smoothly interpolated.

    Parameters
    ----------
    layout
        The city.
    window
        First row, first column, rows and columns in global pixels.
    mesh
        Distance of the lattice's points in metres.
    stream
        Stream of random numbers.

    Returns
    -------
    ndarray
        float32 in [-1, 1], shape (rows, columns).

    Examples
    --------
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> from tilepipe_kernels.city.noise import texture
    >>> noise = texture(city_layout(3, (400, 400), 0.5), (0, 0, 400, 400), 40.0, 1)
    >>> noise.shape, bool(abs(noise).max() <= 1)
    ((400, 400), True)
    """
    row, column, rows, columns = window
    step = layout.resolution / mesh
    first_row, first_column = int(math.floor(row * step)), int(math.floor(column * step))
    high, wide = int(rows * step) + 3, int(columns * step) + 3
    lattice = np.empty((high, wide), np.float32)
    for r in range(high):
        for c in range(wide):
            lattice[r, c] = np.float32(2.0 * uniform(layout.key, stream, first_row + r, first_column + c) - 1.0)
    places, shares = np.empty(columns, np.int64), np.empty(columns, np.float32)
    for c in range(columns):
        place = (column + c + 0.5) * step
        places[c] = int(math.floor(place)) - first_column
        shares[c] = smooth(np.float32(place - math.floor(place)))
    result = np.empty((rows, columns), np.float32)
    line = np.empty(wide, np.float32)
    for r in range(rows):
        place = (row + r + 0.5) * step
        below = int(math.floor(place)) - first_row
        share = smooth(np.float32(place - math.floor(place)))
        for c in range(wide):
            line[c] = lattice[below, c] + share * (lattice[below + 1, c] - lattice[below, c])
        for c in range(columns):
            left = line[places[c]]
            result[r, c] = left + shares[c] * (line[places[c] + 1] - left)
    return result


@rule
def smooth(share: np.float32) -> np.float32:
    """The cubic step 3 s^2 - 2 s^3."""
    return share * share * (THREE - TWO * share)


@loop
def white(layout: Layout, window: Window, stream: int) -> NDArray[np.float32]:
    """White noise of a bell shape, mean 0 and standard deviation 1: the sum of four draws of 13 bits.

    Parameters
    ----------
    layout
        The city.
    window
        First row, first column, rows and columns in global pixels.
    stream
        Stream of random numbers.

    Returns
    -------
    ndarray
        float32, shape (rows, columns).

    Examples
    --------
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> from tilepipe_kernels.city.noise import white
    >>> noise = white(city_layout(3, (400, 400), 0.5), (0, 0, 400, 400), 1)
    >>> noise.shape, round(float(noise.std()), 1)
    ((400, 400), 1.0)
    """
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.float32)
    scale = np.float32(np.sqrt(3.0) / 8192)
    for r in range(rows):
        key = bits(layout.key, stream, row + r, 0)
        for c in range(columns):
            draw = mixed(key ^ np.uint64(column + c)) >> HIGH_BITS
            total = (draw & np.uint64(8191)) + ((draw >> np.uint64(13)) & np.uint64(8191))
            total += ((draw >> np.uint64(26)) & np.uint64(8191)) + ((draw >> np.uint64(39)) & np.uint64(8191))
            result[r, c] = np.float32(np.int64(total) - 16382) * scale
    return result
