"""Exact Euclidean distance of mask pixels to the background, up to a cap that makes it a local kernel.

The transform is separable (Saito & Toriwaki 1994, "New algorithms for Euclidean distance transformation of an
n-dimensional digitized picture", Pattern Recognition 27): distances down the columns first, then along each
row the minimum of ``(column difference)² + (column distance)²``.  The row search stops as soon as the column
difference alone exceeds the best distance, so its cost per foreground pixel is its distance, and the
background costs nothing.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import as_array, namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule

LARGEST_CAP = 16_000
FEATURE_BITS = 32
_OFFSET_BITS = 16
_OFFSET_ZERO = 1 << 15
_OFFSET_MASK = (1 << 16) - 1
_ONE = np.int16(1)


def halo(cap: int) -> int:
    """Width in pixels beyond which the background cannot matter: the cap itself.

    Examples
    --------
    >>> from tilepipe_kernels.image.distance import halo
    >>> halo(30)
    30
    """
    return checked_cap(cap)


def checked_cap(cap: int) -> int:
    """Return `cap` as an int; ValueError unless it is a whole number of pixels in 1 .. LARGEST_CAP."""
    try:
        value = operator.index(cap)
    except TypeError:
        raise ValueError(f"cap must be a whole number of pixels, not {cap!r}") from None
    if not 1 <= value <= LARGEST_CAP:
        raise ValueError(f"cap must lie in 1 .. {LARGEST_CAP} pixels, not {value}")
    return value


def mask_bytes(mask: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a mask as contiguous uint8, 0 or 1; ValueError unless it is 2-D of bool or integers."""
    array = as_array(mask)
    if array.ndim != 2:
        raise ValueError(f"mask must have two dimensions (rows, columns), not {array.ndim}")
    if array.dtype.kind not in "biu":
        raise ValueError(f"mask must be bool or integer, not {array.dtype}; compare it with a threshold first")
    present: NDArray[np.bool_] = namespace(array).ascontiguousarray(array if array.dtype == np.bool_ else array != 0)
    return present.view(np.uint8)


def distance_squared(mask: NDArray[Any], cap: int) -> NDArray[np.int32]:
    """Squared Euclidean distance of every foreground pixel to the nearest background pixel, capped.

    Parameters
    ----------
    mask
        Shape (rows, columns), bool or integer; nonzero is foreground.
    cap
        Largest distance told apart, in pixels.

    Returns
    -------
    ndarray of int32, shape (rows, columns)
        Distance² between pixel centres in px², exact up to ``cap²``; ``cap² + 1`` for all that is farther; 0
        on the background.  Beyond the array lies neither: a region that runs off the raster has no edge
        there, so the axis of a street goes on to the raster's border instead of forking to its corners.

    Raises
    ------
    ValueError
        For a mask that is no 2-D array of bool or integers, or a cap outside 1 .. 16000.

    Examples
    --------
    The middle of a street three pixels wide is 2 pixels from its sides; the array's border is none of them.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.distance import distance_squared
    >>> street = np.array([[0, 0, 0, 0], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 1], [0, 0, 0, 0]])
    >>> distance_squared(street, cap=10)[:, 0].tolist()
    [0, 1, 4, 1, 0]
    >>> distance_squared(street, cap=1)[:, 0].tolist()  # farther than the cap: cap² + 1
    [0, 1, 2, 1, 0]
    """
    cap = checked_cap(cap)
    vertical = column_offsets(mask_bytes(mask), np.int16(cap + 1))
    squared = np.zeros(vertical.shape, np.int32)
    _row_distances(vertical, cap, squared)
    return squared


def nearest_background(mask: NDArray[Any], cap: int) -> tuple[NDArray[np.int32], NDArray[np.int16], NDArray[np.int16]]:
    """Distance transform with the nearest background pixel of every foreground pixel (feature transform).

    Parameters
    ----------
    mask, cap
        As for :func:`distance_squared`.

    Returns
    -------
    squared
        As from :func:`distance_squared`.
    row_offset, column_offset
        int16, shape (rows, columns): the nearest background pixel less the pixel itself.  Of several at the
        same distance the one of the lowest row, then of the lowest column.  Both 0 on the background and
        beyond the cap.

    Raises
    ------
    ValueError
        As `distance_squared`.

    Examples
    --------
    From each pixel of a street to the nearest pixel beside it: the upper row looks up, the lower row looks down.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.distance import nearest_background
    >>> squared, down, right = nearest_background(np.array([[0, 0], [1, 1], [1, 1], [0, 0]]), cap=5)
    >>> down.tolist()
    [[0, 0], [-1, -1], [1, 1], [0, 0]]
    """
    cap = checked_cap(cap)
    if on_device(mask):
        return device_form(__name__).nearest_background(mask_bytes(mask), cap)
    vertical = column_offsets(mask_bytes(mask), np.int16(cap + 1))
    squared = np.zeros(vertical.shape, np.int32)
    row_offset = np.zeros(vertical.shape, np.int16)
    column_offset = np.zeros(vertical.shape, np.int16)
    _row_features(vertical, cap, squared, row_offset, column_offset)
    return squared, row_offset, column_offset


