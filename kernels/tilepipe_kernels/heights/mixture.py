"""Mixture of two normal classes in the plane, fitted by expectation and maximisation under conjugate priors.

Fraley & Raftery 2007, "Bayesian regularization for normal mixture estimation and model-based clustering", J.
Classification 24, 155-181: a class that the data do not show keeps the mean and the spread of its prior, so a fit to
one class alone neither fails nor splits it.

Items of a device are compared and summed there; the host reads the twelve sums of every step and finds the next mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device, to_host
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.sums import ordered_sum

Floats = NDArray[np.float64]
Normal = tuple[float, float, float, float, float]
"""Mean of both features, variance of the first, covariance, variance of the second."""
Moments = tuple[float, float, float, float, float, float]
"""Weight, and its products with x, y, x², x y and y²."""

CLASSES = 2
MOMENTS = 6


@dataclass(frozen=True)
class ClassPrior:
    """What is known of a class before the data are seen.

    Attributes
    ----------
    mean
        Of the two features.
    deviation
        Standard deviation of both features.
    correlation
        Between them, above -1 and below 1.
    mean_weight, spread_weight
        What share of all data the prior counts like, for the mean and for the covariance; above 0.

    Examples
    --------
    >>> from tilepipe_kernels.heights.mixture import ClassPrior
    >>> ClassPrior(mean=(1.0, 2.0), deviation=2.0, correlation=0.5, mean_weight=0.1, spread_weight=0.1).row
    [1.0, 2.0, 4.0, 2.0, 4.0, 0.1, 0.1]
    """

    mean: tuple[float, float]
    deviation: float
    correlation: float
    mean_weight: float
    spread_weight: float

    @property
    def row(self) -> list[float]:
        """Mean, variances and covariance, weights."""
        variance = self.deviation**2
        return [*self.mean, variance, self.correlation * variance, variance, self.mean_weight, self.spread_weight]


@dataclass(frozen=True)
class Mixture:
    """Fitted classes.

    Attributes
    ----------
    share
        Share of each class, float64, shape (2,).
    mean
        float64, shape (2, 2): [class, feature].
    covariance
        float64, shape (2, 3): variance of the first feature, covariance, variance of the second one.
    """

    share: Floats
    mean: Floats
    covariance: Floats

    def evidence(self, features: NDArray[Any]) -> Floats:
        """Logarithm of how many times more likely class 0 is than class 1, shares included, for features (n, 2).

        Features of a device are compared there; logarithms differ in the last bits.

        Examples
        --------
        >>> import numpy as np
        >>> from tilepipe_kernels.heights.mixture import Mixture
        >>> round_classes = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
        >>> mixture = Mixture(np.array([0.5, 0.5]), np.array([[0.0, 0.0], [4.0, 0.0]]), round_classes)
        >>> mixture.evidence(np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])).round(6).tolist()  # undecided between
        [8.0, 0.0, -8.0]
        """
        xp = namespace(features)
        found: Floats = xp.empty(len(features))
        self._compare(xp.ascontiguousarray(features, xp.float64), found)
        return found

    def _compare(self, features: Floats, found: Floats) -> None:
        offset = math.log(self.share[0]) - math.log(self.share[1])
        one, other = (_normal(self.mean[k], self.covariance[k]) for k in range(CLASSES))
        if on_device(features):
            device = device_form(__name__)
            device.compare(found.size, features, offset, one, other, found)
        else:
            _compare(features, offset, one, other, found)


def _normal(mean: Floats, covariance: Floats) -> Normal:
    return float(mean[0]), float(mean[1]), float(covariance[0]), float(covariance[1]), float(covariance[2])


@rule
def log_density(x: float, y: float, normal: Normal) -> float:
    """Logarithm of the normal density in the plane, without the constant."""
    mean_x, mean_y, xx, xy, yy = normal
    determinant = xx * yy - xy * xy
    x, y = x - mean_x, y - mean_y
    return -0.5 * (math.log(determinant) + (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant)


@rule
def log_ratio(x: float, y: float, offset: float, one: Normal, other: Normal) -> float:
    """Evidence of an item for class 0; ``offset`` is that of the shares."""
    return offset + log_density(x, y, one) - log_density(x, y, other)


@rule
def weights_of_classes(weight: float, evidence: float) -> tuple[float, float]:
    """Share of an item's weight that each class gets by its probability."""
    first = 1.0 / (1.0 + math.exp(-evidence))
    return weight * first, weight * (1.0 - first)


@rule
def moments_of(w: float, x: float, y: float) -> Moments:
    """What an item of weight w adds to the moments of a class."""
    return w, w * x, w * y, w * x * x, w * x * y, w * y * y


@loop
def _compare(features: Floats, offset: float, one: Normal, other: Normal, found: Floats) -> None:
    for i in range(found.size):
        found[i] = log_ratio(features[i, 0], features[i, 1], offset, one, other)


