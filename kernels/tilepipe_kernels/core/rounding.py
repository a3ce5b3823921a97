"""Rounding to whole numbers, half to even, by sums that every backend has and that vectorise.

Adding 1.5 · 2ᵐ, m the bits of the fraction, leaves no room for what lies behind the point (Goldberg 1991).
"""

from __future__ import annotations

import numpy as np

from tilepipe_kernels.core.compiled import rule

_LARGE_32, _LARGE_64 = np.float32(1.5 * 2**23), np.float64(1.5 * 2**52)


@rule
def nearest_whole(value: np.float32) -> np.float32:
    """Nearest whole number of a float32 below 2²² in magnitude; NaN stays.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.rounding import nearest_whole
    >>> [float(nearest_whole(np.float32(value))) for value in (1.5, 2.5, -0.7)]
    [2.0, 2.0, -1.0]
    """
    return (value + _LARGE_32) - _LARGE_32


@rule
def nearest_integer(value: np.float64) -> int:
    """Nearest integer of a float64 below 2⁵¹ in magnitude.

    Examples
    --------
    >>> from tilepipe_kernels.core.rounding import nearest_integer
    >>> nearest_integer(1234.5), nearest_integer(1235.5)  # half to even
    (1234, 1236)
    """
    return int((value + _LARGE_64) - _LARGE_64)
