"""The rules and loops of nonlinear diffusion, see `diffusion`.

How the work is laid out.  One step at row `r` needs the rows `r - reach .. r + reach` of the step before.
Several steps therefore follow one another down the block, each `reach` rows behind its predecessor, so that a
row is still in the cache when the next step wants it.  All steps share one *turning* array of rows: a step
stores row `r` a few slots above the row it read, where nobody needs the old content any more, and slots are
counted modulo their number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule

Window = tuple[int, int, int, int]
Row = NDArray[np.float32]
Image = NDArray[np.float32]

_ZERO, _HALF, _ONE, _TWO, _QUARTER = (np.float32(value) for value in (0, 0.5, 1, 2, 0.25))
# A gradient below 1/1000 grey level has no direction; the rule holds twice the gradient, hence the 4.
_FLAT = np.float32(4e-6)
_EXPONENTIAL_SCALE = np.float32(-1 / 32)
_INVERSE_FACTORIALS = tuple(np.float32(1 / math.factorial(order)) for order in range(7))
_F2, _F3, _F4, _F5, _F6 = _INVERSE_FACTORIALS[2:]

CURVATURE, _EXPONENTIAL = 0, 1  # positions in diffusion.Model


class Terms(NamedTuple):
    """The equation as the loops need it."""

    model: int
    reach: int
    weights: NDArray[np.float32]
    time_step: np.float32
    strength: np.float32
    fidelity: np.float32


# ------------------------------------------------------------------------------------------------- site rules


@rule
def present(value: np.float32, centre: np.float32) -> np.float32:
    """Value of a neighbour; the centre's where the neighbour is missing (NaN): no flux across that side."""
    return value if value == value else centre


@rule
def edge_stopping(smooth_across: np.float32, smooth_down: np.float32, conductance: np.float32) -> np.float32:
    """Edge-stopping function g = 1 / (1 + k |∇(G_σ * u)|²) from twice the central differences of G_σ * u."""
    squared = _QUARTER * (smooth_across * smooth_across + smooth_down * smooth_down)
    return _ONE / (_ONE + conductance * squared)


@rule
def mean_curvature_motion(
    nw: np.float32, n: np.float32, ne: np.float32,
    w: np.float32, centre: np.float32, e: np.float32,
    sw: np.float32, s: np.float32, se: np.float32,
) -> np.float32:  # fmt: skip
    """|∇u| div(∇u/|∇u|) by central differences; its mean over all directions, Δu/2, where ∇u vanishes."""
    across, down = e - w, s - n
    twice = _TWO * centre
    second_across, second_down = (e + w) - twice, (s + n) - twice
    mixed = (se + nw) - (ne + sw)
    across_squared, down_squared = across * across + _FLAT, down * down + _FLAT
    along = second_across * down_squared + second_down * across_squared
    return (along - _HALF * (across * down) * mixed) / (across_squared + down_squared)


@rule
def relaxed(
    centre: np.float32, motion: np.float32, stopping: np.float32, given: np.float32,
    time_step: np.float32, fidelity: np.float32,
) -> np.float32:  # fmt: skip
    """One explicit Euler step of u_t = g |∇u| div(∇u/|∇u|) - λ (1 - g)(u - I) (Barcelos et al. 2003)."""
    return centre + time_step * (stopping * motion - fidelity * ((_ONE - stopping) * (centre - given)))


@rule
def lower(a: np.float32, b: np.float32) -> np.float32:
    """Smaller of two values; `a` when `b` is missing."""
    return b if b < a else a


@rule
def higher(a: np.float32, b: np.float32) -> np.float32:
    """Larger of two values; `a` when `b` is missing."""
    return b if b > a else a


@rule
def rational_flux(difference: np.float32, inverse_squared: np.float32) -> np.float32:
    """Flux d / (1 + (d/K)²) along a grey difference d (Perona & Malik 1990), given 1/K²."""
    return difference / (_ONE + inverse_squared * (difference * difference))


@rule
def exponential_flux(difference: np.float32, inverse_squared: np.float32) -> np.float32:
    """Flux d exp(-(d/K)²) along a grey difference d (Perona & Malik 1990), given 1/K².

    exp(x) = exp(x/32)^32 with a Taylor polynomial: only products and sums, so that every backend agrees and
    the loop vectorises; absolute error below 4e-6.
    """
    squared = inverse_squared * (difference * difference)
    x = _EXPONENTIAL_SCALE * (squared if squared < np.float32(80) else np.float32(80))
    power = _ONE + x * (_ONE + x * (_F2 + x * (_F3 + x * (_F4 + x * (_F5 + x * _F6)))))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * difference


