"""What Highest Confidence First (HCF) is for any field: whose turn it is.

In the serial form (Chou & Brown 1990) the site of least stability G of all changes next.  In the parallel form
(Swain & Wixson 1992) every site changes at once that comes before all sites whose energy it shares.  Sites of equal
G take turns by a fixed mix of their global place, never by the place itself: over flat ground, where all G are equal,
change would else run along the rows, one site a round.
"""

from __future__ import annotations

import numpy as np

from tilepipe_kernels.core.compiled import rule

_PLACE_BITS = np.uint32(16)
_PLACE = np.uint32(0xFFFF)
_MULTIPLIER_1 = np.uint32(0x7FEB352D)
_MULTIPLIER_2 = np.uint32(0x846CA68B)
_SHIFT_15 = np.uint32(15)
_SHIFT_16 = np.uint32(16)


@rule
def site_rank(row: int | np.int64, column: int | np.int64) -> np.uint32:
    """Rank of a site among those of equal stability: a mix of its global row and column.

    A bijection of the 32 bits of (row modulo 2¹⁶, column modulo 2¹⁶), by multiplications with odd numbers and
    xor-shifts: two sites less than 65536 rows and columns apart never have the same rank.
    """
    mix = (np.uint32(row) << _PLACE_BITS) ^ (np.uint32(column) & _PLACE)
    mix = np.uint32(mix ^ (mix >> _SHIFT_16)) * _MULTIPLIER_1
    mix = np.uint32(np.uint32(mix) ^ (np.uint32(mix) >> _SHIFT_15)) * _MULTIPLIER_2
    return np.uint32(np.uint32(mix) ^ (np.uint32(mix) >> _SHIFT_16))


@rule
def comes_before(g: np.float32, rank: np.uint32, other_g: np.float32, other_rank: np.uint32) -> bool:
    """Whether a site is less stable than another one, ties by rank."""
    return bool((g < other_g) | ((g == other_g) & (rank < other_rank)))
