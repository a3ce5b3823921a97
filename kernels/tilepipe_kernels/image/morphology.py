"""Cleaning of street masks: opening and closing by exact discs, filling of specks; all of bounded reach.

Arrays of a device stay there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import image_filters, namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.image.distance import mask_bytes


def halo(radius: float) -> int:
    """Pixels around a block that `open_mask` and `close_mask` can depend on: two discs.

    Examples
    --------
    >>> from tilepipe_kernels.image.morphology import halo
    >>> halo(2.5)
    6
    """
    return 2 * _reach(radius)


def speck_halo(size: int) -> int:
    """Pixels around a block that `fill_specks` can depend on."""
    return size


def open_mask(mask: NDArray[Any], radius: float) -> NDArray[np.bool_]:
    """Remove what a disc does not fit into: erosion, then dilation, by all offsets with d <= radius.

    Parameters
    ----------
    mask
        Shape (rows, columns), bool or integer; nonzero is foreground.
    radius
        Radius of the disc in pixels, 0 or more; 0 changes nothing.

    Returns
    -------
    ndarray of bool, shape (rows, columns)
        Union of all discs inside the mask.  Beyond the array lies neither foreground nor background.

    Raises
    ------
    ValueError
        For a mask that is no 2-D array of bool or integers, or a negative radius.

    Examples
    --------
    A driveway one pixel wide goes, the street beside it stays.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.morphology import open_mask
    >>> mask = np.array([[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [1, 1, 1, 1, 1], [1, 1, 1, 0, 0]])
    >>> open_mask(mask, radius=1).astype(int)
    array([[1, 1, 1, 0, 0],
           [1, 1, 1, 0, 0],
           [1, 1, 1, 1, 0],
           [1, 1, 1, 0, 0]])
    """
    return _dilated(_eroded(mask_bytes(mask), radius).view(np.uint8), radius)


def dilate_mask(mask: NDArray[Any], radius: float) -> NDArray[np.bool_]:
    """Add to a mask all that lies within a distance of it.

    Parameters, result and errors are those of `open_mask`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.morphology import dilate_mask
    >>> dilate_mask(np.array([[0, 0, 0, 0, 1]]), radius=2).astype(int).tolist()
    [[0, 0, 1, 1, 1]]
    """
    return _dilated(mask_bytes(mask), radius)


def close_mask(mask: NDArray[Any], radius: float) -> NDArray[np.bool_]:
    """Fill gaps that a disc does not fit into: the opening of the background.

    Parameters, result and errors are those of `open_mask`.

    Examples
    --------
    A gap of one pixel across a street is bridged.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.morphology import close_mask
    >>> street = np.array([[0] * 7, [1, 1, 1, 0, 1, 1, 1], [1, 1, 1, 0, 1, 1, 1], [1, 1, 1, 0, 1, 1, 1], [0] * 7])
    >>> close_mask(street, radius=1).astype(int)
    array([[1, 1, 0, 0, 0, 1, 1],
           [1, 1, 1, 0, 1, 1, 1],
           [1, 1, 1, 1, 1, 1, 1],
           [1, 1, 1, 0, 1, 1, 1],
           [1, 1, 0, 0, 0, 1, 1]])
    """
    return _eroded(_dilated(mask_bytes(mask), radius).view(np.uint8), radius)


def fill_specks(mask: NDArray[Any], size: int) -> NDArray[np.bool_]:
    """Fill small holes: 4-connected parts of the background whose bounding box fits in ``size × size``.

    The bounding box, unlike the area, is bounded in reach, so that the result does not depend on the tiling.

    Parameters
    ----------
    mask
        Shape (rows, columns), bool or integer; nonzero is foreground.
    size
        Side of the square window, in pixels.

    Returns
    -------
    ndarray of bool, shape (rows, columns)
        The mask and its specks.  A part that touches the array's border is no hole and stays.

    Raises
    ------
    ValueError
        For a mask that is no 2-D array of bool or integers, or a size below 1.

    Examples
    --------
    A car leaves a hole of 1 × 2 pixels in a street; a size of 2 fills it, a size of 1 does not.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.morphology import fill_specks
    >>> street = np.array([[1, 1, 1, 1], [1, 0, 0, 1], [1, 1, 1, 1]])
    >>> fill_specks(street, size=2).tolist() == [[True] * 4] * 3
    True
    >>> fill_specks(street, size=1).astype(int).tolist()
    [[1, 1, 1, 1], [1, 0, 0, 1], [1, 1, 1, 1]]
    """
    if size < 1:
        raise ValueError(f"size must be 1 pixel or more, not {size}")
    if on_device(mask):
        return device_form(__name__).fill_specks(mask_bytes(mask), size).view(np.bool_)
    filled = mask_bytes(mask).copy()
    if filled.size:
        _fill_specks(filled, size)
    return filled.view(np.bool_)


def grey_halo(half_width: int) -> int:
    """Pixels around a block that `open_grey` can depend on: two squares."""
    return 2 * half_width


def open_grey(block: NDArray[Any], half_width: int) -> NDArray[np.float32]:
    """Grey opening by a square: the highest surface below the block into which the square fits everywhere.

    Of heights it leaves the ground and takes away what is narrower than the square, such as trees and roofs.

    Parameters
    ----------
    block
        Heights, shape (rows, columns), any real dtype; NaN is ignored.
    half_width
        The square has 2 * half_width + 1 pixels a side.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        The opening; NaN where a whole square around a pixel is missing.

    Raises
    ------
    ValueError
        When the block is not two-dimensional or `half_width` is negative.

    Examples
    --------
    A house two pixels wide stands on ground that rises to the right.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.morphology import open_grey
    >>> profile = [10, 10, 18, 18, 11, 11, 11, 12, 12]
    >>> open_grey(np.array([profile] * 3), half_width=1)[1].tolist()
    [10.0, 10.0, 11.0, 11.0, 11.0, 11.0, 11.0, 12.0, 12.0]
    """
    xp, filters = namespace(block), image_filters(block)
    values = xp.asarray(block, xp.float32)
    if values.ndim != 2 or half_width < 0:
        raise ValueError(
            f"opening needs a two-dimensional block and half_width >= 0, not {values.ndim} and {half_width}"
        )
    size, missing = 2 * half_width + 1, xp.isnan(values)
    lowest = filters.minimum_filter(xp.where(missing, xp.float32(np.inf), values), size, mode="nearest")
    opened = filters.maximum_filter(xp.where(xp.isinf(lowest), -lowest, lowest), size, mode="nearest")
    result: NDArray[np.float32] = xp.where(xp.isinf(opened), xp.float32(np.nan), opened)
    return result


def _reach(radius: float) -> int:
    if not 0 <= radius < math.inf:
        raise ValueError(f"radius must be 0 pixels or more, not {radius}")
    return math.ceil(radius)


def _eroded(mask: NDArray[np.uint8], radius: float) -> NDArray[np.bool_]:
    return ~_dilated(mask ^ np.uint8(1), radius)


def _dilated(mask: NDArray[np.uint8], radius: float) -> NDArray[np.bool_]:
    _reach(radius)
    # the disc as its rows: half their widths, for the row of the centre and those below it
    below = np.arange(math.floor(radius) + 1)
    half_widths = np.floor(np.sqrt(radius * radius - below**2)).astype(np.int64)
    if on_device(mask):
        return device_form(__name__).dilate(mask, half_widths).view(np.bool_)
    dilated = np.zeros(mask.shape, np.uint8)
    _dilate(mask, half_widths, dilated)
    return dilated.view(np.bool_)


@loop
def _dilate(mask: NDArray[np.uint8], half_widths: NDArray[np.int64], dilated: NDArray[np.uint8]) -> None:
    """Union of the mask shifted by every offset of a disc, row by row: as many fast byte operations as offsets."""
    rows, columns = mask.shape
    for i in range(rows):
        result = dilated[i]
        for down in range(1 - half_widths.size, half_widths.size):
            if 0 <= i + down < rows:
                source, width = mask[i + down], half_widths[abs(down)]
                for shift in range(-width, width + 1):
                    start, stop = max(0, -shift), min(columns, columns - shift)
                    into, given = result[start:stop], source[start + shift : stop + shift]
                    for j in range(into.size):
                        into[j] |= given[j]


@loop
def _fill_specks(mask: NDArray[np.uint8], size: int) -> None:
    """Flood every hole from its first pixel, within the square that it must fit in."""
    rows, columns = mask.shape
    seen = np.zeros((size, 2 * size - 1), np.uint8)
    pixels = np.empty((seen.size, 2), np.int64)
    for i in range(1, rows - 1):
        for j in range(1, columns - 1):
            if mask[i, j] == 0 and mask[i - 1, j] != 0 and mask[i, j - 1] != 0:
                for k in range(_flood(mask, i, j, size, seen, pixels)):
                    mask[pixels[k, 0], pixels[k, 1]] = 1


@loop
def _flood(
    mask: NDArray[np.uint8], row: int, column: int, size: int, seen: NDArray[np.uint8], pixels: NDArray[np.int64]
) -> int:
    """Collect the background around its first pixel in row-major order; 0 if it is not that or does not fit."""
    rows, columns = mask.shape
    seen[:] = 0
    seen[0, size - 1] = 1
    pixels[0, 0], pixels[0, 1] = row, column
    found, done, left, right = 1, 0, column, column
    while done < found:
        i, j = pixels[done, 0], pixels[done, 1]
        done += 1
        left, right = min(left, j), max(right, j)
        if right - left >= size or i == 0 or j == 0 or i == rows - 1 or j == columns - 1:
            return 0
        for down, across in ((-1, 0), (0, -1), (0, 1), (1, 0)):
            y, x = i + down, j + across
            if mask[y, x] == 0:
                if y < row or y - row >= size or abs(x - column) >= size:
                    return 0
                if seen[y - row, x - column + size - 1] == 0:
                    seen[y - row, x - column + size - 1] = 1
                    pixels[found, 0], pixels[found, 1] = y, x
                    found += 1
    return found
