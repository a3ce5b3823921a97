"""Merging on a region adjacency graph: mutual partners, pooled pixels, rebuilt borders."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tilepipe_kernels.regions.contraction import RegionGraph, Statistics, contract
from tilepipe_kernels.regions.merging import join_small, merge_best


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
    return RegionGraph(statistics, pairs.reshape(-1, 2), random.integers(1, 20, len(pairs), np.int32)), pixels


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 14))
def test_best_partners_merge_and_pool_their_pixels(seed: int, regions: int) -> None:
    graph, pixels = random_graph(seed, regions)
    probability = np.random.default_rng(seed).integers(0, 5, len(graph.edges)).astype(np.float32) / 4
    merged, number = merge_best(graph, probability, 0.5)

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
    assert merged.length.tolist() == [borders[key] for key in sorted(borders)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), regions=st.integers(1, 14), least=st.integers(1, 20))
def test_small_regions_join_the_most_similar_neighbour(seed: int, regions: int, least: int) -> None:
    graph, _ = random_graph(seed, regions)
    groups = [{region} for region in range(regions)]
    while True:
        count = [sum(graph.statistics.count[list(g)]) for g in groups]
        mean = [
            sum(graph.statistics.count[r] * graph.statistics.mean[r] for r in g) / c
            for g, c in zip(groups, count, strict=True)
        ]
        parts: list[set[int]] = [{k} for k in range(len(groups))]
        for k in range(len(groups)):
            length: dict[int, int] = {}
            for (a, b), sides in zip(graph.edges.tolist(), graph.length.tolist(), strict=True):
                at, to = (next(i for i, g in enumerate(groups) if r in g) for r in (a, b))
                if at != to and k in (at, to):
                    length[at + to - k] = length.get(at + to - k, 0) + sides
            if count[k] < least and length:
                best = min(length, key=lambda other: (abs(mean[k] - mean[other]), -length[other], other))
                one = next(p for p in parts if k in p) | next(p for p in parts if best in p)
                parts = [p for p in parts if not p & one] + [one]
        if len(parts) == len(groups):
            break
        groups = sorted((set().union(*(groups[k] for k in part)) for part in parts), key=min)
    joined, number = join_small(graph, least)
    assert [set(np.flatnonzero(number == k).tolist()) for k in range(joined.statistics.count.size)] == groups


def test_long_rows_are_sorted_and_united() -> None:
    """A region with many neighbours, every second of which becomes one with the next."""
    random = np.random.default_rng(0)
    count, others = 201, 200
    spokes = np.stack([np.zeros(others), np.arange(1, count)], axis=1).astype(np.int32)
    rim = np.stack([np.arange(1, count - 1), np.arange(2, count)], axis=1).astype(np.int32)
    edges = np.concatenate([spokes, rim])
    length = random.integers(1, 9, len(edges), np.int32)
    statistics = Statistics(np.ones(count), np.zeros(count), np.zeros(count))
    number = np.concatenate([[0], 1 + random.permutation(others) // 2]).astype(np.int32)
    merged, _ = contract(RegionGraph(statistics, edges, length), number, 101)
    expected: dict[tuple[int, int], int] = {}
    for (a, b), sides in zip(number[edges].tolist(), length.tolist(), strict=True):
        if a != b:
            expected[min(a, b), max(a, b)] = expected.get((min(a, b), max(a, b)), 0) + sides
    assert [tuple(e) for e in merged.edges.tolist()] == sorted(expected)
    assert merged.length.tolist() == [expected[key] for key in sorted(expected)]


def test_a_long_slope_does_not_become_one_region() -> None:
    """Steps of 0.3 m merge at a tolerance of 0.5 m, but only until their pooled means are farther apart."""
    steps = 64
    statistics = Statistics(np.full(steps, 16.0), 0.3 * np.arange(steps), np.zeros(steps))
    edges = np.stack([np.arange(steps - 1), np.arange(1, steps)], axis=1).astype(np.int32)
    graph = RegionGraph(statistics, edges, np.full(steps - 1, 4, np.int32))
    for _ in range(steps):
        difference = np.abs(np.diff(graph.statistics.mean[graph.edges], axis=1)[:, 0])
        graph, number = merge_best(graph, (1 - difference).astype(np.float32), 0.5)
        if number[-1] == number.size - 1:
            break
    assert graph.statistics.mean.size >= steps // 4
