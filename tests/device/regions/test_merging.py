"""Merging on the device gives the regions, borders and pooled pixels of the host, bit for bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kernels.regions.test_merging import random_graph
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.regions.contraction import RegionGraph, Statistics, first_members
from tilepipe_kernels.regions.merging import join_small, merge_best


def uploaded(graph: RegionGraph) -> RegionGraph:
    s = graph.statistics
    statistics = Statistics(*(to_device(values) for values in (s.count, s.mean, s.spread)))
    return RegionGraph(statistics, to_device(graph.edges), to_device(graph.length))


def assert_same(found: tuple[RegionGraph, np.ndarray], expected: tuple[RegionGraph, np.ndarray]) -> None:
    def arrays(graph: RegionGraph, number: np.ndarray) -> list[np.ndarray]:
        s = graph.statistics
        return [number, graph.edges, graph.length, s.count, s.mean, s.spread]

    for ours, hosts in zip(arrays(*found), arrays(*expected), strict=True):
        assert on_device(ours) and ours.dtype == hosts.dtype
        np.testing.assert_array_equal(to_host(ours), hosts)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 14))
def test_best_partners_merge_as_on_the_host(seed: int, regions: int) -> None:
    graph, _ = random_graph(seed, regions)
    probability = np.random.default_rng(seed).integers(0, 5, len(graph.edges)).astype(np.float32) / 4
    expected = merge_best(graph, probability, 0.5)
    found = merge_best(uploaded(graph), to_device(probability), 0.5)
    assert_same(found, expected)
    groups = expected[0].statistics.count.size
    first = first_members(found[1], groups)
    assert on_device(first)
    np.testing.assert_array_equal(to_host(first), first_members(expected[1], groups))


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 12), least=st.integers(1, 20))
def test_small_regions_join_as_on_the_host(seed: int, regions: int, least: int) -> None:
    graph, _ = random_graph(seed, regions)
    assert_same(join_small(uploaded(graph), least), join_small(graph, least))


def test_of_equals_the_longer_border_and_then_the_first_merges() -> None:
    edges = np.array([[0, 1], [0, 2], [1, 3], [2, 3]], np.int32)
    statistics = Statistics(np.ones(4), np.array([0.0, 1.0, 1.0, 2.0]), np.zeros(4))
    for length in ([1, 2, 1, 1], [1, 1, 1, 1], [2, 1, 1, 2]):
        graph = RegionGraph(statistics, edges, np.array(length, np.int32))
        probability = np.full(4, 0.9, np.float32)
        assert_same(merge_best(uploaded(graph), to_device(probability), 0.5), merge_best(graph, probability, 0.5))
        assert_same(join_small(uploaded(graph), 2), join_small(graph, 2))
