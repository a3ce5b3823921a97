"""Means over regions of the height above the ground and of the logarithm of a measure, summed in whole numbers.

Every sum is exact, so the means depend neither on the order of the pixels nor on where a block begins.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import loop

LEAST, MOST = 0.02, 8.0
"""Metres that a measure counts as where it is less or more: the noise of a scan, and a storey or two."""

_FRACTION = 1 << 23
_BIAS = 127
_LEAST_BITS, _MOST_BITS = (int(np.float32(limit).view(np.int32)) for limit in (LEAST, MOST))
_INFINITE_BITS = int(np.float32(np.inf).view(np.int32))

Labels = NDArray[np.int32]
Floats = NDArray[np.float32]


@loop
def _sum_bits(labels: Labels, bits: NDArray[np.int32], total: NDArray[np.int64], known: NDArray[np.int64]) -> None:
    """The bits of a positive float, read as a whole number, are its logarithm but for a curve of less than 0.09."""
    for i in range(labels.shape[0]):
        row, values = labels[i], bits[i]
        for j in range(row.size):
            here = np.int64(values[j] >= 0) & np.int64(values[j] < _INFINITE_BITS)
            total[row[j]] += here * min(max(values[j], _LEAST_BITS), _MOST_BITS)
            known[row[j]] += here


def mean_logarithms(labels: Labels, values: Floats, count: int) -> Floats:
    """Mean natural logarithm of a measure in each region.

    The logarithm is that of Mitchell 1962, "Computer multiplication and division using binary logarithms", IRE Trans.
    Electronic Computers EC-11: the base-2 one, linear between powers of two, which is exact in integers.

    Parameters
    ----------
    labels
        int32, shape (rows, columns): 1 … ``count``; 0 belongs to no region.
    values
        A measure ≥ 0, float32, same shape; NaN is left out.
    count
        Number of regions.

    Returns
    -------
    ndarray of float32, shape (count,)
        Of the measure limited to `LEAST` … `MOST`; NaN where no pixel of a region knows it.

    Raises
    ------
    ValueError
        For shapes that differ or labels out of range.
    """
    labels, values = _checked(labels, values, count)
    total, known = np.zeros((2, count + 1), np.int64)
    # + 0 turns a negative zero, whose bits are negative, into a positive one
    _sum_bits(labels, (values + np.float32(0)).view(np.int32), total, known)
    mean = np.full(count, np.nan)
    np.divide(total[1:], known[1:], out=mean, where=known[1:] > 0)
    return ((mean / _FRACTION - _BIAS) * math.log(2)).astype(np.float32)


@loop
def _sum_above(
    labels: Labels, ticks: NDArray[np.int32], ground: Floats, scale: float, total: NDArray[np.int64]
) -> None:
    for i in range(labels.shape[0]):
        row, heights, earth = labels[i], ticks[i], ground[i]
        for j in range(row.size):
            if row[j] > 0:
                total[row[j]] += heights[j] - np.int64(np.rint(np.float64(earth[j]) * scale))


def mean_above(
    labels: Labels, ticks: NDArray[np.int32], ground: Floats, pixels: NDArray[Any], ticks_per_metre: float
) -> Floats:
    """Mean height above the ground of each region.

    Parameters
    ----------
    labels
        int32, shape (rows, columns): 1 … n; 0 belongs to no region.
    ticks
        Heights in whole ticks, int32, same shape, known wherever a label is.
    ground
        Height of the ground in metres, float32, same shape, finite wherever a label is.
    pixels
        Number of pixels of each region, shape (n,).
    ticks_per_metre
        Ticks in a metre.

    Returns
    -------
    ndarray of float32, shape (n,)
        In metres.

    Raises
    ------
    ValueError
        For shapes that differ or labels out of range.
    """
    labels, ground = _checked(labels, ground, pixels.size)
    if ticks.shape != labels.shape:
        raise ValueError(f"labels and ticks must have one shape (rows, columns), not {labels.shape}, {ticks.shape}")
    total = np.zeros(pixels.size + 1, np.int64)
    _sum_above(labels, np.ascontiguousarray(ticks, np.int32), ground, float(ticks_per_metre), total)
    return (total[1:] / (pixels * float(ticks_per_metre))).astype(np.float32)


def _checked(labels: Labels, values: Floats, count: int) -> tuple[Labels, Floats]:
    labels, values = np.ascontiguousarray(labels, np.int32), np.ascontiguousarray(values, np.float32)
    if labels.ndim != 2 or values.shape != labels.shape:
        raise ValueError(f"labels and values must have one shape (rows, columns), not {labels.shape}, {values.shape}")
    if labels.size and not (labels.min() >= 0 and labels.max() <= count):
        raise ValueError(f"labels must lie in 0..{count}")
    return labels, values
