"""Gaussian smoothing and Gaussian partial derivatives up to second order of an image with nodata."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.image.gaussian_passes import (
    CELL,
    CELL_ROWS,
    STRIP,
    Floats,
    Taps,
    around_row,
    cell_derivatives,
    fill_strip,
    gaussian_taps,
    kernel_radius,
    smooth_cell,
    smooth_row,
    strip_buffer,
)

_GRIDS = f"{__package__}.gaussian"


@loop
def _copy(given: Floats, into: Floats) -> None:
    """The first values; the assignment of a slice costs several times as much."""
    for j in range(into.size):
        into[j] = given[j]


@loop
def _derivatives_strip(block: Floats, column: int, taps: Taps, buffers: Floats, images: Floats) -> None:
    """Write one strip of the five derivative images (r_x, r_y, r_xx, r_xy, r_yy)."""
    rows, columns = block.shape
    radius = taps.smooth.size - 1
    width = min(STRIP, columns - column)
    cell = np.empty(5 * CELL, np.float32)
    done = -radius
    for row in range(0, rows, CELL_ROWS):
        fill_strip(block, column, taps, done, row + CELL_ROWS + radius, buffers)
        done = row + CELL_ROWS + radius
        cell_derivatives(buffers, row, taps, cell)
        for slot, image in enumerate((1, 4, 0, 3, 2)):
            for i in range(min(CELL_ROWS, rows - row)):
                _copy(cell[slot * CELL + i * STRIP :], images[image, row + i, column : column + width])


@loop
def _smooth_strip(
    block: Floats, column: int, smooth: Floats, active: NDArray[np.uint8], buffer: Floats, image: Floats
) -> None:
    """Write the active cells of one strip of the smoothed image."""
    rows, columns = block.shape
    radius = smooth.size - 1
    width = min(STRIP, columns - column)
    padded, cell = np.empty(STRIP + 2 * radius, np.float32), np.empty(CELL, np.float32)
    done = -radius
    for row in range(0, rows, CELL_ROWS):
        if active[row // CELL_ROWS] == 0:
            continue
        for source in range(max(done, row - radius), row + CELL_ROWS + radius):
            around = around_row(block, source, column, radius, padded)
            smooth_row(around, smooth, buffer[(source + radius) * STRIP :])
        done = row + CELL_ROWS + radius
        smooth_cell(buffer, (row + radius) * STRIP, smooth, cell)
        for i in range(min(CELL_ROWS, rows - row)):
            _copy(cell[i * STRIP :], image[row + i, column : column + width])


def as_block(block: NDArray[Any]) -> Floats:
    """Check that ``block`` is a real, non-empty image; return it as C-contiguous float32 (NaN = nodata) where it is."""
    array = block if on_device(block) else np.asarray(block)
    if array.ndim != 2 or array.size == 0:
        raise ValueError(f"block has shape {array.shape}: give one image of shape (rows, columns)")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"block has dtype {array.dtype}: give real numbers")
    image: Floats = namespace(array).ascontiguousarray(array, dtype=np.float32)
    return image


def fill_nodata(block: Floats, sigma: float) -> tuple[Floats, NDArray[np.bool_] | None]:
    """Fill nodata pixels within kernel reach of data by the Gaussian mean of their valid neighbours.

    Every valid pixel then has derivatives, and what is filled carries no edge of its own (normalised
    convolution, Knutsson & Westin 1993).  Pixels out of reach stay NaN; no valid pixel's kernel reaches them.

    Parameters
    ----------
    block
        float32 image; NaN and infinities are nodata.  An array of a device stays there.
    sigma
        Scale in pixels.

    Returns
    -------
    filled, valid
        float32 image and bool image, or the block itself and None when nothing is missing.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.gaussian import fill_nodata
    >>> block = np.full((5, 5), 80, np.float32)
    >>> block[2, 2] = np.nan
    >>> filled, valid = fill_nodata(block, sigma=1.0)
    >>> round(float(filled[2, 2]), 3), bool(valid[2, 2])
    (80.0, False)
    """
    valid = namespace(block).isfinite(block)
    # the one number that a device array is asked for: most images need no work and no memory
    if bool(valid.all()):
        return block, None
    if on_device(block):
        return device_form(_GRIDS).fill(block, sigma), valid
    from scipy import ndimage  # a tenth of a second that most runs need not spend

    half = gaussian_taps(sigma).smooth.astype(np.float64)
    kernel = np.concatenate([half[:0:-1], half])

    def smoothed(image: NDArray[Any]) -> NDArray[np.float64]:
        along = ndimage.correlate1d(image.astype(np.float64), kernel, axis=1, mode="constant")
        both: NDArray[np.float64] = ndimage.correlate1d(along, kernel, axis=0, mode="constant")
        return both

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = smoothed(np.where(valid, block, 0)) / smoothed(valid)
    return np.where(valid, block, mean).astype(np.float32), valid


def gaussian_derivatives(block: NDArray[Any], sigma: float) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """First and second partial derivatives of the Gaussian-smoothed block.

    Parameters
    ----------
    block
        Image (rows, columns) of real numbers; the border is replicated; NaN within the kernel gives NaN.
        An array of a device stays there; the derivatives are the same to the bit.
    sigma
        Scale in pixels; the kernels end at ``ceil(4 sigma)``.

    Returns
    -------
    r_x, r_y, r_xx, r_xy, r_yy
        float32 images of the block's shape, in grey per pixel and grey per pixel²; x along columns (to the
        right), y along rows (downward).

    Raises
    ------
    ValueError
        If the block is not a non-empty real image or sigma is not positive.

    Examples
    --------
    A surface that rises by 3 in each column to the right and falls by 2 in each row downward.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.gaussian import gaussian_derivatives
    >>> rows, columns = np.mgrid[:21, :21]
    >>> r_x, r_y, *second = gaussian_derivatives(100 + 3 * columns - 2 * rows, sigma=1.5)
    >>> round(float(r_x[10, 10]), 3), round(float(r_y[10, 10]), 3)
    (3.0, -2.0)
    >>> bool(np.abs(second)[:, 10, 10].max() < 1e-3)  # a plane has no curvature
    True
    """
    image = as_block(block)
    if on_device(image):
        images = device_form(_GRIDS).derivatives(image, sigma)
        return images[0], images[1], images[2], images[3], images[4]
    taps = gaussian_taps(sigma)
    buffers = strip_buffer(image.shape[0], kernel_radius(sigma), 3)
    images = np.empty((5, *image.shape), np.float32)
    for column in range(0, image.shape[1], STRIP):
        _derivatives_strip(image, column, taps, buffers, images)
    return images[0], images[1], images[2], images[3], images[4]


def gaussian_smooth(block: Floats, sigma: float, active: NDArray[np.uint8] | None = None) -> Floats:
    """Gaussian-smoothed block with replicated border, float32.

    Parameters
    ----------
    block
        float32 image (rows, columns), C-contiguous.  An array of a device stays there.
    sigma
        Scale in pixels.
    active
        Cells wanted, uint8 (strips, cells down a strip); pixels of other cells are undefined.  None: all; a
        device always makes all.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        NaN wherever the kernel reaches a NaN.

    Examples
    --------
    The edge between a dark and a bright half becomes a ramp; far from it nothing changes.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.gaussian import gaussian_smooth
    >>> block = np.repeat(np.float32([[0, 0, 0, 0, 0, 100, 100, 100, 100, 100]]), 3, axis=0)
    >>> gaussian_smooth(block, sigma=1.0)[1].round().astype(int).tolist()
    [0, 0, 0, 6, 30, 70, 94, 100, 100, 100]
    """
    if on_device(block):
        smoothed: Floats = device_form(_GRIDS).smooth(block, sigma)
        return smoothed
    rows, columns = block.shape
    if active is None:
        active = np.ones((-(-columns // STRIP), -(-rows // CELL_ROWS)), np.uint8)
    smooth = gaussian_taps(sigma).smooth
    buffer = strip_buffer(rows, kernel_radius(sigma), 1)[0]
    image = np.empty((rows, columns), np.float32)
    for strip in range(active.shape[0]):
        if active[strip].any():
            _smooth_strip(block, strip * STRIP, smooth, active[strip], buffer, image)
    return image


def halo(sigma: float) -> int:
    """Pixels around a block on which its derivatives depend: the kernel radius.

    Examples
    --------
    >>> from tilepipe_kernels.image.gaussian import halo
    >>> halo(1.6)
    7
    """
    return kernel_radius(sigma)
