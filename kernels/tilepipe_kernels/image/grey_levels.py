"""Grey levels in and out of storage: stretched to 0–255, kept in steps with a nodata flag, put back as an image.

Arrays of a device stay there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.rounding import nearest_whole

LARGEST_GREY = 255.0

STEPS = 128
"""Steps of a stored grey level; the lowest bit of a stored value is the nodata flag."""

NO_GREY = 65534
"""Stored grey of a pixel that has none, or none that counts (65535 when it is nodata as well)."""

_ZERO, _LARGEST, _STEPS, _PER_STEP = (np.float32(value) for value in (0, LARGEST_GREY, STEPS, 1 / STEPS))
_NO_GREY = np.uint16(NO_GREY)

LEVEL_STEPS = 1024
"""Steps of a grey value in units of a level: sums of their squares are then exact, in whatever order."""

_LEVEL_STEPS, _PER_LEVEL_STEP = np.float32(LEVEL_STEPS), np.float32(1 / LEVEL_STEPS)


@rule
def stretched(value: np.float32, darkest: np.float32, scale: np.float32) -> np.float32:
    """Grey level of a value: linear, clipped to 0–255; NaN stays."""
    grey = (value - darkest) * scale
    return _ZERO if grey < _ZERO else (_LARGEST if grey > _LARGEST else grey)


@rule
def stored(grey: np.float32, missing: bool) -> np.uint16:
    """Grey level in steps above the nodata flag; `NO_GREY` with the flag where there is none."""
    # the cast of NaN is undefined and differs between the compiler's loops, so NaN counts as no grey of its own
    steps = np.uint16(np.uint16(nearest_whole(grey * _STEPS)) << 1) if grey == grey else _NO_GREY
    return np.uint16(steps | np.uint16(missing))


@rule
def restored(packed: np.uint16, dark: np.float32, limit: np.float32) -> np.float32:
    """Grey level of a stored one, clipped to the range of streets."""
    grey = np.float32(packed >> 1) * _PER_STEP
    return dark if grey < dark else (limit if grey > limit else grey)


@rule
def restored_in_street(
    in_mask: bool, region: np.uint32, packed: np.uint16, dark: np.float32, limit: np.float32, bright: np.float32
) -> np.float32:
    """Grey level of a pixel of the image of streets: bright outside; what the mask bridges is dark."""
    if not in_mask:
        return bright
    return restored(packed, dark, limit) if region != 0 and packed < _NO_GREY else dark


@rule
def level_of(grey: np.float32, k: int, start: np.float32, slope: np.float32) -> np.float32:
    """Level of a grey value in the interval above mean k, linear, in whole steps."""
    level = np.float32(k) + (grey - start) * slope
    return nearest_whole(level * _LEVEL_STEPS) * _PER_LEVEL_STEP


@loop
def _to_levels(grey: NDArray[np.float32], starts: NDArray[np.float32], slopes: NDArray[np.float32]) -> None:
    for i in range(grey.shape[0]):
        row = grey[i]
        for j in range(row.size):
            k = 0
            for level in range(1, slopes.size):
                k += row[j] >= starts[level]
            row[j] = level_of(row[j], k, starts[k], slopes[k])


@loop
def _stretch(values: NDArray[np.float32], darkest: np.float32, scale: np.float32, grey: NDArray[np.float32]) -> None:
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            grey[i, j] = stretched(values[i, j], darkest, scale)


@loop
def _store(grey: NDArray[np.float32], missing: NDArray[np.bool_], packed: NDArray[np.uint16]) -> None:
    for i in range(grey.shape[0]):
        for j in range(grey.shape[1]):
            packed[i, j] = stored(grey[i, j], missing[i, j])


@loop
def _street_image(
    mask: NDArray[np.bool_],
    ids: NDArray[np.uint32],
    packed: NDArray[np.uint16],
    dark: np.float32,
    limit: np.float32,
    bright: np.float32,
    image: NDArray[np.float32],
) -> None:
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            image[i, j] = restored_in_street(mask[i, j], ids[i, j], packed[i, j], dark, limit, bright)


def stretch(values: NDArray[np.float32], darkest: float, brightest: float) -> NDArray[np.float32]:
    """Stretch values between two of them to grey levels 0–255.

    Parameters
    ----------
    values
        float32, shape (rows, columns); NaN stays.
    darkest, brightest
        The values that become 0 and 255; what lies beyond is clipped.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Grey levels.

    Raises
    ------
    ValueError
        When ``brightest`` does not exceed ``darkest``.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.grey_levels import stretch
    >>> intensity = np.array([[900, 1000, 1500, 2000, 65535]], np.float32)
    >>> stretch(intensity, darkest=1000, brightest=2000).tolist()
    [[0.0, 0.0, 127.5, 255.0, 255.0]]
    """
    if not brightest > darkest:
        raise ValueError(f"brightest ({brightest}) must exceed darkest ({darkest})")
    scale = np.float32(LARGEST_GREY / (brightest - darkest))
    if on_device(values):
        return device_form(__name__).stretch(values, np.float32(darkest), scale)
    grey = np.empty(values.shape, np.float32)
    _stretch(values, np.float32(darkest), scale, grey)
    return grey


def to_levels(grey: NDArray[np.float32], means: NDArray[np.float64]) -> NDArray[np.float32]:
    """Grey values in units in which the means of adjacent classes are one apart: linear between them, and beyond.

    Parameters
    ----------
    grey
        float32, shape (rows, columns); NaN stays.
    means
        Mean grey of each class, ascending, two at least.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        0 at the first mean, 1 at the second …, in steps of 1/`LEVEL_STEPS`.

    Raises
    ------
    ValueError
        When the means do not ascend or there are fewer than two.

    Examples
    --------
    Classes of mean grey 20, 60 and 200 become the levels 0, 1 and 2, although they are not equally far apart.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.grey_levels import to_levels
    >>> to_levels(np.array([[20, 40, 60, 130, 200]], np.float32), np.array([20.0, 60.0, 200.0])).tolist()
    [[0.0, 0.5, 1.0, 1.5, 2.0]]
    """
    gaps = np.diff(means)
    if gaps.size < 1 or not (gaps > 0).all():
        raise ValueError(f"the means of at least two classes must ascend, not {means}")
    starts, slopes = np.asarray(means[:-1], np.float32), np.asarray(1 / gaps, np.float32)
    if on_device(grey):
        return device_form(__name__).to_levels(grey, starts, slopes)
    levels = grey.astype(np.float32, order="C")
    _to_levels(levels, starts, slopes)
    return levels


def store(grey: NDArray[np.float32], missing: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Grey levels as uint16 in steps of 1/128, the lowest bit being the nodata flag.

    Parameters
    ----------
    grey
        float32, shape (rows, columns); NaN where there is none.
    missing
        bool, same shape: pixels that are nodata in the input; they may have a grey level that bridges the void.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
        `NO_GREY`, with the flag, where there is no grey level.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.image.grey_levels import NO_GREY, store
    >>> packed = store(np.array([[12.5, np.nan]], np.float32), missing=np.array([[False, True]]))
    >>> float(packed[0, 0] >> 1) / 128, bool(packed[0, 0] & 1)  # grey level and nodata flag
    (12.5, False)
    >>> bool(packed[0, 1] == NO_GREY | 1)
    True
    """
    if on_device(grey, missing):
        return device_form(__name__).store(grey, missing)
    packed = np.empty(grey.shape, np.uint16)
    _store(grey, missing, packed)
    return packed


