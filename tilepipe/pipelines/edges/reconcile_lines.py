"""The lines of a line field as polylines: smooth, near their cracks, with the streets that they may border."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.street_candidates import in_long_strips
from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.polylines.join import Chains, taken
from tilepipe_kernels.polylines.parallel_lines import LEFT, RIGHT, opposite_samples, sample_lines
from tilepipe_kernels.polylines.simplify import simplify_chains

_STEP = 1.0
"""Distance of the samples by which the other border of a street is looked for (m), two pixels at least."""

_LONG_SIDE = 3
"""Cracks of a side that is no step of a staircase."""

_PASSES = 8
"""Passes of smoothing: a Gaussian of two cracks."""

_FARTHEST = 0.25
"""Farthest that smoothing moves a middle, in pixels: two chains around one pixel then keep apart."""

_STEPS = 16
"""Steps of a pixel to which the points are rounded, so that crossings are decided exactly."""

_CELL = 8
"""Pixels on a side of the cells by which segments that may meet are found."""

_GAP = 10.0
"""Longest gap in a border of a street (m)."""

_BESIDE = 0.3
"""Share of a line that must lie along a street to be a candidate for its border: lines go on where a street ends."""

_LEAST_CONTRAST = 1.0
"""Mean difference of grey (0-255) that makes one side of a line the darker one."""


@rule
def _cracks(vertices: NDArray[np.int32], k: int) -> int:
    """Cracks from one corner of a chain to the next; one of the two differences is 0."""
    cracks: int = abs(vertices[k + 1, 0] - vertices[k, 0]) + abs(vertices[k + 1, 1] - vertices[k, 1])
    return cracks


@loop
def _count_points(offsets: NDArray[np.int64], vertices: NDArray[np.int32], starts: NDArray[np.int64]) -> None:
    """Where the points of each chain start: its cracks, and its ends."""
    for line in range(offsets.size - 1):
        cracks = 0
        for k in range(offsets[line], offsets[line + 1] - 1):
            cracks += _cracks(vertices, k)
        starts[line + 1] = starts[line] + cracks + 2


@loop
def _place_points(
    offsets: NDArray[np.int64],
    vertices: NDArray[np.int32],
    starts: NDArray[np.int64],
    points: NDArray[np.float64],
    free: NDArray[np.bool_],
) -> None:
    """Middles of the cracks between the ends of each chain; those beside a corner of two long sides are not free."""
    for line in range(offsets.size - 1):
        first, last = offsets[line], offsets[line + 1] - 1
        at = starts[line] + 1
        points[at - 1] = vertices[first]
        for k in range(first, last):
            cracks = _cracks(vertices, k)
            for crack in range(cracks):
                share = (crack + 0.5) / cracks
                for axis in range(2):
                    points[at, axis] = vertices[k, axis] + share * (vertices[k + 1, axis] - vertices[k, axis])
                free[at] = True
                at += 1
            if k + 1 < last and min(cracks, _cracks(vertices, k + 1)) >= _LONG_SIDE:
                # the corner stands for both of its cracks, on which the line then bends
                points[at - 1] = vertices[k + 1]
                free[at - 1] = False
        points[at] = vertices[last]


@loop
def _smooth(starts: NDArray[np.int64], points: NDArray[np.float64], free: NDArray[np.bool_]) -> None:
    """Move free points to the mean of themselves and both neighbours again and again, but never far."""
    for line in range(starts.size - 1):
        first, last = starts[line], starts[line + 1]
        origin, before = points[first:last].copy(), points[first:last].copy()
        for _ in range(_PASSES):
            for k in range(1, last - first - 1):
                if not free[first + k]:
                    continue
                down = 0.25 * (before[k - 1, 0] + before[k + 1, 0]) + 0.5 * before[k, 0] - origin[k, 0]
                right = 0.25 * (before[k - 1, 1] + before[k + 1, 1]) + 0.5 * before[k, 1] - origin[k, 1]
                far = math.sqrt(down * down + right * right)
                share = _FARTHEST / far if far > _FARTHEST else 1.0
                points[first + k, 0], points[first + k, 1] = origin[k, 0] + share * down, origin[k, 1] + share * right
            before[:] = points[first:last]


@loop
def _round(
    starts: NDArray[np.int64], points: NDArray[np.float64], offsets: NDArray[np.int64], steps: NDArray[np.int32]
) -> None:
    """Points in whole steps of a pixel; those of a line that fall on one another are one."""
    at = 0
    for line in range(starts.size - 1):
        for k in range(starts[line], starts[line + 1]):
            row, column = np.int32(np.rint(points[k, 0] * _STEPS)), np.int32(np.rint(points[k, 1] * _STEPS))
            if k > starts[line] and row == steps[at - 1, 0] and column == steps[at - 1, 1]:
                continue
            steps[at, 0], steps[at, 1] = row, column
            at += 1
        offsets[line + 1] = at


def smoothed(lines: Chains, tolerance: float) -> Chains:
    """Polylines in pixels, float64: through the middles of the cracks, evened out and simplified.

    Ends stay where they are, and so do corners between two sides of three cracks or more.  The middles move by less
    than half the distance of the next line, and simplification lets no line come into conflict with another.  With a
    tolerance of 0.15 all is within half a pixel of the cracks.

    Parameters
    ----------
    lines
        Chains of cracks.
    tolerance
        Of the simplification, in pixels; 0 = none.
    """
    starts = np.zeros(len(lines) + 1, np.int64)
    _count_points(lines.offsets, lines.vertices, starts)
    points, free = np.empty((int(starts[-1]), 2)), np.zeros(int(starts[-1]), np.bool_)
    _place_points(lines.offsets, lines.vertices, starts, points, free)
    _smooth(starts, points, free)
    offsets, steps = np.zeros_like(starts), np.empty(points.shape, np.int32)
    _round(starts, points, offsets, steps)
    del points, free
    chains = Chains(offsets, steps[: offsets[-1]])
    if tolerance > 0:
        chains = simplify_chains(chains, tolerance, 1 / _STEPS, 1 / _STEPS, cell=_CELL * _STEPS)
    return Chains(chains.offsets, chains.vertices / _STEPS)


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
    chains: Chains, step: NDArray[np.float64], parameters: EdgeParameters, resolution: float, workers: int = 1
) -> Streets:
    """Lines that run parallel at the width of a street, the street being darker than both its sides, or brighter.

    Parameters
    ----------
    chains
        Polylines in pixels.
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
    lengths = chains.lengths()
    told = (lengths * resolution >= parameters.minimum_street_length) & (np.abs(step) >= _LEAST_CONTRAST)
    number_of = np.flatnonzero(told)
    samples = sample_lines(*taken(chains.offsets, chains.vertices, told), apart)
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
    number = np.bincount(line, minlength=len(chains))
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
