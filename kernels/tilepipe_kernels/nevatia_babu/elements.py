"""Nevatia & Babu's edge elements: responses of the masks, thinned and held against a threshold.

`edge_responses` convolves, `thin_edges` keeps the ridges of the magnitude; `nevatia_babu.links` finds what comes before
and after each element, `nevatia_babu.tracing` walks from one to the next.  Nevatia and Babu, "Linear Feature Extraction
and Description", Computer Graphics and Image Processing 13, 1980, Section 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.image.histogram import bin_values, histogram, percentile
from tilepipe_kernels.nevatia_babu.masks import (
    MASK_RADIUS,
    NO_DIRECTION,
    NONE,
    ONE,
    OPPOSITE,
    ZERO,
    Directions,
    Floats,
)

Eight = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]

EightLines = tuple[np.uint8, np.uint8, np.uint8, np.uint8, np.uint8, np.uint8, np.uint8, np.uint8]
"""Of the eight neighbours of a pixel in row-major order."""

THINNING_RADIUS = 2
"""Pixels around a pixel that its thinning depends on: its rivals, and what these are compared with."""

THREE, ELEVEN = np.float32(3), np.float32(11)
HORIZONTAL, RISING, VERTICAL, FALLING = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Lines of three pixels across an edge, as bits."""


def halo() -> int:
    """Pixels around a block on which its edge elements depend: 4; for responses alone `MASK_RADIUS` are enough."""
    return MASK_RADIUS + THINNING_RADIUS


# ------------------------------------------------------------------------------------------------- thinning


@rule
def similar(direction: np.float32, other: np.float32) -> bool:
    """Whether two directions are at most 30° apart; a pixel without response has none that could differ."""
    gap = abs(direction - other)
    return bool((gap <= ONE) | (gap == ELEVEN) | (other == NONE))


@inlined_rule
def _across(direction: np.float32, around: Eight) -> tuple[np.float32, np.float32]:
    """Of the eight neighbours in row-major order the two across an edge, the earlier one first."""
    axis = direction if direction < OPPOSITE else direction - OPPOSITE
    level, upright, rising = axis == ZERO, axis == THREE, axis < THREE
    before, after = (around[2] if rising else around[0]), (around[5] if rising else around[7])
    before, after = (around[1] if upright else before), (around[6] if upright else after)
    return (around[3] if level else before), (around[4] if level else after)


@rule
def _line(direction: np.float32) -> np.uint8:
    """Bit of the line across an edge."""
    axis = direction if direction < OPPOSITE else direction - OPPOSITE
    diagonal = RISING if axis < THREE else FALLING
    return HORIZONTAL if axis == ZERO else (VERTICAL if axis == THREE else diagonal)


@inlined_rule
def winning_line(magnitude: np.float32, direction: np.float32, magnitudes: Eight, directions: Eight) -> np.uint8:
    """Line across the edge on which a pixel wins over its neighbours, or 0: conditions 1 and 2.

    Of two equal magnitudes the earlier wins: a plain edge answers equally in the two pixels beside it.
    """
    before, after = _across(direction, magnitudes)
    one, other = _across(direction, directions)
    wins = (magnitude > before) & (magnitude >= after) & (direction != NONE)
    wins &= similar(direction, one) & similar(direction, other)
    return _line(direction) if wins else np.uint8(0)


@inlined_rule
def element_of(
    line: np.uint8, lines: EightLines, magnitude: np.float32, direction: np.uint8, threshold: np.float32
) -> np.uint8:
    """Direction of a winner above the threshold that no neighbour disqualifies by having beaten it."""
    beaten = ((lines[3] | lines[4]) & HORIZONTAL) | ((lines[1] | lines[6]) & VERTICAL)
    beaten |= ((lines[2] | lines[5]) & RISING) | ((lines[0] | lines[7]) & FALLING)
    kept = (line != 0) & (beaten == 0) & (magnitude > threshold)
    return direction if kept else np.uint8(NO_DIRECTION)


