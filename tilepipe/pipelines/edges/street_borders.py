"""The streets that edge lines may border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.parallel_lines import LEFT, RIGHT, opposite_samples, sample_lines
from tilepipe_kernels.polylines.strips import in_long_strips

_STEP = 1.0
"""Distance of the samples by which the other border of a street is looked for (m), two pixels at least."""

_GAP = 10.0
"""Longest gap in a border of a street (m)."""

_BESIDE = 0.3
"""Share of a line that must lie along a street to be a candidate for its border: lines go on where a street ends."""

_LEAST_CONTRAST = 1.0
"""Mean difference of grey (0-255) that makes one side of a line the darker one."""


class Streets(NamedTuple):
    """Candidates for borders of streets, by line.

    Attributes
    ----------
    candidate
        Whether the line is long enough and three tenths of it or more, and at least the street's width, lie along a
        street: opposite another such line, on one side, in a strip of even width that is long for its width.
    width
        Median width of the street, in pixels; NaN where there is none.
    partner
        The line that is opposite most often, -1 = none.
    share
        Share of the line along a street.
    """

    candidate: NDArray[np.bool_]
    width: NDArray[np.float64]
    partner: NDArray[np.int64]
    share: NDArray[np.float64]


@dataclass(frozen=True)
class _Side:
    """What the lines see on one of their sides."""

    share: NDArray[np.float64]
    width: NDArray[np.float64]
    partner: NDArray[np.int64]


def find_streets(
    lines: Polylines, step: NDArray[np.float64], parameters: EdgeParameters, resolution: float, workers: int = 1
) -> Streets:
    """Lines that run parallel at the width of a street, the street being darker than both its sides, or brighter.

    Parameters
    ----------
    lines
        In pixels.
    step
        Mean grey to the left of each line less that to its right.
    parameters
        Widths and angle of streets.
    resolution
        Pixel size in metres.
    workers
        Threads; they do not change the result.

    Returns
    -------
    Streets
    """
    apart = max(2.0, _STEP / resolution)
    lengths = lines.lengths()
    told = (lengths * resolution >= parameters.minimum_street_length) & (np.abs(step) >= _LEAST_CONTRAST)
    number_of = np.flatnonzero(told)
    samples = sample_lines(lines.taken(told), apart)
    opposite = opposite_samples(
        samples,
        np.where(step[told] > 0, RIGHT, LEFT).astype(np.int8),
        step=apart,
        least=parameters.minimum_street_width / resolution,
        most=parameters.maximum_street_width / resolution,
        angle=parameters.maximum_street_angle,
        workers=workers,
    )
    seen, width = in_long_strips(
        samples, opposite, step=apart, gap=_GAP / resolution, least=parameters.minimum_street_length / resolution
    )
    line = number_of[samples.line]
    number = np.bincount(line, minlength=len(lines))
    left, right = (
        _side(line, np.where(seen[:, side] >= 0, line[seen[:, side]], -1), width[:, side], number)
        for side in (LEFT, RIGHT)
    )
    better = right.share > left.share
    share, width, partner = (
        np.where(better, getattr(right, name), getattr(left, name)) for name in ("share", "width", "partner")
    )
    candidate = (share >= _BESIDE) & (share * lengths >= width)
    return Streets(candidate, np.where(candidate, width, np.nan), np.where(candidate, partner, -1), share)


def _side(
    line: NDArray[np.int64], other: NDArray[np.int64], width: NDArray[np.float64], number: NDArray[np.int64]
) -> _Side:
    """Share, median width and most frequent partner (of equals the first) of each line's samples."""
    found = other >= 0
    line, other, width = line[found], other[found], width[found]
    count = np.bincount(line, minlength=number.size)
    median, partner = np.full(number.size, np.nan), np.full(number.size, -1, np.int64)
    some = np.flatnonzero(count)
    order = np.lexsort((width, line))
    last = np.cumsum(count)
    median[some] = width[order][(last - count + count // 2)[some]]
    pairs, frequency = np.unique(np.stack([line, other], axis=1), axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], -frequency, pairs[:, 0]))
    first = np.unique(pairs[order, 0], return_index=True)[1]
    partner[some] = pairs[order, 1][first]
    return _Side(count / np.maximum(number, 1), median, partner)
