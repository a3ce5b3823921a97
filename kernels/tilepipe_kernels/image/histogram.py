"""Grey levels of a whole raster from integer histograms, which add up over tiles in any order.

A float32 is counted by the leading bits of its ordered bit pattern, so one set of bins serves 8-bit, 16-bit and float
rasters of any range with a relative width of 2⁻¹⁰, and no first look at the range is needed.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule

_SHIFT = 13
BINS = 1 << (32 - _SHIFT)
"""Number of bins of a histogram."""

_SIGN = np.uint32(0x80000000)
_ALL = np.uint32(0xFFFFFFFF)


@rule
def bin_of(bits: np.uint32, value: np.float32) -> np.uint32:
    """Bin of a value that is not NaN, given its bit pattern."""
    pattern = bits if value != 0 else np.uint32(0)  # minus zero is zero
    ordered = (pattern ^ _ALL) if pattern & _SIGN else (pattern ^ _SIGN)
    return np.uint32(ordered >> np.uint32(_SHIFT))


@loop
def _count(bits: NDArray[np.uint32], values: NDArray[np.float32], counts: NDArray[np.int64]) -> None:
    for i in range(bits.size):
        if values[i] == values[i]:
            counts[bin_of(bits[i], values[i])] += 1


def histogram(block: NDArray[Any]) -> NDArray[np.int64]:
    """Count the values of a block in bins that are the same for every raster.

    Parameters
    ----------
    block
        Values of any real dtype, converted to float32; NaN is not counted.

    Returns
    -------
    ndarray of int64, shape (BINS,)
        Counts; the bins are ordered by value.

    Examples
    --------
    Histograms of tiles add up to that of the raster.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import bin_values, histogram
    >>> counts = histogram(np.array([7.0, 7.0, 90.0])) + histogram(np.array([[7.0, np.nan]]))
    >>> filled = np.flatnonzero(counts)
    >>> bin_values(filled).tolist(), counts[filled].tolist()
    ([7.0, 90.0], [3, 1])
    """
    if on_device(block):
        return device_form(__name__).histogram(block)
    values = np.ascontiguousarray(block, dtype=np.float32).reshape(-1)
    counts = np.zeros(BINS, np.int64)
    _count(values.view(np.uint32), values, counts)
    return counts


def bin_values(bins: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Smallest value of each bin: exact for integers of up to ten bits.

    Parameters
    ----------
    bins
        Numbers of bins of `histogram`, integers of any shape, 0 … `BINS` - 1.

    Returns
    -------
    ndarray of float32, shape of ``bins``
        In the unit of the values that were counted.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import bin_values, histogram
    >>> bin_values(np.flatnonzero(histogram(np.array([-2.5, 0.0, 255.0])))).tolist()
    [-2.501952886581421, 0.0, 255.0]
    """
    ordered = bins.astype(np.uint32) << np.uint32(_SHIFT)
    pattern = np.where(ordered & _SIGN, ordered ^ _SIGN, ordered ^ _ALL).astype(np.uint32)
    return pattern.view(np.float32)


def percentile(counts: NDArray[np.int64], percent: float) -> float:
    """Value below or at which ``percent`` of the counted values lie (lower bin edge).

    Parameters
    ----------
    counts
        Counts of `histogram`, int64, shape (`BINS`,).
    percent
        0–100.

    Returns
    -------
    float
        In the unit of the values that were counted.

    Raises
    ------
    ValueError
        When nothing was counted, or ``percent`` is not within 0–100.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import histogram, percentile
    >>> counts = histogram(np.arange(1, 101))
    >>> percentile(counts, 2), percentile(counts, 50), percentile(counts, 98)
    (2.0, 50.0, 98.0)
    """
    if not 0 <= percent <= 100:
        raise ValueError(f"percent must lie in 0 .. 100, not {percent}")
    cumulative = np.cumsum(counts)
    if cumulative[-1] == 0:
        raise ValueError("the histogram is empty")
    target = max(1, int(np.ceil(cumulative[-1] * percent / 100.0)))
    return float(bin_values(np.array([np.searchsorted(cumulative, target)]))[0])


def otsu_classes(counts: NDArray[np.int64]) -> tuple[int, float, float]:
    """Split a histogram of equally wide bins in two classes (Otsu 1979).

    Parameters
    ----------
    counts
        Integers, shape (bins,).

    Returns
    -------
    tuple of int, float and float
        Last bin of the lower class, and the mean bin of the lower and of the upper class.

    Raises
    ------
    ValueError
        When fewer than two bins are filled.

    Examples
    --------
    Two heaps of grey levels, about bin 1 and about bin 6.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import otsu_classes
    >>> otsu_classes(np.array([5, 20, 5, 0, 0, 3, 12, 3]))
    (2, 1.0, 6.0)
    """
    if np.count_nonzero(counts) < 2:
        raise ValueError("the raster holds a single grey value")
    # float64 throughout: in float32, as scikit-image counts, the split of a city's billions of pixels strays
    bins = np.arange(counts.size, dtype=np.float64)
    weight = np.cumsum(counts).astype(np.float64)
    moment = np.cumsum(counts * bins)
    lower, upper = weight[:-1], weight[-1] - weight[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        separation = np.where(
            (lower > 0) & (upper > 0),
            lower * upper * (moment[:-1] / lower - (moment[-1] - moment[:-1]) / upper) ** 2,
            -1.0,
        )
    split = int(np.argmax(separation))
    below, above = moment[split] / weight[split], (moment[-1] - moment[split]) / (weight[-1] - weight[split])
    return split, float(below), float(above)


def class_means(counts: NDArray[np.int64], classes: int) -> NDArray[np.float64]:
    """Means of the classes of least variance within them (Fisher 1958; for two classes Otsu 1979).

    Parameters
    ----------
    counts
        Counts of equally wide bins; the cost grows with the square of their number.
    classes
        Number of classes, 2 or more.

    Returns
    -------
    ndarray of float64, shape (classes,)
        Mean bin of each class, ascending.

    Raises
    ------
    ValueError
        When fewer bins are filled than classes are asked for.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import class_means
    >>> class_means(np.array([5, 20, 5, 0, 0, 3, 12, 3, 0, 0, 9]), classes=3).tolist()
    [1.0, 6.0, 10.0]
    """
    filled = np.flatnonzero(counts)
    if not 2 <= classes <= filled.size:
        raise ValueError(f"{classes} classes need as many different values, not {filled.size}")
    weight, value = counts[filled].astype(np.float64), filled.astype(np.float64)
    n, total, square = (np.concatenate([[0.0], np.cumsum(weight * value**power)]) for power in range(3))
    first, last = np.ogrid[: filled.size + 1, : filled.size + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (total[last] - total[first]) / (n[last] - n[first])
        within = square[last] - square[first] - mean * (total[last] - total[first])
    within = np.where(first < last, within, np.inf)
    # least[j]: smallest sum within so many classes of the first j values; cuts: where the last of them begins
    least, cuts = within[0], []
    for _ in range(classes - 1):
        sums = least[:, None] + within
        cuts.append(np.argmin(sums, axis=0))
        least = np.min(sums, axis=0)
    bounds = [filled.size]
    for cut in reversed(cuts):
        bounds.append(int(cut[bounds[-1]]))
    bounds = [0, *reversed(bounds)]
    return np.array([mean[a, b] for a, b in itertools.pairwise(bounds)])
