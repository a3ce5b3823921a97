"""Nearest values by looking at every pixel."""

from __future__ import annotations

import numpy as np


def fill_voids(values: np.ndarray, reach: int) -> np.ndarray:
    """Nearest value within ``reach``; of several that of the lowest row, then column."""
    rows, columns = np.nonzero(~np.isnan(values))
    filled = values.astype(np.float32)
    for row, column in np.argwhere(np.isnan(values)):
        squared = (rows - row) ** 2 + (columns - column) ** 2
        # the pixels come in row-major order, so the first of the nearest is the wanted one
        if squared.size and squared.min() <= reach * reach:
            nearest = int(np.argmin(squared))
            filled[row, column] = values[rows[nearest], columns[nearest]]
    return filled
