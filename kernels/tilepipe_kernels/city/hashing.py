"""Counter-based random numbers: a value is a hash of where it is used, never of what was drawn before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import rule

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST_FACTOR = np.uint64(0xBF58476D1CE4E5B9)
SECOND_FACTOR = np.uint64(0x94D049BB133111EB)
SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
HIGH_BITS = np.uint64(11)
UNIT = 2.0**-53
DRAWS, DRAWS_STREAM = 10, 100


@rule
def mixed(value: np.uint64) -> np.uint64:
    """Scramble 64 bits (the finaliser of SplitMix64; Steele, Lea & Flood 2014, figure 15)."""
    value = value + GOLDEN
    value = (value ^ (value >> SHIFTS[0])) * FIRST_FACTOR
    value = (value ^ (value >> SHIFTS[1])) * SECOND_FACTOR
    return value ^ (value >> SHIFTS[2])


@rule
def bits(key: np.uint64, stream: int, first: int, second: int) -> np.uint64:
    """64 random bits of the counter (stream, first, second); the counters may be negative."""
    value = mixed(key ^ mixed(np.uint64(stream)))
    value = mixed(value ^ np.uint64(first))
    return mixed(value ^ np.uint64(second))


@rule
def uniform(key: np.uint64, stream: int, first: int, second: int) -> float:
    """A float64 in [0, 1) of the counter (stream, first, second)."""
    return float(bits(key, stream, first, second) >> HIGH_BITS) * UNIT


@rule
def draws(key: np.uint64, place: int) -> NDArray[np.float64]:
    """``DRAWS`` numbers in [0, 1) for one place of a key."""
    result = np.empty(DRAWS)
    for n in range(DRAWS):
        result[n] = uniform(key, DRAWS_STREAM, place, n)
    return result
