"""Bridge small voids with the nearest value within a stated reach."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.distance import nearest_background


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
    squared, row_offset, column_offset = nearest_background(void, reach)
    rows, columns = np.nonzero(void & (squared <= reach * reach))
    values[rows, columns] = values[rows + row_offset[rows, columns], columns + column_offset[rows, columns]]
    return values
