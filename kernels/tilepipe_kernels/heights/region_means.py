"""Means over regions of the height above the ground and of the logarithm of a measure, summed in whole numbers.

Every sum is exact, so the means depend neither on the order of the pixels nor on where a block begins.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.rounding import nearest_integer

LEAST, MOST = 0.02, 8.0
"""Metres that a measure counts as where it is less or more: the noise of a scan, and a storey or two."""

_FRACTION = 1 << 23
_BIAS = 127
_LEAST_BITS, _MOST_BITS = (int(np.float32(limit).view(np.int32)) for limit in (LEAST, MOST))
_INFINITE_BITS = int(np.float32(np.inf).view(np.int32))

Labels = NDArray[np.int32]
Floats = NDArray[np.float32]


@rule
def measured_bits(bits: np.int32) -> tuple[np.int64, np.int64]:
    """Bits of a limited measure, and 1; 0 and 0 for bits that are none.

    The bits of a positive float, read as a whole number, are its logarithm but for a curve of less than 0.09.
    """
    known = np.int64(bits >= 0) & np.int64(bits < _INFINITE_BITS)
    limited: Any = min(max(bits, _LEAST_BITS), _MOST_BITS)
    return known * limited, known


@loop
def _sum_bits(labels: Labels, bits: NDArray[np.int32], total: NDArray[np.int64], known: NDArray[np.int64]) -> None:
    for i in range(labels.shape[0]):
        row, values = labels[i], bits[i]
        for j in range(row.size):
            value, one = measured_bits(values[j])
            total[row[j]] += value
            known[row[j]] += one


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
        Of the measure limited to `LEAST` … `MOST`; NaN where no pixel of a region knows it.  Arrays of a device
        stay there.

    Raises
    ------
    ValueError
        For shapes that differ or labels out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.heights.region_means import mean_logarithms
    >>> labels = np.array([[1, 1, 2, 0]], np.int32)
    >>> mean_logarithms(labels, np.array([[0.5, 2.0, 1.0, 9.0]], np.float32), count=2).tolist()  # ln ½ + ln 2 = 0
    [0.0, 0.0]
    """
    labels, values = _checked(labels, values, count)
    # + 0 turns a negative zero, whose bits are negative, into a positive one
    bits = (values + np.float32(0)).view(np.int32)
    if on_device(labels, bits):
        total, known = device_form(__name__).sum_bits(labels, bits, count)
    else:
        total, known = np.zeros((2, count + 1), np.int64)
        _sum_bits(labels, bits, total, known)
    xp = namespace(total)
    mean = xp.where(known > 0, total / xp.maximum(known, 1), np.nan)[1:]
    return ((mean / _FRACTION - _BIAS) * math.log(2)).astype(np.float32)


@rule
def ticks_above(height: np.int32, ground: np.float32, scale: float) -> np.int64:
    """Ticks from the ground, in metres, up to a height in ticks."""
    return np.int64(height) - nearest_integer(np.float64(ground) * scale)


@loop
def _sum_above(
    labels: Labels, ticks: NDArray[np.int32], ground: Floats, scale: float, total: NDArray[np.int64]
) -> None:
    for i in range(labels.shape[0]):
        row, heights, earth = labels[i], ticks[i], ground[i]
        for j in range(row.size):
            if row[j] > 0:
                total[row[j]] += ticks_above(heights[j], earth[j], scale)


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
        In metres.  Arrays of a device stay there.

    Raises
    ------
    ValueError
        For shapes that differ or labels out of range.

    Examples
    --------
    A roof of two pixels, 6 m and 7 m above the ground, with heights in millimetres.

    >>> import numpy as np
    >>> from tilepipe_kernels.heights.region_means import mean_above
    >>> labels, ticks = np.array([[1, 1, 0]], np.int32), np.array([[106_000, 107_000, 100_000]], np.int32)
    >>> mean_above(labels, ticks, np.full((1, 3), 100, np.float32), np.array([2]), ticks_per_metre=1000).tolist()
    [6.5]
    """
    labels, ground = _checked(labels, ground, pixels.size)
    if ticks.shape != labels.shape:
        raise ValueError(f"labels and ticks must have one shape (rows, columns), not {labels.shape}, {ticks.shape}")
    ticks = namespace(ticks).ascontiguousarray(ticks, dtype=np.int32)
    if on_device(labels, ticks, ground):
        total = device_form(__name__).sum_above(labels, ticks, ground, float(ticks_per_metre), pixels.size)
    else:
        total = np.zeros(pixels.size + 1, np.int64)
        _sum_above(labels, ticks, ground, float(ticks_per_metre), total)
    return (total[1:] / (pixels * float(ticks_per_metre))).astype(np.float32)


def _checked(labels: Labels, values: Floats, count: int) -> tuple[Labels, Floats]:
    xp = namespace(labels, values)
    labels = xp.ascontiguousarray(labels, dtype=np.int32)
    values = xp.ascontiguousarray(values, dtype=np.float32)
    if labels.ndim != 2 or values.shape != labels.shape:
        raise ValueError(f"labels and values must have one shape (rows, columns), not {labels.shape}, {values.shape}")
    if labels.size and not (labels.min() >= 0 and labels.max() <= count):
        # on a device these are the scalars read before the work: labels are indices in what follows
        raise ValueError(f"labels must lie in 0..{count}")
    return labels, values