@loop
def _peaks_row(
    m_above: Floats, m: Floats, m_below: Floats,
    d_above: Floats, d: Floats, d_below: Floats, peaks: NDArray[np.uint8],
) -> None:  # fmt: skip
    for j in range(peaks.size):
        peaks[j] = winning_line(
            m[j + 1],
            d[j + 1],
            (m_above[j], m_above[j + 1], m_above[j + 2], m[j], m[j + 2], m_below[j], m_below[j + 1], m_below[j + 2]),
            (d_above[j], d_above[j + 1], d_above[j + 2], d[j], d[j + 2], d_below[j], d_below[j + 1], d_below[j + 2]),
        )


@loop
def _elements_row(
    above: NDArray[np.uint8], here: NDArray[np.uint8], below: NDArray[np.uint8],
    magnitude: Floats, direction: Directions, threshold: np.float32, elements: Directions,
) -> None:  # fmt: skip
    for j in range(elements.size):
        lines = (
            above[j], above[j + 1], above[j + 2], here[j], here[j + 2], below[j], below[j + 1], below[j + 2]
        )  # fmt: skip
        elements[j] = element_of(here[j + 1], lines, magnitude[j], direction[j], threshold)


@loop
def _widen(narrow: Directions, wide: Floats) -> None:
    """Directions as numbers of the magnitudes' size, so that both are selected in equal lanes."""
    for j in range(wide.size):
        wide[j] = np.float32(narrow[j])


@loop
def _thin(magnitude: Floats, direction: Directions, threshold: np.float32, elements: Directions) -> None:
    rows, columns = magnitude.shape
    peaks = np.zeros((3, columns), np.uint8)
    wide = np.empty((3, columns), np.float32)
    _widen(direction[0], wide[0])
    _widen(direction[1], wide[1])
    for i in range(1, rows):
        into = peaks[i % 3]
        if i < rows - 1:
            above, here, below = wide[(i - 1) % 3], wide[i % 3], wide[(i + 1) % 3]
            _widen(direction[i + 1], below)
            _peaks_row(magnitude[i - 1], magnitude[i], magnitude[i + 1], above, here, below, into[1:-1])
        else:
            into[:] = 0
        if i > 1:
            _elements_row(
                peaks[(i - 2) % 3], peaks[(i - 1) % 3], into,
                magnitude[i - 1, 1:-1], direction[i - 1, 1:-1], threshold, elements[i - 1, 1:-1],
            )  # fmt: skip


def thin_edges(magnitude: Floats, direction: Directions, threshold: float = 0.0) -> Directions:
    """Edge elements of responses (Nevatia & Babu 1980, Section 2.2).

    A pixel holds an edge element when

    1. its magnitude is larger than those of its two neighbours across the edge (for 30° and 60° the diagonal ones;
       of two equal magnitudes the one earlier in row-major order counts as larger);
    2. the directions of these two are within 30° of its own;
    3. its magnitude exceeds the threshold;
    4. and it is no such neighbour itself of a pixel that fulfils 1 and 2, whatever becomes of that one.

    Parameters
    ----------
    magnitude, direction
        float32 and uint8, shape (rows, columns), as `edge_responses` gives them.  Arrays of a device stay there.
    threshold
        In the unit of the magnitude, ≥ 0; one for the whole raster, for example from `threshold_from_histogram`.

    Returns
    -------
    ndarray
        uint8, shape (rows, columns): the direction at edge elements, `NO_DIRECTION` elsewhere.

    Raises
    ------
    ValueError
        If shapes or dtypes are not those of `edge_responses`, or the threshold is negative or NaN.

    Examples
    --------
    Of the four columns that answer to a step, one holds its edge elements.

    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.elements import thin_edges
    >>> from tilepipe_kernels.nevatia_babu.masks import edge_responses
    >>> magnitude, direction = edge_responses(np.tile(np.repeat([100, 150], 5), (9, 1)))
    >>> thin_edges(magnitude, direction, threshold=10_000)[4].tolist()
    [255, 255, 255, 255, 0, 255, 255, 255, 255, 255]
    """
    if magnitude.ndim != 2 or magnitude.shape != direction.shape:
        raise ValueError(f"magnitude {magnitude.shape} and direction {direction.shape} must be images of equal shape")
    if magnitude.dtype != np.float32 or direction.dtype != np.uint8:
        raise ValueError(f"magnitude must be float32 and direction uint8, not {magnitude.dtype} and {direction.dtype}")
    if not threshold >= 0:
        raise ValueError(f"threshold is {threshold}: give a magnitude of at least 0")
    xp = namespace(magnitude, direction)
    magnitude, direction = xp.ascontiguousarray(magnitude), xp.ascontiguousarray(direction)
    if on_device(magnitude):
        return device_form(__name__).thin(magnitude, direction, np.float32(threshold))
    elements = np.full(magnitude.shape, NO_DIRECTION, np.uint8)
    if min(magnitude.shape) > 2:
        _thin(magnitude, direction, np.float32(threshold), elements)
    return elements


