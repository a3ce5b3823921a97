"""The recorded file jags_posterior.json, which scripts/reference_car makes with JAGS, recomputed in two other ways."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

RECORDED = json.loads((Path(__file__).parent / "jags_posterior.json").read_text())
GRAPH, TOLERANCE = RECORDED["graph"], RECORDED["tolerance"]
COUNT = np.array(GRAPH["count"], float)
FIRST, SECOND = np.transpose(GRAPH["edges"])
SHAPE, RATE = 0.5, 0.0005
CHAINS, BURN_IN, SWEEPS = 40, 100, 500

Array = NDArray[np.float64]
# A quantity's name, its value and the value's Monte Carlo standard error.
Estimates = Iterator[tuple[str, Array, Array]]

each_case = pytest.mark.parametrize(
    "case", RECORDED["cases"], ids=[f"relief {case['relief']}, weights {case['weights']}" for case in RECORDED["cases"]]
)


def weights_of(case: dict[str, Any]) -> Array:
    weights = np.zeros((COUNT.size, COUNT.size))
    weights[FIRST, SECOND] = weights[SECOND, FIRST] = GRAPH["weights"][case["weights"]]
    return weights


def recorded(case: dict[str, Any]) -> dict[str, tuple[Array, Array]]:
    posterior = case["posterior"]
    figures = [(name, figure) for name in ("x", "v", "s2") for figure in ("mean", "sd")] + [("close", "probability")]
    return {
        f"{figure} of {name}": (np.array(posterior[name][figure]), np.array(posterior[name][f"{figure}_error"]))
        for name, figure in figures
    }


def assert_agrees(estimates: Estimates, case: dict[str, Any]) -> None:
    """Within five standard errors; what six digits and 80,000 draws cannot show is no difference."""
    reference = recorded(case)
    for name, value, error in estimates:
        expected, expected_error = reference.pop(name)
        unseen = 1e-4 if name == "probability of close" else 1e-6 * np.abs(expected)
        excess = np.abs(value - expected) - 5 * np.hypot(error, expected_error) - unseen
        assert np.all(excess <= 0), f"{name}: {np.sum(excess > 0)} values differ"
    assert not reference


def gibbs(case: dict[str, Any], seed: int) -> tuple[Array, Array, Array]:
    """Draws of x (sweep, node, chain), v and s2 (sweep, chain): one full conditional after the other."""
    random = np.random.default_rng(seed)
    weights, mean, spread = weights_of(case), np.array(case["mean"])[:, None], sum(case["spread"])
    neighbours = [np.flatnonzero(row) for row in weights]
    x = np.repeat(mean, CHAINS, axis=1)
    kept: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for sweep in range(BURN_IN + SWEEPS):
        differences = (np.array(GRAPH["weights"][case["weights"]])[:, None] * (x[FIRST] - x[SECOND]) ** 2).sum(0)
        v = (RATE + differences / 2) / random.gamma(SHAPE + (COUNT.size - 1) / 2, size=CHAINS)
        residuals = spread + (COUNT[:, None] * (x - mean) ** 2).sum(0)
        s2 = (RATE + residuals / 2) / random.gamma(SHAPE + COUNT.sum() / 2, size=CHAINS)
        normal = random.normal(size=x.shape)
        for i, near in enumerate(neighbours):
            precision = weights[i, near].sum() / v + COUNT[i] / s2
            pull = weights[i, near] @ x[near] / v + COUNT[i] * mean[i] / s2
            x[i] = pull / precision + normal[i] / np.sqrt(precision)
        if sweep >= BURN_IN:
            for draws, draw in zip(kept, (x, v, s2), strict=True):
                draws.append(draw.copy())
    return np.array(kept[0]), np.array(kept[1]), np.array(kept[2])


def over_chains(draws: Array) -> tuple[Array, Array]:
    """Mean and its standard error from the independent chains, which are the last axis."""
    chains = draws.mean(0)
    return chains.mean(-1), chains.std(-1, ddof=1) / np.sqrt(CHAINS)


def estimates_by_gibbs(case: dict[str, Any]) -> Estimates:
    x, v, s2 = gibbs(case, seed=1)
    for name, draws in (("x", x), ("v", v), ("s2", s2)):
        mean, error = over_chains(draws)
        yield f"mean of {name}", mean, error
        variance, error = over_chains((draws - mean[..., None]) ** 2)
        yield f"sd of {name}", np.sqrt(variance), error / (2 * np.sqrt(variance))
    yield "probability of close", *over_chains(np.abs(x[:, FIRST] - x[:, SECOND]) <= TOLERANCE)


@each_case
def test_recorded_posterior_is_that_of_a_gibbs_sampler(case: dict[str, Any]) -> None:
    assert_agrees(estimates_by_gibbs(case), case)


def estimates_by_integration(case: dict[str, Any]) -> Estimates:
    """Exact up to a sum over a fine grid of (1 / v, 1 / s2), given which x is normal.

    With D = diag(n), L the weighted Laplacian and U' D U = I, U' L U = diag(λ), the coordinates of x = U y are
    independent given the grid's point: precision q = λ / v + 1 / s2, mean U' D m / (s2 q).
    """
    weights, mean, spread = weights_of(case), np.array(case["mean"]), sum(case["spread"])
    root = np.sqrt(COUNT)
    eigenvalues, vectors = np.linalg.eigh((np.diag(weights.sum(1)) - weights) / np.outer(root, root))
    eigenvalues[0] = 0.0
    U = vectors / root[:, None]
    data = vectors.T @ (root * mean)
    a, t = (grid.reshape(-1, 1) for grid in np.exp(np.meshgrid(np.arange(-8, 7, 0.1), np.arange(2.8, 4.5, 0.02))))
    precision = a * eigenvalues + t
    log_density = -0.5 * (np.log(precision) + data**2 * a * eigenvalues * t / precision).sum(1, keepdims=True)
    log_density += (SHAPE + (COUNT.size - 1) / 2) * np.log(a) - RATE * a
    log_density += (SHAPE + COUNT.sum() / 2) * np.log(t) - (RATE + spread / 2) * t
    mass = np.exp(log_density - log_density.max())
    seen = mass[:, 0] > 1e-9
    a, t, precision, mass = a[seen], t[seen], precision[seen], mass[seen] / mass.sum()
    centre = (t * data / precision) @ U.T
    between, within = (centre - (mass * centre).sum(0)) ** 2, (1 / precision) @ (U**2).T
    exact = np.array(0.0)
    yield "mean of x", (mass * centre).sum(0), exact
    yield "sd of x", np.sqrt((mass * (between + within)).sum(0)), exact
    for name, values in (("v", 1 / a), ("s2", 1 / t)):
        expected = (mass * values).sum()
        yield f"mean of {name}", expected, exact
        yield f"sd of {name}", np.sqrt((mass * (values - expected) ** 2).sum()), exact
    difference, sd = centre[:, FIRST] - centre[:, SECOND], np.sqrt((1 / precision) @ ((U[FIRST] - U[SECOND]) ** 2).T)
    close = ndtr((TOLERANCE - difference) / sd) - ndtr((-TOLERANCE - difference) / sd)
    yield "probability of close", (mass * close).sum(0), exact


@each_case
def test_recorded_posterior_is_that_of_exact_integration(case: dict[str, Any]) -> None:
    assert_agrees(estimates_by_integration(case), case)


def test_recorded_means_are_precise_and_the_graph_is_one_component() -> None:
    reached = np.arange(COUNT.size) == 0
    for _ in range(COUNT.size):
        reached[FIRST], reached[SECOND] = (reached[FIRST] | reached[SECOND],) * 2
    assert reached.all()
    for case in RECORDED["cases"]:
        for name in ("x", "v", "s2"):
            moments = case["posterior"][name]
            assert np.all(np.array(moments["mean_error"]) < 0.02 * np.array(moments["sd"]))
