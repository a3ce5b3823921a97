"""The lines of a line field as polylines: smoothed within half a pixel, with the streets that they may border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.arc_network import Chains, Lines
from tilepipe.arc_simplification import simplify_chains
from tilepipe.edge_parameters import EdgeParameters
from tilepipe_kernels.compiled import loop
from tilepipe_kernels.parallel_lines import LEFT, RIGHT, opposite_samples, sample_lines

_STEP = 1.0
"""Distance of the samples by which the other border of a street is looked for (m), two pixels at least."""

_BESIDE = 0.5
"""Share of a line that must lie opposite other lines to be a candidate for the border of a street."""

_LEAST_CONTRAST = 1.0
"""Mean difference of grey (0-255) that makes one side of a line the darker one."""


@loop
def _midpoints(
    offsets: NDArray[np.int64], vertices: NDArray[np.int32], starts: NDArray[np.int64], doubled: NDArray[np.int32]
) -> None:
    for line in range(offsets.size - 1):
        first, last = offsets[line], offsets[line + 1] - 1
        closed = vertices[first, 0] == vertices[last, 0] and vertices[first, 1] == vertices[last, 1]
        at = starts[line]
        if not closed:
            doubled[at, 0], doubled[at, 1] = 2 * vertices[first, 0], 2 * vertices[first, 1]
            at += 1
        for k in range(first, last):
            down, right = vertices[k + 1, 0] - vertices[k, 0], vertices[k + 1, 1] - vertices[k, 1]
            cracks = max(abs(down), abs(right))
            for crack in range(cracks):
                doubled[at, 0] = 2 * vertices[k, 0] + (2 * crack + 1) * down // cracks
                doubled[at, 1] = 2 * vertices[k, 1] + (2 * crack + 1) * right // cracks
                at += 1
        if closed:
            doubled[at, 0], doubled[at, 1] = doubled[starts[line], 0], doubled[starts[line], 1]
        else:
            doubled[at, 0], doubled[at, 1] = 2 * vertices[last, 0], 2 * vertices[last, 1]


def through_midpoints(chains: Chains) -> Chains:
    """Chains of cracks led through the middles of the cracks, in half pixels: staircases become straight.

    The ends stay where they are; a ring has only middles.  The new chains lie within 0.36 pixels of the cracks.
    """
    cracks = chains.lengths().astype(np.int64)
    first, last = chains.vertices[chains.offsets[:-1]], chains.vertices[chains.offsets[1:] - 1]
    closed = (first == last).all(axis=1)
    starts = np.concatenate([[0], np.cumsum(cracks + np.where(closed, 1, 2))])
    doubled = np.empty((int(starts[-1]), 2), np.int32)
    _midpoints(chains.offsets, chains.vertices, starts, doubled)
    return Chains(starts, doubled)


def smoothed(lines: Lines, tolerance: float) -> Chains:
    """Polylines in pixels, float64: through the middles of the cracks, simplified within a tolerance in pixels."""
    chains = through_midpoints(lines)
    if tolerance > 0:
        chains = simplify_chains(chains, tolerance, 0.5, 0.5)
    return Chains(chains.offsets, chains.vertices / 2)


class Streets(NamedTuple):
    """Candidates for borders of streets, by line.

    Attributes
    ----------
    candidate
        Whether half of the line or more has another border opposite it, on one side, for at least the street's width.
    width
        Median width of the street, in pixels; NaN where there is none.
    partner
        The line that is opposite most often, -1 = none.
    share
        Share of the line with a border opposite it.
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
    samples = sample_lines(chains.offsets, chains.vertices, apart)
    darker = np.where(step >= _LEAST_CONTRAST, RIGHT, np.where(step <= -_LEAST_CONTRAST, LEFT, -1)).astype(np.int8)
    seen, width = opposite_samples(
        samples,
        darker,
        step=apart,
        least=parameters.minimum_street_width / resolution,
        most=parameters.maximum_street_width / resolution,
        angle=parameters.maximum_street_angle,
        workers=workers,
    )
    number = np.bincount(samples.line, minlength=len(chains))
    left, right = (
        _side(samples.line, np.where(seen[:, side] >= 0, samples.line[seen[:, side]], -1), width[:, side], number)
        for side in (LEFT, RIGHT)
    )
    better = right.share > left.share
    share, width, partner = (
        np.where(better, getattr(right, name), getattr(left, name)) for name in ("share", "width", "partner")
    )
    candidate = (share >= _BESIDE) & (share * chains.lengths() >= width)
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