def street_image(
    mask: NDArray[np.bool_],
    ids: NDArray[np.uint32],
    packed: NDArray[np.uint16],
    *,
    dark: float,
    bright: float,
    threshold: float,
) -> NDArray[np.float32]:
    """Grey image of the streets alone: their own grey inside, the mean of the bright class outside.

    Inside, what is darker than the mean of the dark class counts as that mean, so that shaded borders do not attract
    a line.  Both flanks being equally bright, the ridge is where the street's axis is: no asymmetry, no bias.

    Parameters
    ----------
    mask
        Cleaned street mask, shape (rows, columns).
    ids
        Region ids, 0 = none: there the mask bridges a gap, which counts as dark.
    packed
        Stored grey levels, see `store`.
    dark, bright, threshold
        Mean grey levels of the two classes, and what parts them.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Grey levels between ``dark`` and ``bright``.

    Examples
    --------
    A street whose two pixels are darker than its class, and as grey as it; a gap that the mask bridges; a roof.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.grey_levels import store, street_image
    >>> grey, ids = np.array([[30, 60, 210, 210]], np.float32), np.array([[1, 1, 0, 0]], np.uint32)
    >>> packed = store(grey, missing=np.zeros((1, 4), bool))
    >>> mask = np.array([[True, True, True, False]])
    >>> street_image(mask, ids, packed, dark=50, bright=200, threshold=120).tolist()
    [[50.0, 60.0, 50.0, 200.0]]
    """
    levels = np.float32(dark), np.float32(max(dark, min(threshold, bright))), np.float32(bright)
    if on_device(mask, ids, packed):
        return device_form(__name__).street_image(mask, ids, packed, *levels)
    image = np.empty(mask.shape, np.float32)
    _street_image(mask, ids, packed, *levels, image)
    return image
