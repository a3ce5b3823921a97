"""The binary field on the device draws what the host draws."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tests.naive.regions import ising as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.regions.ising import field_marginals


def scene(seed: int, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    pairs = np.array(list(combinations(range(nodes), 2)), np.int32)
    edges = pairs[random.random(len(pairs)) < 0.35]
    return edges, random.exponential(0.7, len(edges)), random.normal(0, 1.2, nodes)


@pytest.mark.parametrize("seed", range(3))
def test_marginals_are_those_of_the_host(seed: int) -> None:
    edges, coupling, evidence = scene(seed, 11)
    sites = np.arange(11) * 5 + 2**33
    options = {"burn_in": 2, "draws": 6, "seed": seed}
    found = field_marginals(*map(to_device, (edges, coupling, evidence)), sites=to_device(sites), **options)
    assert on_device(found)
    np.testing.assert_allclose(to_host(found), field_marginals(edges, coupling, evidence, sites=sites, **options),
                               rtol=1e-12)  # fmt: skip


def test_marginals_are_those_of_all_states() -> None:
    edges, coupling, evidence = scene(4, 5)
    found = field_marginals(*map(to_device, (edges[::-1, ::-1], coupling[::-1], evidence)), burn_in=5, draws=60)
    np.testing.assert_allclose(to_host(found), naive.marginals(edges, coupling, evidence), atol=0.2)


def test_lone_nodes_are_exact() -> None:
    evidence = np.array([-800.0, 0.0, 2.0])
    found = field_marginals(to_device(np.empty((0, 2), np.int32)), to_device(np.empty(0)), to_device(evidence), draws=3)
    np.testing.assert_allclose(to_host(found), [0, 0.5, 1 / (1 + np.exp(-2))], rtol=1e-14)
