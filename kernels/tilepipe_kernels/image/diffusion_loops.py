"""The loops of nonlinear diffusion over the rows of a block, see `diffusion` and `diffusion_rules`.

How the work is laid out.  One step at row `r` needs the rows `r - reach .. r + reach` of the step before.
Several steps therefore follow one another down the block, each `reach` rows behind its predecessor, so that a
row is still in the cache when the next step wants it.  All steps share one *turning* array of rows: a step
stores row `r` a few slots above the row it read, where nobody needs the old content any more, and slots are
counted modulo their number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.image.diffusion_rules import (
    Gaps,
    exponential_flux,
    flowed,
    limited,
    moved_by_curvature,
    rational_flux,
    with_pair,
)

Window = tuple[int, int, int, int]
Flat = NDArray[np.float32]
Three = tuple[int, int, int]
Seven = tuple[int, int, int, int, int, int, int]
Image = NDArray[np.float32]
Counts = NDArray[np.int64]

CURVATURE, EXPONENTIAL = 0, 1  # positions in diffusion.Model


class Terms(NamedTuple):
    """The equation as the loops need it."""

    model: int
    reach: int
    weights: NDArray[np.float32]
    time_step: np.float32
    strength: np.float32
    fidelity: np.float32


class Rows(NamedTuple):
    """The slots of u, each a row of the block in a frame of missing columns, and one slot of NaN; see `load`."""

    flat: Flat
    whole: Counts
    slots: int
    width: int
    columns: int
    frame: int


# ------------------------------------------------------------------------------------------------- row loops
# Rows travel as a flat array and a position, and become views only here: a view that is handed on costs a
# reference count each time, as much as tens of pixels.


@loop
def _add_pair(
    total: Flat, to: int, flat: Flat, before: int, centre: int, after: int, count: int, weight: np.float32, gaps: Gaps
) -> None:
    sums, here = total[to : to + count], flat[centre : centre + count]
    left, right = flat[before : before + count], flat[after : after + count]
    for j in range(count):
        sums[j] = with_pair(sums[j], weight, left[j], right[j], here[j], gaps)


@loop
def _centre_and_three_pairs(
    total: Flat, to: int, flat: Flat, rows: Seven, count: int, weights: Flat, gaps: Gaps
) -> None:
    """The same sums in the same order as `_add_pair` thrice, in one walk: twice as fast."""
    a3, a2, a1 = flat[rows[0] : rows[0] + count], flat[rows[1] : rows[1] + count], flat[rows[2] : rows[2] + count]
    b1, b2, b3 = flat[rows[4] : rows[4] + count], flat[rows[5] : rows[5] + count], flat[rows[6] : rows[6] + count]
    centre, sums = flat[rows[3] : rows[3] + count], total[to : to + count]
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for j in range(count):
        here = centre[j]
        value = with_pair(w0 * here, w1, a1[j], b1[j], here, gaps)
        value = with_pair(value, w2, a2[j], b2[j], here, gaps)
        sums[j] = with_pair(value, w3, a3[j], b3[j], here, gaps)


@loop
def _curvature_row(
    u: Flat, to: int, rows: Three, smooth: Flat, smooth_rows: Three, given: Flat, wanted: int, count: int,
    terms: Terms, gaps: Gaps,
) -> None:  # fmt: skip
    """One step along a row: u at the positions `rows` and G_σ * u at `smooth_rows`, above, on and below it."""
    time_step, conductance, fidelity = terms.time_step, terms.strength, terms.fidelity
    result, original = u[to : to + count], given[wanted : wanted + count]
    above, centre = u[rows[0] - 1 : rows[0] + count + 1], u[rows[1] - 1 : rows[1] + count + 1]
    below = u[rows[2] - 1 : rows[2] + count + 1]
    smooth_above = smooth[smooth_rows[0] : smooth_rows[0] + count]
    smooth_centre = smooth[smooth_rows[1] - 1 : smooth_rows[1] + count + 1]
    smooth_below = smooth[smooth_rows[2] : smooth_rows[2] + count]
    for j in range(count):
        near = (
            above[j], above[j + 1], above[j + 2], centre[j], centre[j + 1], centre[j + 2],
            below[j], below[j + 1], below[j + 2],
        )  # fmt: skip
        smoothed = (smooth_above[j], smooth_centre[j], smooth_centre[j + 1], smooth_centre[j + 2], smooth_below[j])
        moved = moved_by_curvature(near, smoothed, original[j], time_step, conductance, fidelity, gaps)
        result[j] = limited(moved, near, original[j], gaps)


@loop
def _exponential_row(u: Flat, to: int, rows: Three, count: int, terms: Terms, gaps: Gaps) -> None:
    time_step, inverse_squared = terms.time_step, terms.strength
    result, centre = u[to : to + count], u[rows[1] - 1 : rows[1] + count + 1]
    above, below = u[rows[0] : rows[0] + count], u[rows[2] : rows[2] + count]
    for j in range(count):
        here = centre[j + 1]
        n = exponential_flux(above[j], here, inverse_squared, gaps)
        w = exponential_flux(centre[j], here, inverse_squared, gaps)
        e = exponential_flux(centre[j + 2], here, inverse_squared, gaps)
        s = exponential_flux(below[j], here, inverse_squared, gaps)
        result[j] = flowed(here, n, w, e, s, time_step)


@loop
def _rational_row(u: Flat, to: int, rows: Three, count: int, terms: Terms, gaps: Gaps) -> None:
    time_step, inverse_squared = terms.time_step, terms.strength
    result, centre = u[to : to + count], u[rows[1] - 1 : rows[1] + count + 1]
    above, below = u[rows[0] : rows[0] + count], u[rows[2] : rows[2] + count]
    for j in range(count):
        here = centre[j + 1]
        n = rational_flux(above[j], here, inverse_squared, gaps)
        w = rational_flux(centre[j], here, inverse_squared, gaps)
        e = rational_flux(centre[j + 2], here, inverse_squared, gaps)
        s = rational_flux(below[j], here, inverse_squared, gaps)
        result[j] = flowed(here, n, w, e, s, time_step)


# ----------------------------------------------------------------------------------------------- rows in spans


@loop
def _at(u: Rows, row: int, offset: int) -> int:
    """Position of padded row `row` of the step whose row 0 lies in slot `offset`; of NaN outside the block."""
    slot: int = u.slots if row < 0 or row >= u.whole.size - 1 else (row + offset) % u.slots
    return slot * u.width


@loop
def _whole_span(u: Rows, row: int, radius: int, start: int, stop: int) -> tuple[int, int]:
    """Part of the padded columns start..stop of a row where nothing within `radius` is missing; maybe empty."""
    below = row + radius + 1
    if row < radius or below >= u.whole.size or u.whole[below] - u.whole[row - radius] <= 2 * radius:
        return start, start
    first = min(max(start, u.frame + radius), stop)
    return first, max(first, min(stop, u.frame + u.columns - radius))


@loop
def _smooth_span(
    ring: Flat, to: int, line: Flat, u: Rows, weights: Flat, row: int, offset: int, start: int, stop: int, gaps: Gaps
) -> None:
    """G_σ * u of one row, padded columns start..stop: sums down the columns into `line`, then along it."""
    if start == stop:
        return
    radius = weights.size - 1
    first, count = start - radius, stop - start + 2 * radius
    centre = _at(u, row, offset) + first
    if radius >= 3:
        a3, b3 = _at(u, row - 3, offset) + first, _at(u, row + 3, offset) + first
        a2, b2 = _at(u, row - 2, offset) + first, _at(u, row + 2, offset) + first
        a1, b1 = _at(u, row - 1, offset) + first, _at(u, row + 1, offset) + first
        _centre_and_three_pairs(line, first, u.flat, (a3, a2, a1, centre, b1, b2, b3), count, weights, gaps)
    else:
        for j in range(count):
            line[first + j] = weights[0] * u.flat[centre + j]
    summed = 3 if radius >= 3 else 0
    for k in range(summed + 1, radius + 1):
        above, below = _at(u, row - k, offset) + first, _at(u, row + k, offset) + first
        _add_pair(line, first, u.flat, above, centre, below, count, weights[k], gaps)

    i, count = start, stop - start
    if radius >= 3:
        near = (i - 3, i - 2, i - 1, i, i + 1, i + 2, i + 3)
        _centre_and_three_pairs(ring, to + i, line, near, count, weights, gaps)
    else:
        for j in range(count):
            ring[to + i + j] = weights[0] * line[i + j]
    for k in range(summed + 1, radius + 1):
        _add_pair(ring, to + i, line, i - k, i, i + k, count, weights[k], gaps)


@loop
def _smooth_row(
    ring: Flat, to: int, line: Flat, u: Rows, weights: Flat, row: int, offset: int, start: int, stop: int
) -> None:
    """G_σ * u of one row, padded columns start..stop."""
    first, last = _whole_span(u, row, weights.size - 1, start, stop)
    _smooth_span(ring, to, line, u, weights, row, offset, start, first, True)
    _smooth_span(ring, to, line, u, weights, row, offset, first, last, None)
    _smooth_span(ring, to, line, u, weights, row, offset, last, stop, True)


@loop
def _step_span(
    u: Rows, to: int, ring: Flat, ring_start: int, given: Image, row: int, offset: int, start: int, stop: int,
    terms: Terms, gaps: Gaps,
) -> None:  # fmt: skip
    """One step of one row, padded columns start..stop."""
    if start == stop:
        return
    count = stop - start
    rows = (_at(u, row - 1, offset) + start, _at(u, row, offset) + start, _at(u, row + 1, offset) + start)
    if terms.model == CURVATURE:
        at = ring_start + start
        smooth = (at + (row - 1) % 3 * u.width, at + row % 3 * u.width, at + (row + 1) % 3 * u.width)
        wanted = row * u.columns + start - u.frame
        _curvature_row(u.flat, to + start, rows, ring, smooth, given, wanted, count, terms, gaps)
    elif terms.model == EXPONENTIAL:
        _exponential_row(u.flat, to + start, rows, count, terms, gaps)
    else:
        _rational_row(u.flat, to + start, rows, count, terms, gaps)


# ------------------------------------------------------------------------------------------------- the steps


@loop
def load(turning: Image, image: Image, reach: int) -> Counts:
    """Copy the image into a frame of missing columns, what is not finite missing; the last row is all missing.

    Returns the number of rows without missing values above each row of the image.
    """
    rows, columns = image.shape
    whole = np.zeros(rows + 1, np.int64)
    for i in range(turning.shape[0]):
        row = turning[i]
        row[:reach] = np.nan
        row[reach + columns : 2 * reach + columns] = np.nan
        if i < rows:
            source, inner = image[i], row[reach : reach + columns]
            finite = True
            for j in range(columns):
                kept = source[j] - source[j] == np.float32(0)
                finite &= kept
                inner[j] = source[j] if kept else np.float32(np.nan)
            whole[i + 1] = whole[i] + finite
    turning[-1] = np.nan
    return whole


@loop
def run_steps(
    turning: Image, image: Image, whole: Counts, window: Window, steps: int, at_once: int, terms: Terms
) -> int:
    """All steps, `at_once` following one another down the block; return the slot of the result's row 0."""
    rows, columns = image.shape
    reach = terms.reach
    drift = reach + 1
    slots, width = turning.shape[0] - 1, turning.shape[1]
    u = Rows(turning.reshape(-1), whole, slots, width, columns, reach)
    given = image.reshape(-1)
    line = np.empty(width, np.float32)
    ring = np.empty(at_once * 3 * width, np.float32)
    for sweep in range(0, steps, at_once):
        count = min(at_once, steps - sweep)
        grown = (steps - 1 - sweep) * reach
        for front in range(max(0, window[0] - grown), min(rows, window[1] + grown) + (count - 1) * reach):
            for behind in range(count):
                step, row = sweep + behind, front - behind * reach
                grown = (steps - 1 - step) * reach
                top, bottom = max(0, window[0] - grown), min(rows, window[1] + grown)
                if row < top or row >= bottom:
                    continue
                start = reach + max(0, window[2] - grown)
                stop = reach + min(columns, window[3] + grown)
                offset = slots * steps - step * drift
                own = behind * 3 * width
                if terms.model == CURVATURE:
                    for near in range(row - 1 if row == top else row + 1, row + 2):
                        to = own + near % 3 * width
                        _smooth_row(ring, to, line, u, terms.weights, near, offset, start - 1, stop + 1)
                to = (row + offset - drift) % slots * width
                first, last = _whole_span(u, row, 1, start, stop)
                _step_span(u, to, ring, own, given, row, offset, start, first, terms, True)
                _step_span(u, to, ring, own, given, row, offset, first, last, terms, None)
                _step_span(u, to, ring, own, given, row, offset, last, stop, terms, True)
    slot: int = (slots - drift) * steps % slots
    return slot
