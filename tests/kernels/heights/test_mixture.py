"""The mixture of two classes: recovers known ones, and keeps to its priors where a class is absent."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from tilepipe_kernels.heights.mixture import ClassPrior, fit_mixture

PRIORS = (ClassPrior((-2.0, -2.0), 0.8, 0.5, 0.05, 0.05), ClassPrior((0.0, 0.0), 0.5, 0.5, 0.05, 0.05))
Floats = NDArray[np.float64]


def drawn(count: int, mean: tuple[float, float], covariance: Floats, seed: int) -> Floats:
    return np.random.default_rng(seed).multivariate_normal(mean, covariance, count)


def two_classes() -> tuple[Floats, NDArray[np.bool_]]:
    one = drawn(6000, (-1.5, -2.2), np.array([[0.3, 0.1], [0.1, 0.2]]), 0)
    other = drawn(2000, (0.4, 0.2), np.array([[0.2, -0.05], [-0.05, 0.1]]), 1)
    return np.concatenate([one, other]), np.arange(8000) < 6000


def test_known_classes_are_recovered() -> None:
    features, first = two_classes()
    weak = tuple(ClassPrior(p.mean, p.deviation, p.correlation, 1e-4, 1e-4) for p in PRIORS)
    found = fit_mixture(features, np.ones(8000), weak, share_weight=1e-4)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.mean, [[-1.5, -2.2], [0.4, 0.2]], atol=0.03)
    np.testing.assert_allclose(found.covariance, [[0.3, 0.1, 0.2], [0.2, -0.05, 0.1]], atol=0.02)
    np.testing.assert_allclose(found.share, [0.75, 0.25], atol=0.01)
    assert ((found.evidence(features) > 0) == first).mean() > 0.99


def test_evidence_is_the_ratio_of_the_densities() -> None:
    features, _ = two_classes()
    found = fit_mixture(features, np.ones(8000), PRIORS)
    densities = [
        share * multivariate_normal(mean, [[xx, xy], [xy, yy]]).pdf(features[::100])
        for share, mean, (xx, xy, yy) in zip(found.share, found.mean, found.covariance, strict=True)
    ]
    np.testing.assert_allclose(found.evidence(features[::100]), np.log(densities[0] / densities[1]), rtol=1e-9)


def test_a_fit_is_a_fixed_point_of_its_equations() -> None:
    features, _ = two_classes()
    weight = np.random.default_rng(3).random(8000)
    found = fit_mixture(features, weight, PRIORS, tolerance=1e-12, most_steps=2000)
    share = 1 / (1 + np.exp(-found.evidence(features)))
    for k, (prior, part) in enumerate(zip(PRIORS, (share, 1 - share), strict=True)):
        part = part * weight / weight.sum()
        own = part @ features / part.sum()
        mean = (part.sum() * own + prior.mean_weight * np.array(prior.mean)) / (part.sum() + prior.mean_weight)
        off, away = features - own, own - np.array(prior.mean)
        scatter = (part[:, None] * off).T @ off
        scatter += prior.mean_weight * part.sum() / (prior.mean_weight + part.sum()) * np.outer(away, away)
        scatter += prior.spread_weight * prior.deviation**2 * np.array([[1, prior.correlation], [prior.correlation, 1]])
        covariance = scatter / (part.sum() + prior.spread_weight)
        np.testing.assert_allclose(found.mean[k], mean, atol=1e-6)
        np.testing.assert_allclose(found.covariance[k], covariance[[0, 0, 1], [0, 1, 1]], atol=1e-6)


@pytest.mark.parametrize("only", [0, 1])
def test_one_class_alone_stays_one_class(only: int) -> None:
    features = drawn(4000, PRIORS[only].mean, 0.2 * np.eye(2), 5)
    found = fit_mixture(features, np.ones(4000), PRIORS)
    assert ((found.evidence(features) > 0) == (only == 0)).mean() > 0.98


def test_weights_count_and_their_scale_does_not() -> None:
    features, first = two_classes()
    weight = np.where(first, 1.0, 9.0)
    found = fit_mixture(features, weight, PRIORS)
    again = fit_mixture(features, 1024 * weight, PRIORS)
    assert found.share[1] == pytest.approx(0.75, abs=0.03)
    np.testing.assert_array_equal(found.mean, again.mean)


def test_nothing_gives_the_priors_and_bad_input_is_named() -> None:
    assert fit_mixture(np.empty((0, 2)), np.empty(0), PRIORS).mean.tolist() == [[-2.0, -2.0], [0.0, 0.0]]
    with pytest.raises(ValueError, match="features must be"):
        fit_mixture(np.zeros((3, 3)), np.ones(3), PRIORS)
    with pytest.raises(ValueError, match="finite"):
        fit_mixture(np.full((3, 2), np.nan), np.ones(3), PRIORS)
    with pytest.raises(ValueError, match="0 or more"):
        fit_mixture(np.zeros((3, 2)), -np.ones(3), PRIORS)
