"""Nonlinear diffusion: smooth within regions, keep the edges between them (`streets`, step 1).

How the work is laid out.  One step at row `r` needs the rows `r - reach .. r + reach` of the step before.
Several steps therefore follow one another down the block, each `reach` rows behind its predecessor, so that a
row is still in the cache when the next step wants it.  All steps share one *turning* array of rows: a step
stores row `r` a few slots above the row it read, where nobody needs the old content any more, and slots are
counted modulo their number.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compiled import loop, rule

Model = Literal["curvature", "perona-malik-exponential", "perona-malik-rational"]
Window = tuple[int, int, int, int]
Row = NDArray[np.float32]
Image = NDArray[np.float32]

_ZERO, _HALF, _ONE, _TWO, _QUARTER = (np.float32(value) for value in (0, 0.5, 1, 2, 0.25))
# A gradient below 1/1000 grey level has no direction; the rule holds twice the gradient, hence the 4.
_FLAT = np.float32(4e-6)
_EXPONENTIAL_SCALE = np.float32(-1 / 32)
_INVERSE_FACTORIALS = tuple(np.float32(1 / math.factorial(order)) for order in range(7))
_F2, _F3, _F4, _F5, _F6 = _INVERSE_FACTORIALS[2:]

_CURVATURE, _EXPONENTIAL = 0, 1  # positions in Model
_CACHE_BYTES = 1_000_000
_MOST_STEPS_AT_ONCE = 8


class _Terms(NamedTuple):
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
    given: Row, terms: _Terms,
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
def _exponential_row(result: Row, above: Row, centre: Row, below: Row, terms: _Terms) -> None:
    time_step, inverse_squared = terms.time_step, terms.strength
    for j in range(result.size):
        here = centre[j + 1]
        n = exponential_flux(present(above[j + 1], here) - here, inverse_squared)
        s = exponential_flux(present(below[j + 1], here) - here, inverse_squared)
        w = exponential_flux(present(centre[j], here) - here, inverse_squared)
        e = exponential_flux(present(centre[j + 2], here) - here, inverse_squared)
        result[j] = here + time_step * ((n + s) + (w + e))


@loop
def _rational_row(result: Row, above: Row, centre: Row, below: Row, terms: _Terms) -> None:
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
def _load(turning: Image, image: Image, reach: int) -> None:
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
def _diffuse(turning: Image, image: Image, window: Window, steps: int, at_once: int, terms: _Terms) -> int:
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
                if terms.model == _CURVATURE:
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


# ------------------------------------------------------------------------------------------------- public


def largest_stable_time_step(model: Model = "curvature") -> float:
    """Largest time step of the explicit scheme that makes no new extrema.

    Perona–Malik: a step is a mean of the five values with weights >= 0 while ``time_step <= 1/4``.
    Curvature: with frozen coefficients the central differences have the symbol ``-4 g`` at worst, so that
    ``time_step <= 1/2`` is stable in the 2-norm; `diffuse` secures the extrema themselves.
    """
    _check_model(model)
    return 0.5 if model == "curvature" else 0.25


def halo(steps: int, gradient_sigma: float = 1.0, model: Model = "curvature") -> int:
    """Pixels on each side on which a result depends: exact, `steps` times the radius of one step.

    One step of the curvature model needs the Gaussian, cut off at ``ceil(3 σ)``, at the four neighbours; one
    step of Perona–Malik needs the four neighbours.
    """
    _check_model(model)
    return steps * _reach(gradient_sigma, model)


def diffuse(
    block: ArrayLike,
    *,
    steps: int,
    time_step: float,
    conductance: float,
    gradient_sigma: float = 1.0,
    fidelity: float = 1.0,
    model: Model = "curvature",
    core: Window | None = None,
) -> NDArray[np.float32]:
    """Smooth an image by nonlinear diffusion, explicit Euler.

    ``"curvature"`` (Barcelos, Boaventura & Silva 2003)::

        u_t = g |∇u| div(∇u/|∇u|) - λ (1 - g)(u - I),    g = 1 / (1 + k |∇(G_σ * u)|²),    u(0) = I

    ``"perona-malik-exponential"`` and ``"perona-malik-rational"`` (Perona & Malik 1990, eq. 7)::

        u_t = Σ over the 4 neighbours of c(d) d,    c = exp(-(d/K)²)  or  1 / (1 + (d/K)²)

    The mixed derivative gives some neighbours negative weights, so central differences of the curvature term
    can overshoot at noisy pixels although the equation itself makes no new extrema.  Each step of that model
    is therefore limited to the range of u in the 3 x 3 neighbourhood and of I at the pixel.

    Parameters
    ----------
    block
        Grey values, shape (rows, columns), any real dtype, on a 0..255 scale (k and K depend on it).  Values
        that are not finite are nodata: they stay missing (NaN) and neither give nor take; a missing
        neighbour, or one outside the block, counts as equal to the centre, also in each of the two
        one-dimensional Gaussian sums.
    steps
        Number of time steps.
    time_step
        At most `largest_stable_time_step`.
    conductance
        k >= 0 of the curvature model, per squared grey level; edge threshold K > 0 of Perona–Malik.
    gradient_sigma
        Standard deviation σ of the Gaussian, pixels; 0 = none.  Curvature model only.
    fidelity
        λ in [0, 1].  Curvature model only.
    model
        Which equation.
    core
        Window (first row, end row, first column, end column) of the block that is wanted; each step then
        computes only what the following steps need of it.  None = all.

    Returns
    -------
    ndarray of float32
        The smoothed core.

    Raises
    ------
    ValueError
        For an unstable time step (the message names the bound), a parameter out of range, a block that is not
        a two-dimensional real array, a core outside the block.
    """
    image = np.asarray(block)
    if image.ndim != 2 or image.dtype.kind not in "buif":
        raise ValueError(f"diffuse needs a two-dimensional real block, not {image.dtype} of shape {image.shape}")
    _check_parameters(steps, time_step, conductance, gradient_sigma, fidelity, model)
    rows, columns = image.shape
    r0, r1, c0, c1 = (0, rows, 0, columns) if core is None else (int(edge) for edge in core)
    if not (0 <= r0 <= r1 <= rows and 0 <= c0 <= c1 <= columns):
        raise ValueError(f"core {core} does not lie in the block of {rows} x {columns} pixels")
    if r0 == r1 or c0 == c1:
        return np.empty((r1 - r0, c1 - c0), np.float32)

    image = np.ascontiguousarray(image, dtype=np.float32)
    reach = _reach(gradient_sigma, model)
    padded = _padded_width(columns + 2 * reach)
    # A step in flight needs `reach` rows of the image and twice as many turning ones in the cache.
    at_once = max(1, min(_MOST_STEPS_AT_ONCE, steps, _CACHE_BYTES // (4 * padded * (3 * reach + 6))))
    turning = np.empty((rows + at_once * (reach + 1), padded), np.float32)
    _load(turning, image, reach)
    curvature = model == "curvature"
    # Bounded, so that the float32 strength is finite: infinity times a zero gradient would be NaN.
    strength = min(conductance, 1e30) if curvature else max(conductance, 1e-15) ** -2
    terms = _Terms(
        model=get_args(Model).index(model),
        reach=reach,
        weights=_gaussian_weights(gradient_sigma if curvature else 0.0),
        time_step=np.float32(time_step),
        strength=np.float32(strength),
        fidelity=np.float32(fidelity),
    )
    first = _diffuse(turning, image, (r0, r1, c0, c1), int(steps), at_once, terms)
    slots = (first + np.arange(r0, r1)) % turning.shape[0]
    result: NDArray[np.float32] = turning[slots, reach + c0 : reach + c1]
    return result


def _reach(gradient_sigma: float, model: Model) -> int:
    return math.ceil(3 * gradient_sigma) + 1 if model == "curvature" else 1


def _padded_width(width: int) -> int:
    """Width of a stored row: whole cache lines; near rows must not fall together modulo a 4 KiB page."""
    lines = -(-width // 16)
    while not 4 < lines % 64 < 60:
        lines += 1
    return 16 * lines


def _gaussian_weights(sigma: float) -> NDArray[np.float32]:
    """Weights of the centre and of one neighbour at distance 1, 2, ...; centre + 2 x the others = 1."""
    distance = np.arange(math.ceil(3 * sigma) + 1)
    weights = np.exp(-0.5 * (distance / max(sigma, 1e-9)) ** 2)
    weights = (weights / (2 * weights.sum() - 1)).astype(np.float32)
    weights[0] = 1 - 2 * weights[1:].sum(dtype=np.float64)
    return np.asarray(weights, np.float32)


def _check_model(model: str) -> None:
    if model not in get_args(Model):
        raise ValueError(f"unknown diffusion model {model!r}; choose one of {', '.join(get_args(Model))}")


def _check_parameters(
    steps: int, time_step: float, conductance: float, gradient_sigma: float, fidelity: float, model: Model
) -> None:
    _check_model(model)
    bound = largest_stable_time_step(model)
    if not 0 < time_step <= bound:
        raise ValueError(f"time_step {time_step} is not stable; the {model} model needs 0 < time_step <= {bound}")
    if steps < 0:
        raise ValueError(f"steps must be 0 or more, not {steps}")
    if not math.isfinite(conductance) or conductance < 0 or (conductance == 0 and model != "curvature"):
        raise ValueError(f"conductance must be a positive number, not {conductance}")
    if not 0 <= gradient_sigma < math.inf:
        raise ValueError(f"gradient_sigma must be 0 or more pixels, not {gradient_sigma}")
    if not 0 <= fidelity <= 1:
        raise ValueError(f"fidelity must lie between 0 and 1, not {fidelity}")
