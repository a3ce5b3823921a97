"""Points that occur in several clouds, such as in tiles with buffers: told by a fingerprint, counted once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)


def fingerprints(*fields: NDArray[Any]) -> NDArray[np.uint64]:
    """Hash of 64 bits of what tells points apart; equal points have equal ones.

    Each field is mixed in by the finaliser of SplitMix64 (Steele, Lea & Flood 2014, Fast splittable pseudorandom
    number generators): of ten million points two different ones agree with a probability of 3 in a million.

    Parameters
    ----------
    fields
        Integers or float64 of the points, one array a field, shape (points,); floats count by their bits.

    Returns
    -------
    ndarray of uint64, shape (points,)
        Fingerprints, which depend on the values and on the order of the fields.

    Examples
    --------
    Three echoes by place and time; the last is the first once more.

    >>> import numpy as np
    >>> from tilepipe_kernels.points.duplicates import fingerprints
    >>> first, second, third = fingerprints(np.array([10, 12, 10]), np.array([0.5, 0.5, 0.5]))
    >>> bool(first == third), bool(first == second)
    (True, False)
    """
    result = np.zeros(fields[0].shape, np.uint64)
    for field in fields:
        words = field.view(np.uint64) if field.dtype == np.float64 else field.astype(np.int64).view(np.uint64)
        # the odd constant keeps fields of zeros from vanishing
        result = (result ^ words) + np.uint64(0x9E3779B97F4A7C15)
        result = (result ^ (result >> _SHIFTS[0])) * _FIRST
        result = (result ^ (result >> _SHIFTS[1])) * _SECOND
        result ^= result >> _SHIFTS[2]
    return result


def counted_once(prints: NDArray[np.uint64], clouds: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which points count where clouds overlap: a point that several clouds hold counts once.

    A point that one cloud holds twice counts twice, as it does in that cloud alone: of each point there are as many as
    in the cloud that holds it most often.

    Parameters
    ----------
    prints
        What identifies a point (`fingerprints`), shape (points,).
    clouds
        Number of the cloud that each comes from, same shape; of equal points those of the lowest numbers count.

    Returns
    -------
    ndarray of bool, shape (points,)
        True for the points that count.

    Examples
    --------
    Cloud 1 repeats two points of cloud 0, which holds the second of them twice.

    >>> import numpy as np
    >>> from tilepipe_kernels.points.duplicates import counted_once
    >>> counted_once(np.array([5, 8, 8, 5, 8, 9], np.uint64), np.array([0, 0, 0, 1, 1, 1], np.uint32)).tolist()
    [True, True, True, False, False, True]
    """
    order = np.lexsort((clouds, prints))
    ordered, source = prints[order], clouds[order]
    place = np.arange(order.size)
    starts = np.ones(order.size, np.bool_)
    starts[1:] = (ordered[1:] != ordered[:-1]) | (source[1:] != source[:-1])
    occurrence = place - np.maximum.accumulate(np.where(starts, place, 0))
    # of the same occurrence in several clouds the first in order comes from the lowest number
    again = np.lexsort((occurrence, ordered))
    first = np.ones(order.size, np.bool_)
    first[1:] = (ordered[again][1:] != ordered[again][:-1]) | (occurrence[again][1:] != occurrence[again][:-1])
    kept = np.empty(order.size, np.bool_)
    kept[order[again]] = first
    return kept
