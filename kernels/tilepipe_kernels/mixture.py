"""Mixture of two normal classes in the plane, fitted by expectation and maximisation under conjugate priors.

Fraley & Raftery 2007, "Bayesian regularization for normal mixture estimation and model-based clustering", J.
Classification 24, 155-181: a class that the data do not show keeps the mean and the spread of its prior, so a fit to
one class alone neither fails nor splits it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule

Floats = NDArray[np.float64]

CLASSES = 2


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
        """Logarithm of how many times more likely class 0 is than class 1, shares included, for features (n, 2)."""
        found = np.empty(len(features))
        _compare(np.ascontiguousarray(features, np.float64), self.share, self.mean, self.covariance, found)
        return found


@rule
def log_density(x: float, y: float, mean_x: float, mean_y: float, xx: float, xy: float, yy: float) -> float:
    """Logarithm of the normal density in the plane, without the constant."""
    determinant = xx * yy - xy * xy
    x, y = x - mean_x, y - mean_y
    return -0.5 * (math.log(determinant) + (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant)


@loop
def _compare(features: Floats, share: Floats, mean: Floats, covariance: Floats, found: Floats) -> None:
    offset = math.log(share[0]) - math.log(share[1])
    for i in range(found.size):
        x, y = features[i]
        one = log_density(x, y, mean[0, 0], mean[0, 1], covariance[0, 0], covariance[0, 1], covariance[0, 2])
        other = log_density(x, y, mean[1, 0], mean[1, 1], covariance[1, 0], covariance[1, 1], covariance[1, 2])
        found[i] = offset + one - other


@loop
def _sums(features: Floats, weight: Floats, evidence: Floats, sums: Floats) -> float:
    """Weight, first and second moments of each class by its probabilities; returns the weight of class 0."""
    sums[:] = 0.0
    for i in range(weight.size):
        x, y = features[i]
        first = 1.0 / (1.0 + math.exp(-evidence[i]))
        for k in range(2):
            w = weight[i] * (first if k == 0 else 1.0 - first)
            sums[k, 0] += w
            sums[k, 1] += w * x
            sums[k, 2] += w * y
            sums[k, 3] += w * x * x
            sums[k, 4] += w * x * y
            sums[k, 5] += w * y * y
    return float(sums[0, 0])


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
    """
    features = np.ascontiguousarray(features, np.float64)
    weight = np.ascontiguousarray(weight, np.float64)
    if features.shape != (weight.size, 2) or weight.ndim != 1:
        raise ValueError(f"features must be (n, 2) and weight (n,), not {features.shape} and {weight.shape}")
    if not (np.isfinite(features).all() and np.isfinite(weight).all() and (weight >= 0).all()):
        raise ValueError("features must be finite and weights finite and 0 or more: leave out what is not known")
    prior = np.array([known.row for known in priors])
    share, mean, covariance = (np.full(CLASSES, 0.5), prior[:, :2].copy(), prior[:, 2:5].copy())
    if not weight.sum() > 0:
        return Mixture(share, mean, covariance)
    weight = weight / weight.sum()
    evidence, sums = np.empty(weight.size), np.empty((CLASSES, 6))
    before = -1.0
    for _ in range(most_steps):
        _compare(features, share, mean, covariance, evidence)
        first = _sums(features, weight, evidence, sums)
        share = (sums[:, 0] + 0.5 * share_weight) / (1 + share_weight)
        for k in range(CLASSES):
            mean[k], covariance[k] = _mode(sums[k], prior[k])
        if abs(first - before) < tolerance:
            break
        before = first
    return Mixture(share, mean, covariance)


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
