"""Bridge small voids with the nearest value within a stated reach."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.compiled import loop
from tilepipe_kernels.distance import checked_cap, column_offsets, mask_bytes


def halo(reach: int) -> int:
    """Pixels beyond which a value cannot fill a void."""
    return reach


def fill_voids(block: NDArray[Any], reach: int) -> NDArray[np.float32]:
    """Give every void the nearest value within ``reach``.

    Parameters
    ----------
    block
        Values, shape (rows, columns), any real dtype; NaN = void.
    reach
        Largest distance in pixels (Euclidean, between pixel centres) that is bridged; 0 fills nothing.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Values; of several nearest values that of the lowest row, then column; NaN where none is within reach.

    Raises
    ------
    ValueError
        When ``reach`` is negative or the block is not two-dimensional.
    """
    values = np.array(block, dtype=np.float32)
    if values.ndim != 2:
        raise ValueError(f"block must have two dimensions (rows, columns), not {values.ndim}")
    if reach < 0:
        raise ValueError(f"reach must not be negative, not {reach}")
    void = np.isnan(values)
    if reach == 0 or not void.any():
        return values
    vertical = column_offsets(mask_bytes(void), np.int16(checked_cap(reach) + 1))
    _fill(values, vertical, reach)
    return values


@loop
def _fill(values: NDArray[np.float32], vertical: NDArray[np.int16], reach: int) -> None:
    """Look along the row of each void for the nearest value, whose row each column knows; nothing else is read."""
    rows, columns = values.shape
    for i in range(rows):
        offsets = vertical[i]
        for j in range(columns):
            if offsets[j] == 0:
                continue
            best, row, column = np.int64(reach * reach + 1), np.int64(0), 0
            for x in range(max(0, j - reach), min(columns, j + reach + 1)):
                down, across = np.int64(offsets[x]), x - j
                squared = down * down + across * across
                if squared < best or (squared == best and (down, across) < (row, column)):
                    best, row, column = squared, down, across
            if best <= reach * reach:
                values[i, j] = values[i + row, j + column]
