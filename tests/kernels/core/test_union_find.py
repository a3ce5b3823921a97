"""Sets of sites: those of networkx and scipy, whatever the order of the unions, each known by its smallest site."""

from __future__ import annotations

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilepipe_kernels.core.components import connected_components
from tilepipe_kernels.core.union_find import flatten, root_of, unite


@given(st.integers(0, 2**32), st.integers(1, 60), st.sampled_from([np.int32, np.int64]))
def test_roots_are_the_smallest_of_connected_components(seed: int, sites: int, dtype: type) -> None:
    random = np.random.default_rng(seed)
    pairs = random.integers(0, sites, (int(random.integers(0, 2 * sites)), 2))
    parent = np.arange(sites).astype(dtype)
    for a, b in pairs:
        unite(parent, a, b)
        assert root_of(parent, a) == root_of(parent, b)
    roots = [root_of(parent, site) for site in range(sites)]
    flatten(parent)
    assert parent.tolist() == roots
    graph = networkx.Graph()
    graph.add_nodes_from(range(sites))
    graph.add_edges_from(pairs.tolist())
    for component in networkx.connected_components(graph):
        assert {roots[site] for site in component} == {min(component)}
    number = connected_components(sites, pairs)
    assert np.array_equal(np.unique(roots, return_inverse=True)[1], number)


@pytest.mark.parametrize("backwards", [False, True])
def test_a_long_chain_is_one_set(backwards: bool) -> None:
    parent = np.arange(10_000)
    links = range(9_998, -1, -1) if backwards else range(9_999)
    for site in links:
        unite(parent, site + 1, site)
    flatten(parent)
    assert not parent.any()