# ------------------------------------------------------------------------------------------------- row loops


@loop
def _add_pair(total: Row, before: Row, centre: Row, after: Row, weight: np.float32) -> None:
    for j in range(total.size):
        total[j] += weight * (present(before[j], centre[j]) + present(after[j], centre[j]))


@loop
def _centre_and_three_pairs(
    total: Row, a3: Row, a2: Row, a1: Row, centre: Row, b1: Row, b2: Row, b3: Row, weights: Row
) -> None:
    """The same sums in the same order as `_add_pair` thrice, in one walk: twice as fast."""
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for j in range(total.size):
        here = centre[j]
        value = w0 * here + w1 * (present(a1[j], here) + present(b1[j], here))
        value += w2 * (present(a2[j], here) + present(b2[j], here))
        total[j] = value + w3 * (present(a3[j], here) + present(b3[j], here))


@loop
def _row(turning: Image, missing: Row, row: int, rows: int, offset: int) -> Row:
    """Padded row `row` of the step whose row 0 lies in slot `offset`; a row of NaN outside the block."""
    if row < 0 or row >= rows:
        return missing
    found: Row = turning[(row + offset) % turning.shape[0]]
    return found


@loop
def _smooth_row(
    result: Row, line: Row, turning: Image, missing: Row, weights: Row, row: int, rows: int, offset: int,
    start: int, stop: int,
) -> None:  # fmt: skip
    """G_σ * u of one row, padded columns start..stop: sums down the columns into `line`, then along it."""
    radius = weights.size - 1
    first, last = start - radius, stop + radius
    centre = _row(turning, missing, row, rows, offset)[first:last]
    total = line[first:last]
    if radius >= 3:
        a3 = _row(turning, missing, row - 3, rows, offset)[first:last]
        a2 = _row(turning, missing, row - 2, rows, offset)[first:last]
        a1 = _row(turning, missing, row - 1, rows, offset)[first:last]
        b1 = _row(turning, missing, row + 1, rows, offset)[first:last]
        b2 = _row(turning, missing, row + 2, rows, offset)[first:last]
        b3 = _row(turning, missing, row + 3, rows, offset)[first:last]
        _centre_and_three_pairs(total, a3, a2, a1, centre, b1, b2, b3, weights)
    else:
        for j in range(total.size):
            total[j] = weights[0] * centre[j]
    summed = 3 if radius >= 3 else 0
    for k in range(summed + 1, radius + 1):
        above = _row(turning, missing, row - k, rows, offset)[first:last]
        below = _row(turning, missing, row + k, rows, offset)[first:last]
        _add_pair(total, above, centre, below, weights[k])

    centre, total = line[start:stop], result[start:stop]
    if radius >= 3:
        a3, a2, a1 = line[start - 3 :], line[start - 2 :], line[start - 1 :]
        b1, b2, b3 = line[start + 1 :], line[start + 2 :], line[start + 3 :]
        _centre_and_three_pairs(total, a3, a2, a1, centre, b1, b2, b3, weights)
    else:
        for j in range(total.size):
            total[j] = weights[0] * centre[j]
    for k in range(summed + 1, radius + 1):
        _add_pair(total, line[start - k :], centre, line[start + k :], weights[k])


@loop
def _curvature_row(
    result: Row, above: Row, centre: Row, below: Row, smooth_above: Row, smooth: Row, smooth_below: Row,
    given: Row, terms: Terms,
) -> None:  # fmt: skip
    """One step along a row; the rows of u and of G_σ * u hold one column more on each side."""
    time_step, conductance, fidelity = terms.time_step, terms.strength, terms.fidelity
    for j in range(result.size):
        here = smooth[j + 1]
        across = present(smooth[j + 2], here) - present(smooth[j], here)
        down = present(smooth_below[j + 1], here) - present(smooth_above[j + 1], here)
        stopping = edge_stopping(across, down, conductance)

        here = centre[j + 1]
        nw, n, ne = present(above[j], here), present(above[j + 1], here), present(above[j + 2], here)
        w, e = present(centre[j], here), present(centre[j + 2], here)
        sw, s, se = present(below[j], here), present(below[j + 1], here), present(below[j + 2], here)
        motion = mean_curvature_motion(nw, n, ne, w, here, e, sw, s, se)
        moved = relaxed(here, motion, stopping, given[j], time_step, fidelity)
        floor = lower(lower(lower(nw, n), lower(ne, w)), lower(lower(e, sw), lower(s, se)))
        ceiling = higher(higher(higher(nw, n), higher(ne, w)), higher(higher(e, sw), higher(s, se)))
        floor = lower(floor, lower(here, given[j]))
        ceiling = higher(ceiling, higher(here, given[j]))
        result[j] = lower(higher(moved, floor), ceiling)