# ------------------------------------------------------------------------------------------------- threshold

UNIMODAL_BINS = 1024


def count_magnitudes(magnitude: Floats, elements: Directions) -> NDArray[np.int64]:
    """Histogram of the magnitudes of edge elements, to be added up over the cores of all tiles.

    Parameters
    ----------
    magnitude
        float32, shape (rows, columns), from `edge_responses`, cut to the core.
    elements
        uint8, same shape, from `thin_edges` with threshold 0, cut to the core.

    Returns
    -------
    ndarray
        int64, shape (`image.histogram.BINS`,): the bins of `image.histogram.histogram`, the same for every raster; on
        the device if the magnitudes lie there.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import bin_values
    >>> from tilepipe_kernels.nevatia_babu.elements import NO_DIRECTION, count_magnitudes
    >>> elements = np.array([[0, 3, NO_DIRECTION]], np.uint8)
    >>> counts = count_magnitudes(np.array([[2000, 512, 100]], np.float32), elements)
    >>> bin_values(np.flatnonzero(counts)).tolist()
    [512.0, 2000.0]
    """
    return histogram(magnitude[elements != NO_DIRECTION])


def threshold_from_histogram(counts: NDArray[np.int64], share: float | None = None) -> float:
    """Threshold of the magnitude for a whole raster.

    Parameters
    ----------
    counts
        Sum of `count_magnitudes` over all tiles.
    share
        Part of the elements to keep, the strongest, 0 … 1.  None: the corner of the unimodal histogram (Rosin 2001,
        "Unimodal thresholding", Pattern Recognition 34): most elements are noise, and the corner is the bin of the
        histogram (`UNIMODAL_BINS` equal bins up to the largest magnitude) farthest below the line from its peak to
        its end.

    Returns
    -------
    float
        For `thin_edges`, in the unit of the magnitude.

    Raises
    ------
    ValueError
        If nothing was counted, or the share is not within 0 … 1.

    Examples
    --------
    Ninety weak elements and ten strong ones, of which the strongest tenth is to be kept.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.histogram import histogram
    >>> from tilepipe_kernels.nevatia_babu.elements import threshold_from_histogram
    >>> counts = histogram(np.repeat([100.0, 5000.0], [90, 10]))
    >>> 100 <= threshold_from_histogram(counts, share=0.1) < 5000
    True
    """
    if share is not None:
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}: give the part of the edge elements to keep, 0 to 1")
        return percentile(counts, 100 * (1 - share))
    filled = np.flatnonzero(counts)
    if filled.size == 0:
        raise ValueError("no edge element was counted: the raster is flat or holds no data")
    values = bin_values(filled).astype(np.float64)
    width = values[-1] / UNIMODAL_BINS
    places = np.minimum((values / width).astype(np.int64), UNIMODAL_BINS - 1)
    heights = np.bincount(places, counts[filled], UNIMODAL_BINS)
    peak = int(np.argmax(heights))
    run = np.arange(UNIMODAL_BINS - peak)
    # Empty bin after the last one, as in the paper; the distance from the line is this times a constant.
    below = heights[peak] * (1 - run / run.size) - heights[peak:]
    return float((peak + int(np.argmax(below))) * width)