@loop
def _add_moments(features: Floats, weight: Floats, evidence: Floats, sums: Floats) -> None:
    for i in range(weight.size):
        x, y = features[i]
        for k, w in enumerate(weights_of_classes(weight[i], evidence[i])):
            for q, moment in enumerate(moments_of(w, x, y)):
                sums[k, q] += moment


def _sums(features: Floats, weight: Floats, evidence: Floats) -> Floats:
    """Weight, first and second moments of each class by its probabilities, (CLASSES, 6), on the host."""
    if on_device(features):
        device = device_form(__name__)
        return to_host(device.moments(features, weight, evidence)).sum(axis=0).reshape(CLASSES, MOMENTS)
    sums = np.zeros((CLASSES, MOMENTS))
    _add_moments(features, weight, evidence, sums)
    return sums


def fit_mixture(
    features: NDArray[Any],
    weight: NDArray[Any],
    priors: tuple[ClassPrior, ClassPrior],
    *,
    share_weight: float = 0.1,
    tolerance: float = 1e-5,
    most_steps: int = 200,
) -> Mixture:
    """Posterior mode of a mixture of two classes, started at their priors.

    Parameters
    ----------
    features
        Two features of each item, shape (n, 2), finite.
    weight
        Weight of each item, shape (n,), ≥ 0; only their ratios count.
    priors
        Of class 0 and class 1.
    share_weight
        What share of all data the prior of equal shares counts like.
    tolerance
        The fit ends when the share of class 0 changes by less in a step.
    most_steps
        Most steps of the fit.

    Returns
    -------
    Mixture
        The priors themselves when there is no weight.

    Raises
    ------
    ValueError
        For arrays of other shapes, features that are not finite, or negative weights.

    Examples
    --------
    A hundred roofs about (0, 0) and three hundred trees about (5, 5), while the priors expect them a little elsewhere.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.random import normals
    >>> from tilepipe_kernels.heights.mixture import ClassPrior, fit_mixture
    >>> features = normals(np.arange(800).reshape(400, 2), seed=0) + 5.0 * (np.arange(400)[:, None] >= 100)
    >>> priors = [ClassPrior((m, m), deviation=1, correlation=0, mean_weight=0.01, spread_weight=0.01) for m in (1, 4)]
    >>> mixture = fit_mixture(features, np.ones(400), (priors[0], priors[1]), share_weight=0.01)
    >>> mixture.share.round(2).tolist(), mixture.mean.round().tolist()
    ([0.25, 0.75], [[0.0, 0.0], [5.0, 5.0]])
    """
    xp = namespace(features, weight)
    features = xp.ascontiguousarray(features, xp.float64)
    weight = xp.ascontiguousarray(weight, xp.float64)
    if features.shape != (weight.size, 2) or weight.ndim != 1:
        raise ValueError(f"features must be (n, 2) and weight (n,), not {features.shape} and {weight.shape}")
    if not (xp.isfinite(features).all() and xp.isfinite(weight).all() and (weight >= 0).all()):
        raise ValueError("features must be finite and weights finite and 0 or more: leave out what is not known")
    prior = np.array([known.row for known in priors])
    share, mean, covariance = (np.full(CLASSES, 0.5), prior[:, :2].copy(), prior[:, 2:5].copy())
    mixture, total = Mixture(share, mean, covariance), ordered_sum(weight)
    if not total > 0:
        return mixture
    weight, evidence = weight / total, xp.empty(weight.size)
    before = -1.0
    for _ in range(most_steps):
        mixture._compare(features, evidence)
        sums = _sums(features, weight, evidence)
        share = (sums[:, 0] + 0.5 * share_weight) / (1 + share_weight)
        modes = [_mode(sums[k], prior[k]) for k in range(CLASSES)]
        mixture = Mixture(share, np.stack([mode[0] for mode in modes]), np.stack([mode[1] for mode in modes]))
        if abs(sums[0, 0] - before) < tolerance:
            break
        before = sums[0, 0]
    return mixture


def _mode(sums: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of one class from its sums and its prior (normal, inverse Wishart)."""
    weight, expected, by_mean, by_spread = sums[0], prior[:2], prior[5], prior[6]
    own = sums[1:3] / weight if weight > 0 else expected
    mean = (weight * own + by_mean * expected) / (weight + by_mean)
    off = own - expected
    pull = weight * by_mean / (weight + by_mean)
    moments = np.array([own[0] * own[0], own[0] * own[1], own[1] * own[1]])
    scatter = np.maximum(sums[3:6] - weight * moments, [0.0, -np.inf, 0.0])
    scatter = scatter + by_spread * prior[2:5] + pull * np.array([off[0] * off[0], off[0] * off[1], off[1] * off[1]])
    return mean, scatter / (weight + by_spread)