@rule
def column_step(nearest: np.int16, far: np.int16, present: np.uint8) -> np.int16:
    """Rows to the nearest background that a walk along a column has seen, one pixel on; at most ``far``."""
    return np.int16(min(np.int16(nearest + _ONE), far) * np.int16(present))


@rule
def nearer_offset(above: np.int16, below: np.int16) -> np.int16:
    """The nearer of two row offsets, the upper one of two at the same distance."""
    return below if below < -above else above


@loop
def column_offsets(mask: NDArray[np.uint8], far: np.int16) -> NDArray[np.int16]:
    """Row offset to the nearest background in the pixel's column, the upper one of two; ±far if beyond."""
    rows, columns = mask.shape
    offsets = np.empty((rows, columns), np.int16)
    nearest = np.full(columns, far, np.int16)
    for i in range(rows):
        mask_row, offset_row = mask[i], offsets[i]
        for j in range(columns):
            nearest[j] = column_step(nearest[j], far, mask_row[j])
            offset_row[j] = -nearest[j]
    nearest[:] = far
    for i in range(rows - 1, -1, -1):
        mask_row, offset_row = mask[i], offsets[i]
        for j in range(columns):
            nearest[j] = column_step(nearest[j], far, mask_row[j])
            offset_row[j] = nearer_offset(offset_row[j], nearest[j])
    return offsets


@loop
def _row_distances(vertical: NDArray[np.int16], cap: int, squared: NDArray[np.int32]) -> None:
    """Least ``(column difference)² + (row offset)²`` along every row, for foreground pixels only."""
    rows, columns = vertical.shape
    far = np.int32(cap * cap + 1)
    # a margin of far values on both sides spares the search every test of the array's border
    heights = np.full(columns + 2 * cap, far, np.int32)
    for i in range(rows):
        offset_row, squared_row = vertical[i], squared[i]
        for j in range(columns):
            heights[cap + j] = np.int32(offset_row[j]) * np.int32(offset_row[j])
        for j in range(columns):
            if offset_row[j] == 0:
                continue
            best = min(heights[cap + j], far)
            reach = np.int32(1)
            while reach * reach < best:
                nearer = min(heights[cap + j - reach], heights[cap + j + reach])
                best = min(best, np.int32(nearer + reach * reach))
                reach += np.int32(1)
            squared_row[j] = best


@rule
def feature_key(offset: np.int16) -> np.int64:
    """Distance² and offsets of a background pixel in the same column, as a number whose order settles the ties."""
    row = np.int64(offset)
    return ((row * row) << FEATURE_BITS) + (((row + _OFFSET_ZERO) << _OFFSET_BITS) + _OFFSET_ZERO)


@rule
def shifted_key(key: np.int64, reach: np.int64, across: np.int64) -> np.int64:
    """Key as seen from a pixel ``reach`` columns away; ``across`` is the signed column offset."""
    return key + ((reach * reach) << FEATURE_BITS) + across


@rule
def feature_offsets(key: np.int64) -> tuple[np.int64, np.int64]:
    """Row and column offset of a key."""
    return ((key >> _OFFSET_BITS) & _OFFSET_MASK) - _OFFSET_ZERO, (key & _OFFSET_MASK) - _OFFSET_ZERO


@loop
def _row_features(
    vertical: NDArray[np.int16],
    cap: int,
    squared: NDArray[np.int32],
    row_offset: NDArray[np.int16],
    column_offset: NDArray[np.int16],
) -> None:
    """As `_row_distances`, on keys (distance², row offset, column offset) whose order settles the ties."""
    rows, columns = vertical.shape
    far = np.int64(cap * cap + 1) << FEATURE_BITS
    keys = np.full(columns + 2 * cap, far, np.int64)
    for i in range(rows):
        offset_row = vertical[i]
        for j in range(columns):
            keys[cap + j] = feature_key(offset_row[j])
        for j in range(columns):
            if offset_row[j] == 0:
                continue
            best = min(keys[cap + j], far)
            reach = np.int64(1)
            while (reach * reach) << FEATURE_BITS <= best:
                left = shifted_key(keys[cap + j - reach], reach, -reach)
                best = min(best, left, shifted_key(keys[cap + j + reach], reach, reach))
                reach += 1
            squared[i, j] = best >> FEATURE_BITS
            if best != far:
                row_offset[i, j], column_offset[i, j] = feature_offsets(best)
