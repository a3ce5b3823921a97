"""The binary field on a graph against the sum over all states."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tests.naive.regions import ising as naive
from tilepipe_kernels.regions.ising import field_marginals, probability_of


@pytest.mark.parametrize("seed", range(6))
def test_marginals_are_those_of_all_states(seed: int) -> None:
    random = np.random.default_rng(seed)
    pairs = np.array(list(combinations(range(9), 2)), np.int32)
    edges = pairs[random.random(len(pairs)) < 0.35]
    coupling, evidence = random.exponential(0.7, len(edges)), random.normal(0, 1.2, 9)
    found = field_marginals(edges, coupling, evidence, draws=20_000, seed=seed)
    np.testing.assert_allclose(found, naive.marginals(edges, coupling, evidence), atol=0.02)


def test_lone_nodes_are_exact_and_names_make_the_numbers() -> None:
    evidence = np.array([-800.0, -1.0, 0.0, 2.0, 800.0])
    found = field_marginals(np.empty((0, 2), np.int32), np.empty(0), evidence, draws=3)
    np.testing.assert_allclose(found, [0, 1 / (1 + np.e), 0.5, 1 / (1 + np.exp(-2)), 1], rtol=1e-14)
    scene = np.array([[0, 1], [1, 2]], np.int32), np.array([1.0, 0.5]), np.array([0.3, -0.2, 0.1])
    found = field_marginals(*scene, draws=5, seed=4)
    np.testing.assert_array_equal(found, field_marginals(*scene, draws=5, seed=4, sites=np.arange(3)))
    assert (found != field_marginals(*scene, draws=5, seed=4, sites=np.arange(3) + 7)).any()
    assert (found != field_marginals(*scene, draws=5, seed=5)).any()


def test_probability_of_evidence_does_not_overflow() -> None:
    assert [probability_of(float(x)) for x in (-1e4, 0, 1e4)] == [0.0, 0.5, 1.0]


def test_bad_input_is_named() -> None:
    edges = np.array([[0, 1]], np.int32)
    with pytest.raises(ValueError, match="edges must be"):
        field_marginals(edges, np.ones(2), np.zeros(3))
    with pytest.raises(ValueError, match=r"nodes 0\.\.0"):
        field_marginals(edges, np.ones(1), np.zeros(1))
    with pytest.raises(ValueError, match="couplings"):
        field_marginals(edges, -np.ones(1), np.zeros(2))
    with pytest.raises(ValueError, match="draws"):
        field_marginals(edges, np.ones(1), np.zeros(2), draws=0)
