"""The bar profile as model of a line: what response, scale, width and noise have to do with each other.

A line of half-width w is the profile ``0 | 1 | a`` times a contrast, for ``x < -w``, ``|x| <= w``, ``x > w`` (Steger
1998, Section 2). Lengths inside the rules are in units of sigma, so the model has no scale.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import rule

# Bisection brings Newton's method near enough to converge; four steps then leave no error that float32 shows.
BISECTIONS, NEWTON_STEPS = 7, 4

# Log of the smallest ratio of edge gradients that still counts as an edge: below 1/1000 it is rounding, no
# bar.
FAINTEST_EDGE = -7.0


def sigma_for_width(width: float) -> float:
    """Smallest scale at which the response of a bar of this full width has one clear extremum: w / sqrt(3).

    ``w`` is the half-width (Steger 1998, Eq. 11 f.).  Same unit as the width.

    Examples
    --------
    The scale at which streets of 12 pixels have one ridge.

    >>> from tilepipe_kernels.ridges.bar_profile import sigma_for_width
    >>> round(sigma_for_width(12), 2)
    3.46
    """
    if not width > 0:
        raise ValueError(f"width is {width}: give the full width of a line, a positive length")
    return width / (2 * math.sqrt(3))


def response_of_bar(half_width: float, contrast: float, sigma: float) -> float:
    """Second-derivative magnitude at the centre of a symmetric bar, to set thresholds by width and contrast.

    ``contrast · 2w / (sqrt(2π) σ³) · exp(-w² / (2σ²))`` (Steger 1998, Eq. 10 at x = 0).  Steger's rule:
    ``high`` is the response of the narrowest line at the contrast that makes a line, ``low`` at the contrast
    that keeps one.

    Parameters
    ----------
    half_width, sigma
        Half-width of the bar and Gaussian scale in pixels.
    contrast
        Grey difference between bar and background.

    Returns
    -------
    float
        Grey per pixel².

    Examples
    --------
    A line of contrast 100 answers more than twice as much as one of contrast 40: thresholds between the two part them.

    >>> from tilepipe_kernels.ridges.bar_profile import response_of_bar, sigma_for_width
    >>> sigma = sigma_for_width(12)
    >>> [round(response_of_bar(6, contrast, sigma), 2) for contrast in (40, 100)]
    [1.03, 2.57]
    """
    if not (half_width > 0 and sigma > 0):
        raise ValueError(f"half_width {half_width} and sigma {sigma} must be positive numbers of pixels")
    gaussian = math.exp(-0.5 * (half_width / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)
    return contrast * 2 * half_width * gaussian / sigma**2


def position_standard_error(response: NDArray[Any] | float, sigma: float, noise: float) -> NDArray[np.float64]:
    """Return the standard error of a line point's position across the line, in pixels, under white noise.

    The position is ``t = -r_n / r_nn``.  White noise of standard deviation s per pixel gives the filter
    output r_n the variance ``s² ∫∫ (∂g/∂n)² = s² · 1/(4 sqrt(π) σ³) · 1/(2 sqrt(π) σ) = s² / (8π σ⁴)``; to
    first order ``std(t) = s / (sqrt(8π) σ² |r_nn|)``.

    Parameters
    ----------
    response
        ``|r_nn|`` in grey per pixel².  An array of a device stays there.
    sigma
        Gaussian scale in pixels.
    noise
        Standard deviation of the noise of one pixel, grey.

    Examples
    --------
    Noise of 10 grey levels: the stronger a line, the better its place is known.

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.bar_profile import position_standard_error
    >>> position_standard_error(np.array([1.0, 4.0]), sigma=3.5, noise=10.0).round(3).tolist()
    [0.163, 0.041]
    """
    magnitude = namespace(response).asarray(response, dtype=np.float64)
    error: NDArray[np.float64] = noise / (math.sqrt(8 * math.pi) * sigma**2 * magnitude)
    return error


def response_bins(low: float, high: float, bins: int = 128) -> NDArray[np.float64]:
    """Edges of a logarithmic histogram of responses; equal for all tiles, so that counts can be added.

    Examples
    --------
    >>> from tilepipe_kernels.ridges.bar_profile import response_bins
    >>> response_bins(0.1, 100.0, bins=3).round(6).tolist()
    [0.1, 1.0, 10.0, 100.0]
    """
    if not 0 < low < high or bins < 3:
        raise ValueError(f"bins {bins} from {low} to {high}: give 0 < low < high and at least 3 bins")
    return np.geomspace(low, high, bins + 1)


def thresholds_from_histogram(counts: NDArray[Any], edges: NDArray[Any]) -> tuple[float, float]:
    """Hysteresis thresholds (low, high) that best part the log-responses into noise, weak and strong points.

    Otsu's criterion with three classes (Otsu 1979, Section III.B): the two cuts maximise the variance between
    classes. Counts are integers, so the result depends on their sum over tiles alone.

    Parameters
    ----------
    counts
        Points per bin, integers, shape (bins,).
    edges
        Bin edges in grey per pixel², increasing and positive, shape (bins + 1,); see `response_bins`.

    Raises
    ------
    ValueError
        If shapes disagree, edges are not positive and increasing, or fewer than three bins hold points.

    Examples
    --------
    Much noise below 0.3, some weak points about 4 and a few strong ones about 50 grey per pixel².

    >>> import numpy as np
    >>> from tilepipe_kernels.ridges.bar_profile import response_bins, thresholds_from_histogram
    >>> edges = response_bins(0.1, 100.0, bins=6)
    >>> low, high = thresholds_from_histogram(np.array([900, 0, 0, 80, 0, 40]), edges)
    >>> round(low, 2), round(high, 2)
    (0.32, 10.0)
    """
    counted, bounds = np.asarray(counts), np.asarray(edges, np.float64)
    if counted.ndim != 1 or bounds.shape != (counted.size + 1,):
        raise ValueError(f"counts {counted.shape} and edges {bounds.shape}: there must be one more edge than bins")
    if not (bounds[0] > 0 and (np.diff(bounds) > 0).all()):
        raise ValueError("edges must be positive and increasing")
    if np.count_nonzero(counted) < 3:
        raise ValueError("fewer than three histogram bins hold points: give thresholds instead")
    level = 0.5 * (np.log(bounds[:-1]) + np.log(bounds[1:]))
    number = np.concatenate([[0.0], np.cumsum(counted, dtype=np.float64)])
    total = np.concatenate([[0.0], np.cumsum(counted * level)])

    def between(start: Any, stop: Any) -> NDArray[np.float64]:
        size = number[stop] - number[start]
        weighted: NDArray[np.float64] = (total[stop] - total[start]) ** 2 / np.where(size > 0, size, np.inf)
        return weighted

    first, second = np.triu_indices(counted.size, 1)
    first, second = first[first > 0], second[first > 0]
    score = between(0, first) + between(first, second) + between(second, counted.size)
    best = int(np.argmax(score))
    return float(bounds[first[best]]), float(bounds[second[best]])


@rule
def smallest_log_ratio(distance: float) -> float:
    """Log of (weak / strong) gradient of the most asymmetric bar of this edge distance: one without width."""
    skew = math.sqrt(0.25 * distance * distance - 1.0)
    return math.log((0.5 * distance - skew) / (0.5 * distance + skew)) - distance * skew


@rule
def _bar_equation(far: float, distance: float, log_ratio: float) -> tuple[float, float, float]:
    """Half-width by the gradient ratio, then error of the edge equation and its derivative by ``far``.

    With the bar's centre at 0, half-width w, edges at -u and s, v = u + s and f = s - w (``far``):

    - the gradients ``|r'(x)| = 2w g(x+w) / |x-w|`` at the edges give
      ``ln ratio = ln((v-f)/f) - v (f + 2w - v/2)``, so w is explicit in f;
    - ``r''(-u) = r''(s) = 0`` for one asymmetry a, that is
      ``ln((s+w)/(s-w)) - 2sw = ln(1-a) = ln((u-w)/(u+w)) + 2uw``, gives ``us = wv coth(wv) - w²``,
      so ``f (v - f - 2w) = 2z / (exp(2z) - 1)`` with ``z = wv``.
    """
    near = distance - far
    half_width = (math.log(near / far) - distance * far + 0.5 * distance * distance - log_ratio) / (2 * distance)
    if not half_width > 0.0:
        return half_width, 1.0, 1.0
    z = half_width * distance
    growth = math.expm1(2 * z)
    error = far * (near - 2 * half_width) - 2 * z / growth
    width_slope = -0.5 * (1 / (far * near) + 1.0)
    bend = (2 / growth) * (1.0 - 2 * z * (1.0 + 1 / growth))
    slope = near - far - 2 * half_width - (2 * far + distance * bend) * width_slope
    return half_width, error, slope


@rule
def bar_from_edges(distance: float, log_ratio: float) -> tuple[float, float, float]:
    """Half-width of a bar, offset of its ridge toward the weaker edge, distance of the stronger edge.

    Inverts Steger's (1998, Section 2.3) map from width and asymmetry to edge distance and gradient ratio,
    which he tabulates, by solving `_bar_equation`.  The ridge, r' = 0, lies at ``-ln(1-a) / (2w)``.

    Parameters
    ----------
    distance
        Distance between the two edges in units of sigma; more than 2, which belongs to a bar without width.
    log_ratio
        Log of the weaker over the stronger gradient, not positive.

    Returns
    -------
    half_width, offset, near
        In units of sigma, from the bar's centre; NaN where no bar has such edges.
    """
    if not distance > 2.0 or not log_ratio > max(smallest_log_ratio(distance), FAINTEST_EDGE):
        return math.nan, math.nan, math.nan
    # f of a wide bar is nearly v exp(-v²/2): its logarithm is the variable to search.
    low, high = -0.5 * distance * distance + log_ratio - 3.0, math.log(distance)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _bar_equation(math.exp(middle), distance, log_ratio)[1] < 0.0:
            low = middle
        else:
            high = middle
    logarithm = 0.5 * (low + high)
    for _ in range(NEWTON_STEPS):
        far = math.exp(logarithm)
        _, error, slope = _bar_equation(far, distance, log_ratio)
        logarithm = min(max(logarithm - error / (slope * far), low), high)
    far = math.exp(logarithm)
    half_width = _bar_equation(far, distance, log_ratio)[0]
    if not half_width > 0.0:
        return math.nan, math.nan, math.nan
    log_remainder = min(math.log((far + 2 * half_width) / far) - 2 * half_width * (far + half_width), 0.0)
    return half_width, -log_remainder / (2 * half_width), distance - far - half_width


@rule
def bar_contrast(gradient: float, half_width: float, near: float) -> float:
    """Contrast of a bar from the gradient (times sigma) at its stronger edge, ``near`` from its centre.

    Steger's closed form for r'' at the ridge would do too, but a pixel's r'' is taken up to half a pixel off
    the ridge, where it differs when the sides differ; the gradient is stationary at the edge.
    """
    excess = near - half_width
    gaussian = math.exp(-0.5 * excess * excess) / math.sqrt(2 * math.pi)
    return gradient * (near + half_width) / (2 * half_width * gaussian)
