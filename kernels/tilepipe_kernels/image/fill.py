"""Bridge small voids with the nearest value within a stated reach."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import as_array, namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image.distance import checked_cap, column_offsets, mask_bytes

Whole = int | np.int64


def halo(reach: float) -> int:
    """Pixels beyond which a value cannot fill a void.

    Examples
    --------
    >>> from tilepipe_kernels.image.fill import halo
    >>> halo(2.5)
    2
    """
    return math.floor(reach)


def fill_voids(block: NDArray[Any], reach: float) -> NDArray[np.floating]:
    """Give every void the nearest value within ``reach``.

    Parameters
    ----------
    block
        Values, shape (rows, columns), any real dtype; NaN = void.
    reach
        Largest distance in pixels (Euclidean, between pixel centres) that is bridged; below 1 fills nothing.

    Returns
    -------
    ndarray of float64 for a float64 block, else of float32, shape (rows, columns)
        Values; of several nearest values that of the lowest row, then column; NaN where none is within reach.

    Raises
    ------
    ValueError
        When ``reach`` is negative or above 16000, or the block is not two-dimensional.

    Examples
    --------
    A void of three pixels between two heights, of which only those beside a height are within reach.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.fill import fill_voids
    >>> heights = np.array([[4.0, np.nan, np.nan, np.nan, 7.0]])
    >>> fill_voids(heights, reach=1).tolist()
    [[4.0, 4.0, nan, 7.0, 7.0]]
    >>> fill_voids(heights, reach=2).tolist()  # of two equally near values the one of the lower column
    [[4.0, 4.0, 4.0, 7.0, 7.0]]
    """
    given = as_array(block)
    xp = namespace(given)
    values = xp.array(given, dtype=given.dtype if given.dtype == np.float64 else np.float32)
    if values.ndim != 2:
        raise ValueError(f"block must have two dimensions (rows, columns), not {values.ndim}")
    if not reach >= 0:
        raise ValueError(f"reach must not be negative, not {reach}")
    void = xp.isnan(values)
    if reach < 1 or not void.any():
        return values
    far, limit = np.int16(checked_cap(halo(reach)) + 1), math.floor(reach * reach)
    if on_device(values):
        return device_form(__name__).fill(values, device_form(__name__).column_offsets(mask_bytes(void), far), limit)
    _fill(values, column_offsets(mask_bytes(void), far), limit)
    return values


@rule
def is_nearer(down: Whole, across: Whole, best: Whole, row: Whole, column: Whole) -> Any:
    """Whether a value at an offset is nearer than the best so far, at a distance² and offset; rows settle ties."""
    squared = down * down + across * across
    return squared < best or (squared == best and (down < row or (down == row and across < column)))


@loop
def _fill(values: NDArray[np.floating], vertical: NDArray[np.int16], limit: int) -> None:
    """Look along the row of each void, outwards, for the nearest value, whose row each column knows."""
    rows, columns = values.shape
    for i in range(rows):
        offsets = vertical[i]
        for j in range(columns):
            if offsets[j] == 0:
                continue
            best, row, column = limit + 1, np.int64(0), 0
            step = 0
            while step * step <= min(best, limit):
                for x in range(j - step, j + step + 1, max(1, 2 * step)):
                    if 0 <= x < columns:
                        down, across = np.int64(offsets[x]), x - j
                        if is_nearer(down, across, best, row, column):
                            best, row, column = int(down * down + across * across), down, across
                step += 1
            if best <= limit:
                values[i, j] = values[i + row, j + column]