@loop
def _exponential_row(result: Row, above: Row, centre: Row, below: Row, terms: Terms) -> None:
    time_step, inverse_squared = terms.time_step, terms.strength
    for j in range(result.size):
        here = centre[j + 1]
        n = exponential_flux(present(above[j + 1], here) - here, inverse_squared)
        s = exponential_flux(present(below[j + 1], here) - here, inverse_squared)
        w = exponential_flux(present(centre[j], here) - here, inverse_squared)
        e = exponential_flux(present(centre[j + 2], here) - here, inverse_squared)
        result[j] = here + time_step * ((n + s) + (w + e))


@loop
def _rational_row(result: Row, above: Row, centre: Row, below: Row, terms: Terms) -> None:
    time_step, inverse_squared = terms.time_step, terms.strength
    for j in range(result.size):
        here = centre[j + 1]
        n = rational_flux(present(above[j + 1], here) - here, inverse_squared)
        s = rational_flux(present(below[j + 1], here) - here, inverse_squared)
        w = rational_flux(present(centre[j], here) - here, inverse_squared)
        e = rational_flux(present(centre[j + 2], here) - here, inverse_squared)
        result[j] = here + time_step * ((n + s) + (w + e))


# ------------------------------------------------------------------------------------------------- the steps


@loop
def load(turning: Image, image: Image, reach: int) -> None:
    """Copy the image into a frame of missing columns; what is not finite becomes missing."""
    rows, columns = image.shape
    for i in range(turning.shape[0]):
        row = turning[i]
        row[:reach] = np.nan
        row[reach + columns : 2 * reach + columns] = np.nan
        if i < rows:
            source, inner = image[i], row[reach : reach + columns]
            for j in range(columns):
                inner[j] = source[j] if source[j] - source[j] == _ZERO else np.float32(np.nan)


@loop
def run_steps(turning: Image, image: Image, window: Window, steps: int, at_once: int, terms: Terms) -> int:
    """All steps, `at_once` following one another down the block; return the slot of the result's row 0."""
    rows, columns = image.shape
    reach = terms.reach
    drift = reach + 1
    slots: int = turning.shape[0]
    missing = np.full(turning.shape[1], np.nan, np.float32)
    line = np.empty_like(missing)
    rings = np.empty((at_once, 3, missing.size), np.float32)
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
                left, right = max(0, window[2] - grown), min(columns, window[3] + grown)
                start, stop = reach + left, reach + right
                offset = slots * steps - step * drift
                above = _row(turning, missing, row - 1, rows, offset)[start - 1 : stop + 1]
                centre = _row(turning, missing, row, rows, offset)[start - 1 : stop + 1]
                below = _row(turning, missing, row + 1, rows, offset)[start - 1 : stop + 1]
                result = turning[(row + offset - drift) % slots, start:stop]
                if terms.model == CURVATURE:
                    ring = rings[behind]
                    for near in range(row - 1 if row == top else row + 1, row + 2):
                        _smooth_row(
                            ring[near % 3], line, turning, missing, terms.weights, near, rows, offset,
                            start - 1, stop + 1,
                        )  # fmt: skip
                    s0 = ring[(row - 1) % 3, start - 1 : stop + 1]
                    s1 = ring[row % 3, start - 1 : stop + 1]
                    s2 = ring[(row + 1) % 3, start - 1 : stop + 1]
                    _curvature_row(result, above, centre, below, s0, s1, s2, image[row, left:right], terms)
                elif terms.model == _EXPONENTIAL:
                    _exponential_row(result, above, centre, below, terms)
                else:
                    _rational_row(result, above, centre, below, terms)
    return (slots - drift) * steps % slots
