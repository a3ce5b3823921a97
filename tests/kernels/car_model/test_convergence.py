"""R-hat and effective sample size on chains whose answers are known."""

import numpy as np
import pytest
from scipy.stats import rankdata

from tilepipe_kernels.car_model.convergence import effective_sample_size, rank_normalise, split_halves, split_rhat


def autoregressive(chains: int, draws: int, correlation: float, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((chains, draws))
    noise[:, 1:] *= np.sqrt(1 - correlation**2)
    for t in range(1, draws):
        noise[:, t] += correlation * noise[:, t - 1]
    return noise


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_effective_sample_size_of_an_autoregressive_chain(correlation):
    chains = autoregressive(4, 20_000, correlation, seed=1)
    expected = chains.size * (1 - correlation) / (1 + correlation)
    assert effective_sample_size(chains) == pytest.approx(expected, rel=0.08)
    assert split_rhat(chains) < 1.01


def test_antithetic_chains_are_worth_more_than_their_length():
    chains = autoregressive(2, 5000, -0.5, seed=2)
    assert effective_sample_size(chains) == pytest.approx(3 * chains.size, rel=0.1)


def test_naive_effective_sample_size():
    halves = split_halves(autoregressive(2, 120, 0.6, seed=3))
    z = rank_normalise(halves)
    m, n = z.shape
    within = np.mean([np.var(row, ddof=1) for row in z])
    pooled = within * (n - 1) / n + np.var([row.mean() for row in z], ddof=1)
    rho = [1.0]
    for lag in range(1, n):
        products = [sum((r[t] - r.mean()) * (r[t + lag] - r.mean()) for t in range(n - lag)) / (n - 1) for r in z]
        rho.append(1 - (within - np.mean(products)) / pooled)
    time, smallest = -1.0, np.inf
    for k in range(n // 2):
        pair = rho[2 * k] + rho[2 * k + 1]
        if pair <= 0:
            break
        smallest = min(smallest, pair)
        time += 2 * smallest
    assert effective_sample_size(np.concatenate([halves[:2], halves[2:]], axis=1)) == pytest.approx(m * n / time)


def test_scores_are_those_of_average_ranks():
    draws = np.array([[3.0, 1.0, 1.0, 2.0], [2.0, 2.0, 5.0, -1.0]])
    ranks = rankdata(draws).reshape(draws.shape)
    order = np.argsort(ranks, axis=None)
    assert (np.diff(rank_normalise(draws).ravel()[order]) >= 0).all()
    from scipy.stats import norm

    assert np.allclose(norm.cdf(rank_normalise(draws)) * (draws.size + 0.25) + 0.375, ranks)


def test_drift_shift_and_spread_are_seen():
    noise = autoregressive(4, 1000, 0.0, seed=4)
    assert split_rhat(noise[0] + np.linspace(0, 3, 1000)) > 1.1
    assert split_rhat(noise + np.array([[0], [0], [0], [1]])) > 1.05
    assert split_rhat(noise * np.array([[1], [1], [1], [3]])) > 1.05


def test_ranks_make_a_monotone_transformation_invisible():
    chains = autoregressive(2, 500, 0.3, seed=5)
    assert effective_sample_size(np.exp(3 * chains)) == pytest.approx(effective_sample_size(chains))


def test_chains_that_say_nothing():
    assert np.isnan(split_rhat(np.ones(10))) and np.isnan(effective_sample_size(np.ones(10)))
    assert split_rhat([0.0, 0.0, 1.0, 1.0]) == np.inf
    for bad in (np.ones(3), np.ones((2, 2, 8)), [1.0, 2.0, np.nan, 3.0]):
        with pytest.raises(ValueError, match="chains must"):
            split_rhat(bad)
