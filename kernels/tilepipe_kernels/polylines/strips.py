"""Which lines opposite each other border something long and even, as a street is: most other strips are neither.

Two lines run beside each other for some metres on roofs, shadows, hedges and cars as well.  What tells a street is that
its borders go on evenly, for twice the width between them or more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.components import connected_components
from tilepipe_kernels.polylines.parallel_lines import LEFT, RIGHT, Opposite, Samples

Two = tuple[float, float]

_EVEN = 0.1
"""Farthest that two places of a border lie aside of each other, or differ in width, as a share of the width."""

_STAIRS = 1.0
"""The same in pixels, for streets so narrow that this is more: lines follow the sides of pixels."""

_ELONGATION = 2.0
"""Least length of a street as a multiple of its width."""


def in_long_strips(samples: Samples, opposite: Opposite, *, step: float, gap: float, least: float) -> Opposite:
    """What samples see, without what is no part of a long and even strip.

    Places near each other on one border whose widths agree are of one strip, and so are places that see each other; a
    strip thus goes on where lines end, and through a longer gap of one border where the other has none.

    Parameters
    ----------
    samples
        Points along lines in pixels, of `sample_lines`.
    opposite
        What they see, of `opposite_samples`; what a line sees of itself is the far side of a roof or shadow, and left
        out here.
    step
        Distance of the samples, in pixels.
    gap
        Distance over which a strip goes on where nothing is opposite, such as beside a car or a drive, in pixels.
    least
        Shortest strip, in pixels; what is shorter than twice its mean width is too short in any case.

    Returns
    -------
    Opposite
    """
    seen, width = opposite
    place = np.full(seen.shape, -1, np.int64)
    told = (seen >= 0) & (samples.line[seen] != samples.line[:, None])
    place[told] = np.arange(np.count_nonzero(told))
    across = np.stack([place[told], _opposite_places(samples, seen, place)[told]], axis=1)
    sample, side = np.nonzero(told)
    # left of a direction (down, right) is (-right, down)
    inward = samples.directions[sample, ::-1] * np.where(side[:, None] == LEFT, [-1.0, 1.0], [1.0, -1.0])
    along = _along(samples.points[sample], inward, width[told], gap)
    pairs = [across[across[:, 1] >= 0], along]
    strip = connected_components(across.shape[0], np.concatenate(pairs))
    number = np.bincount(strip)
    mean_width = np.bincount(strip, width[told]) / number
    # both borders have their places
    length = number / 2 * step
    told[told] = ((length >= least) & (length >= _ELONGATION * mean_width))[strip]
    return Opposite(np.where(told, seen, -1), np.where(told, width, np.nan))


def _opposite_places(samples: Samples, seen: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """The place (n, 2) that each sample and side sees: a line that runs the other way shows its same side."""
    parallel = np.einsum("ik,ijk->ij", samples.directions, samples.directions[seen])
    return place[seen, np.where(parallel < 0, [[LEFT, RIGHT]], [[RIGHT, LEFT]])]


def _along(
    points: NDArray[np.float64], inward: NDArray[np.float64], width: NDArray[np.float64], gap: float
) -> NDArray[np.int64]:
    """Pairs (m, 2) of places on one border: near each other, one straight ahead of the other, of one width."""
    cells = np.floor((points - points.min(axis=0, initial=np.inf)) / gap).astype(np.int64)
    keys = cells[:, 0] << 32 | cells[:, 1]
    order = np.argsort(keys, kind="stable")
    places = order.astype(np.int64), points[order], inward[order], width[order]
    pairs = np.empty((4 * len(keys) + 16, 2), np.int64)
    found = _pairs(keys[order], *places, gap, pairs)
    if found > len(pairs):
        pairs = np.empty((found, 2), np.int64)
        _pairs(keys[order], *places, gap, pairs)
    return pairs[:found]


@rule
def _one_border(
    down: float, across: float, inward: Two, other: Two, width: float, other_width: float, gap: float
) -> bool:  # fmt: skip
    """Whether two places, one at an offset from the other, lie on one border of one strip."""
    if down * down + across * across > gap * gap or inward[0] * other[0] + inward[1] * other[1] <= 0:
        return False
    uneven = max(_STAIRS, _EVEN * max(width, other_width))
    beside = abs(down * (inward[0] + other[0]) + across * (inward[1] + other[1])) / 2
    return bool(beside <= uneven and abs(width - other_width) <= uneven)


@loop
def _pairs(
    keys: NDArray[np.int64],
    place: NDArray[np.int64],
    points: NDArray[np.float64],
    inward: NDArray[np.float64],
    width: NDArray[np.float64],
    gap: float,
    pairs: NDArray[np.int64],
) -> int:
    """Number of pairs; they are written while there is room.  Each place looks in its own and the next cells."""
    found = 0
    beside = below = end = 0
    for a in range(len(keys)):
        # the cells right of its own, and the three below: whatever lies before has looked this way itself
        below, end = max(below, a), max(end, a)
        while below < len(keys) and keys[below] < keys[a] + (1 << 32) - 1:
            below += 1
        while end < len(keys) and keys[end] <= keys[a] + (1 << 32) + 1:
            end += 1
        beside = max(beside, a)
        while beside < len(keys) and keys[beside] <= keys[a] + 1:
            beside += 1
        for first, last in ((a + 1, beside), (below, end)):
            for b in range(first, last):
                down, across = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
                here, there = (inward[a, 0], inward[a, 1]), (inward[b, 0], inward[b, 1])
                if _one_border(down, across, here, there, width[a], width[b], gap):
                    if found < len(pairs):
                        pairs[found, 0], pairs[found, 1] = place[a], place[b]
                    found += 1
    return found
