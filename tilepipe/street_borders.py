"""Which lines opposite each other border something long and even, as a street is: most other strips are neither.

Two lines run beside each other for some metres on roofs, shadows, hedges and cars as well.  What tells a street is that
its borders go on evenly, for twice the width between them or more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe.reconcile import unite
from tilepipe_kernels.parallel_lines import LEFT, RIGHT, Opposite, Samples

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
        Points along lines in pixels, of `tilepipe_kernels.parallel_lines.sample_lines`.
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
    strip = unite(across.shape[0], np.concatenate(pairs))
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
    from scipy.spatial import cKDTree

    a, b = cKDTree(points).query_pairs(gap, output_type="ndarray").astype(np.int64).T
    uneven = np.maximum(_STAIRS, _EVEN * np.maximum(width[a], width[b]))
    beside = np.abs(np.einsum("ij,ij->i", points[b] - points[a], inward[a] + inward[b])) / 2
    same_side = np.einsum("ij,ij->i", inward[a], inward[b]) > 0
    one = same_side & (beside <= uneven) & (np.abs(width[a] - width[b]) <= uneven)
    return np.stack([a[one], b[one]], axis=1)
