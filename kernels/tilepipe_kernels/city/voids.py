"""Pixels without a lidar return."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.hashing import HIGH_BITS, UNIT, bits, draws, mixed
from tilepipe_kernels.city.scene import crown_share
from tilepipe_kernels.core.compiled import loop, rule

if TYPE_CHECKING:
    from tilepipe_kernels.city.layout import Layout, Window


#: Share of pixels without a return, mesh of the lattice of larger voids and share of its cells that hold one.
SPECK_SHARE, VOID_MESH, VOID_SHARE = 0.0012, 170.0, 0.3
VOID_REACH = 16.0
SPECK_STREAM, VOID_STREAM = 70, 71


@loop
def find_voids(layout: Layout, window: Window) -> NDArray[np.bool_]:
    """Pixels without a return: single specks, and blobs as over water or below other missing swath.

    Parameters
    ----------
    layout
        The city.
    window
        First row, first column, rows and columns in global pixels.

    Returns
    -------
    ndarray
        bool, shape (rows, columns).

    Examples
    --------
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> from tilepipe_kernels.city.voids import find_voids
    >>> window = (0, 0, 400, 400)
    >>> some, none = (find_voids(city_layout(3, (400, 400), 0.5, voids=v), window) for v in (1, 0))
    >>> bool(some.any()), bool(none.any())
    (True, False)
    """
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.bool_)
    for r in range(rows):
        key = bits(layout.key, SPECK_STREAM, row + r, 0)
        for c in range(columns):
            speck = float(mixed(key ^ np.uint64(column + c)) >> HIGH_BITS) * UNIT
            result[r, c] = speck < SPECK_SHARE * layout.voids
    metres = layout.resolution
    for i in range(
        int(math.floor((row * metres - VOID_REACH) / VOID_MESH)),
        int(math.floor(((row + rows) * metres + VOID_REACH) / VOID_MESH)) + 1,
    ):
        for j in range(
            int(math.floor((column * metres - VOID_REACH) / VOID_MESH)),
            int(math.floor(((column + columns) * metres + VOID_REACH) / VOID_MESH)) + 1,
        ):
            key = bits(layout.key, VOID_STREAM, i, j)
            draw = draws(key, 0)
            if draw[0] >= VOID_SHARE * layout.voids:
                continue
            y, x = (i + draw[1]) * VOID_MESH, (j + draw[2]) * VOID_MESH
            _punch(result, row, column, metres, y, x, 2.0 + 10.0 * draw[3] * draw[3])
    return result


@rule
def _punch(
    result: NDArray[np.bool_], row: int, column: int, resolution: float, y: float, x: float, radius: float
) -> None:
    """Mark a lobed blob in a mask."""
    reach = 1.15 * radius
    for r in range(
        max(0, int(math.floor((y - reach) / resolution)) - row),
        min(result.shape[0], int(math.ceil((y + reach) / resolution)) - row),
    ):
        for c in range(
            max(0, int(math.floor((x - reach) / resolution)) - column),
            min(result.shape[1], int(math.ceil((x + reach) / resolution)) - column),
        ):
            down, right = (row + r + 0.5) * resolution - y, (column + c + 0.5) * resolution - x
            if crown_share(right, down, radius) < 1.0:
                result[r, c] = True
