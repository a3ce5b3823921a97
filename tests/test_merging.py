"""Merging on a region adjacency graph: mutual partners, pooled pixels, rebuilt borders."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tilepipe_kernels.merging import RegionGraph, Statistics, merge_best, neighbour_lists


def random_graph(seed: int, regions: int) -> tuple[RegionGraph, list[np.ndarray]]:
    """A random graph and the pixels of its regions."""
    random = np.random.default_rng(seed)
    pixels = [random.normal(random.uniform(0, 9), 1, random.integers(1, 9)) for _ in range(regions)]
    pairs = np.argwhere(np.triu(random.random((regions, regions)) < 0.3, 1)).astype(np.int32)
    statistics = Statistics(
        np.array([p.size for p in pixels], float),
        np.array([p.mean() for p in pixels]),
        np.array([((p - p.mean()) ** 2).sum() for p in pixels]),
    )
    return RegionGraph(statistics, pairs.reshape(-1, 2), random.integers(1, 20, len(pairs))), pixels


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 14))
def test_best_partners_merge_and_pool_their_pixels(seed: int, regions: int) -> None:
    graph, pixels = random_graph(seed, regions)
    probability = np.random.default_rng(seed).integers(0, 5, len(graph.edges)).astype(np.float32) / 4
    merged, number, source = merge_best(graph, probability, 0.5)

    def best(region: int) -> int | None:
        own = [e for e in range(len(probability)) if region in graph.edges[e] and probability[e] >= 0.5]
        return max(own, key=lambda e: (probability[e], graph.length[e], -e), default=None)

    def partner(region: int) -> int | None:
        edge = best(region)
        return None if edge is None else int(graph.edges[edge].sum()) - region

    def root(region: int) -> int:
        for near in (region, partner(region)):
            if near is not None and (other := partner(near)) is not None and partner(other) == near:
                return min(near, other)
        return region

    for a in range(regions):
        for b in range(a):
            assert (number[a] == number[b]) == (root(a) == root(b))
    assert (np.diff([np.flatnonzero(number == n)[0] for n in range(number.max() + 1)]) > 0).all()
    for n in range(number.max() + 1):
        together = np.concatenate([pixels[r] for r in np.flatnonzero(number == n)])
        assert merged.statistics.count[n] == together.size
        np.testing.assert_allclose(merged.statistics.mean[n], together.mean())
        np.testing.assert_allclose(merged.statistics.spread[n], ((together - together.mean()) ** 2).sum(), atol=1e-9)
    borders: dict[tuple[int, int], int] = {}
    for (a, b), length in zip(number[graph.edges].tolist(), graph.length.tolist(), strict=True):
        if a != b:
            borders[min(a, b), max(a, b)] = borders.get((min(a, b), max(a, b)), 0) + length
    assert [tuple(e) for e in merged.edges.tolist()] == sorted(borders)
    assert np.sort(number[graph.edges[source]], axis=1).tolist() == merged.edges.tolist()
    assert merged.length.tolist() == [borders[key] for key in sorted(borders)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 14))
def test_neighbour_lists_hold_every_edge_twice(seed: int, regions: int) -> None:
    graph, _ = random_graph(seed, regions)
    offsets, neighbours, edge_of = neighbour_lists(graph.edges, regions)
    for region in range(regions):
        own = slice(offsets[region], offsets[region + 1])
        expected = sorted(int(a if b == region else b) for a, b in graph.edges if region in (a, b))
        assert neighbours[own].tolist() == expected
        for other, edge in zip(neighbours[own], edge_of[own], strict=True):
            assert sorted((region, int(other))) == graph.edges[edge].tolist()


def test_a_long_slope_does_not_become_one_region() -> None:
    """Steps of 0.3 m merge at a tolerance of 0.5 m, but only until their pooled means are farther apart."""
    steps = 64
    statistics = Statistics(np.full(steps, 16.0), 0.3 * np.arange(steps), np.zeros(steps))
    edges = np.stack([np.arange(steps - 1), np.arange(1, steps)], axis=1).astype(np.int32)
    graph = RegionGraph(statistics, edges, np.full(steps - 1, 4))
    for _ in range(steps):
        difference = np.abs(np.diff(graph.statistics.mean[graph.edges], axis=1)[:, 0])
        graph, number, _ = merge_best(graph, (1 - difference).astype(np.float32), 0.5)
        if number[-1] == number.size - 1:
            break
    assert graph.statistics.mean.size >= steps // 4
