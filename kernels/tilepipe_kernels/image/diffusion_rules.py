"""The rules of nonlinear diffusion, one formula each, for the loops of the CPU and the grids of a device alike.

They are small enough for the compiler to set into its caller; only then can it vectorise the loop.
"""

from __future__ import annotations

import math

import numpy as np

from tilepipe_kernels.core.compiled import rule

Five = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]
Nine = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
# None where no value in reach can be missing: the compiler then leaves the tests out, half of the work.
Gaps = bool | None

_HALF, _ONE, _TWO, _QUARTER = (np.float32(value) for value in (0.5, 1, 2, 0.25))
# A gradient below 1/1000 grey level has no direction; the rule holds twice the gradient, hence the 4.
_FLAT = np.float32(4e-6)
_EXPONENTIAL_SCALE = np.float32(-1 / 32)
_INVERSE_FACTORIALS = tuple(np.float32(1 / math.factorial(order)) for order in range(7))
_F2, _F3, _F4, _F5, _F6 = _INVERSE_FACTORIALS[2:]


@rule
def present(value: np.float32, centre: np.float32, gaps: Gaps) -> np.float32:
    """Value of a neighbour; the centre's where the neighbour is missing (NaN): no flux across that side."""
    if gaps is None:
        return value
    return value if value == value else centre


@rule
def edge_strength(smooth: Five, conductance: np.float32, gaps: Gaps) -> np.float32:
    """Strength k |∇(G_σ * u)|² of an edge: g = 1 / (1 + it); from G_σ * u above, left, here, right and below."""
    n, w, here, e, s = smooth
    across, down = present(e, here, gaps) - present(w, here, gaps), present(s, here, gaps) - present(n, here, gaps)
    return conductance * (_QUARTER * (across * across + down * down))


@rule
def all_present(near: Nine, gaps: Gaps) -> Nine:
    """Values of the 3 x 3 neighbourhood, row by row; the centre's where one is missing."""
    nw, n, ne, w, here, e, sw, s, se = near
    nw, n, ne = present(nw, here, gaps), present(n, here, gaps), present(ne, here, gaps)
    sw, s, se = present(sw, here, gaps), present(s, here, gaps), present(se, here, gaps)
    return nw, n, ne, present(w, here, gaps), here, present(e, here, gaps), sw, s, se


@rule
def mean_curvature_motion(near: Nine) -> tuple[np.float32, np.float32]:
    """|∇u| div(∇u/|∇u|) by central differences, as numerator and denominator; Δu/2 where ∇u vanishes."""
    nw, n, ne, w, centre, e, sw, s, se = near
    across, down = e - w, s - n
    twice = _TWO * centre
    second_across, second_down = (e + w) - twice, (s + n) - twice
    mixed = (se + nw) - (ne + sw)
    across_squared, down_squared = across * across + _FLAT, down * down + _FLAT
    along = second_across * down_squared + second_down * across_squared
    return along - _HALF * (across * down) * mixed, across_squared + down_squared


@rule
def moved_by_curvature(
    near: Nine, smooth: Five, given: np.float32, time_step: np.float32, conductance: np.float32, fidelity: np.float32,
    gaps: Gaps,
) -> np.float32:  # fmt: skip
    """One explicit Euler step of u_t = g |∇u| div(∇u/|∇u|) - λ (1 - g)(u - I) (Barcelos et al. 2003).

    With g = 1 / (1 + E) and the motion N / D the right side is (N - λ E D (u - I)) / ((1 + E) D): one division.
    """
    strength = edge_strength(smooth, conductance, gaps)
    numerator, denominator = mean_curvature_motion(all_present(near, gaps))
    centre = near[4]
    drawn_back = fidelity * (strength * denominator * (centre - given))
    return centre + time_step * ((numerator - drawn_back) / ((_ONE + strength) * denominator))


@rule
def lower(a: np.float32, b: np.float32) -> np.float32:
    """Smaller of two values; `a` when `b` is missing."""
    return b if b < a else a


@rule
def higher(a: np.float32, b: np.float32) -> np.float32:
    """Larger of two values; `a` when `b` is missing."""
    return b if b > a else a


@rule
def with_pair(
    total: np.float32, weight: np.float32, before: np.float32, after: np.float32, centre: np.float32, gaps: Gaps
) -> np.float32:
    """One-dimensional Gaussian sum with one more pair of neighbours at the same distance from the centre."""
    return total + weight * (present(before, centre, gaps) + present(after, centre, gaps))


@rule
def limited(moved: np.float32, near: Nine, given: np.float32, gaps: Gaps) -> np.float32:
    """Value held in the range of u in the 3 x 3 neighbourhood and of I at the pixel."""
    nw, n, ne, w, here, e, sw, s, se = all_present(near, gaps)
    floor = lower(lower(lower(nw, n), lower(ne, w)), lower(lower(e, sw), lower(s, se)))
    ceiling = higher(higher(higher(nw, n), higher(ne, w)), higher(higher(e, sw), higher(s, se)))
    floor = lower(floor, lower(here, given))
    ceiling = higher(ceiling, higher(here, given))
    return lower(higher(moved, floor), ceiling)


@rule
def rational_flux(
    neighbour: np.float32, centre: np.float32, inverse_squared: np.float32, gaps: Gaps
) -> np.float32:  # fmt: skip
    """Flux d / (1 + (d/K)²) from a neighbour, d grey levels brighter (Perona & Malik 1990), given 1/K²."""
    difference = present(neighbour, centre, gaps) - centre
    return difference / (_ONE + inverse_squared * (difference * difference))


@rule
def exponential_flux(
    neighbour: np.float32, centre: np.float32, inverse_squared: np.float32, gaps: Gaps
) -> np.float32:  # fmt: skip
    """Flux d exp(-(d/K)²) from a neighbour, d grey levels brighter (Perona & Malik 1990), given 1/K².

    exp(x) = exp(x/32)^32 with a Taylor polynomial: only products and sums, so that every backend agrees and
    the loop vectorises; absolute error below 4e-6.
    """
    difference = present(neighbour, centre, gaps) - centre
    squared = inverse_squared * (difference * difference)
    x = _EXPONENTIAL_SCALE * (squared if squared < np.float32(80) else np.float32(80))
    power = _ONE + x * (_ONE + x * (_F2 + x * (_F3 + x * (_F4 + x * (_F5 + x * _F6)))))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * difference


@rule
def flowed(
    centre: np.float32, n: np.float32, w: np.float32, e: np.float32, s: np.float32, time_step: np.float32
) -> np.float32:
    """One explicit Euler step of Perona–Malik, given the fluxes from the four neighbours."""
    return centre + time_step * ((n + s) + (w + e))
