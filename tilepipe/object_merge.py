"""Reconciliation of `objects`: sample the heights of the region graph, merge what is one, until nothing merges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilepipe.object_parameters import ObjectParameters
from tilepipe.reconcile import unite
from tilepipe_kernels.car import CarModel, Posterior, sample
from tilepipe_kernels.merging import RegionGraph, contract, induced, merge_best, neighbour_lists

_LATER_SHARE = 4
"""Rounds of merging know the variances and take this share of the sweeps; what is published takes all."""

_DRIFT, _SURE_PIXELS = 0.02, 64
"""A region that grows leaves its borders' probabilities as they are while its mean moves by less than this share of
the merge height, if it had so many pixels before."""

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Merged:
    """Regions of a raster and what the posterior says of them.

    Attributes
    ----------
    region
        Region 0 … n - 1 of every leaf, ordered by lowest leaf, int32.
    graph
        Graph of the regions.
    probability
        For each remaining edge the probability that its two sides are one object, float32.
    mean, deviation
        Posterior mean and standard deviation of each region's height in m, float64.
    first
        Posterior of the leaves, before anything merged; its traces tell whether the sampler has converged.
    rounds
        Rounds of merging.
    """

    region: NDArray[np.int32]
    graph: RegionGraph
    probability: NDArray[np.float32]
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    first: Posterior
    rounds: int


def merge_regions(
    graph: RegionGraph,
    sites: NDArray[np.int64],
    parameters: ObjectParameters,
    *,
    resolution: float,
    seed: int = 0,
    workers: int = 1,
    tell: Tell | None = None,
) -> Merged:
    """Sample and merge until nothing merges.

    Parameters
    ----------
    graph
        Graph of the leaves.
    sites
        Lowest global pixel of each leaf, ascending, int64: names its random numbers.
    parameters
        Of the pipeline.
    resolution
        Pixel size in metres.
    seed
        Seed of the random numbers.
    workers
        Threads; they do not show in the result.
    tell
        Called with (stage, done, total) after each round.

    Returns
    -------
    Merged
    """
    sampler = _Sampler(parameters, seed, workers)
    first = posterior = sampler.sample(graph, sites, share=1)
    assert posterior.same is not None
    if sampler.variance is None:
        sampler = replace(sampler, variance=float(first.noise.mean()))
    region, probability = np.arange(sites.size, dtype=np.int32), posterior.same.astype(np.float32)
    rounds, settled = 0, False
    while True:
        before = graph
        graph, number, source = merge_best(before, probability, parameters.merge_probability)
        if graph.statistics.count.size < before.statistics.count.size and rounds < parameters.merge_rounds:
            rounds, settled = rounds + 1, False
            moved = _moved(before, graph, number, parameters.merge_height)[before.edges[source]]
            region, sites, probability = number[region], _lowest(sites, number), probability[source]
            sampler.resample(graph, sites, probability, moved[:, 0] | moved[:, 1], rounds)
        elif settled:
            if tell is not None:
                tell("merge", rounds, rounds)
            return Merged(region, before, probability, posterior.mean, posterior.sd, first, rounds)
        else:
            # what small regions have joined may be one with its neighbours now, so that merging goes on after them
            graph, number = join_small(before, parameters.minimum_area / resolution**2)
            region, sites = number[region], _lowest(sites, number)
            posterior = sampler.sample(graph, sites, share=1, round=parameters.merge_rounds + 1 + rounds)
            assert posterior.same is not None
            probability, settled = posterior.same.astype(np.float32), True
        if tell is not None:
            tell("merge", rounds, rounds + 1)


def _lowest(sites: NDArray[np.int64], number: NDArray[np.int32]) -> NDArray[np.int64]:
    """Lowest site of the members of each new region; sites ascend."""
    return sites[np.unique(number, return_index=True)[1]]


def _moved(before: RegionGraph, after: RegionGraph, number: NDArray[np.int32], height: float) -> NDArray[np.bool_]:
    """Which old regions are part of one whose pooled mean differs, or which was too small to be sure of its own."""
    old, new = before.statistics, after.statistics
    grown = new.count[number] > old.count
    unsure = old.count < _SURE_PIXELS
    moved: NDArray[np.bool_] = grown & (unsure | (np.abs(new.mean[number] - old.mean) > _DRIFT * height))
    return moved


@dataclass(frozen=True)
class _Sampler:
    """Samples a region graph; ``variance`` None is learned."""

    parameters: ObjectParameters
    seed: int
    workers: int
    variance: float | None = None

    def sample(self, graph: RegionGraph, sites: NDArray[np.int64], *, share: int, round: int = 0) -> Posterior:
        """Posterior of all regions of a graph, by one of ``share`` parts of the sweeps."""
        p, s = self.parameters, graph.statistics
        offsets, neighbours, edge_of = neighbour_lists(graph.edges, s.count.size)
        weights = border_weights(graph, p)[edge_of]
        return sample(
            CarModel(offsets, neighbours, weights, s.count, s.mean, s.spread),
            burn_in=-(-p.burn_in // share),
            draws=max(2, -(-p.draws // share)),
            thinning=p.thinning,
            seed=self.seed + round,
            fixed_variance=self.variance if self.variance is not None else p.variance,
            site_ids=sites,
            tolerance=p.merge_height,
            workers=self.workers,
        )

    def resample(
        self,
        graph: RegionGraph,
        sites: NDArray[np.int64],
        probability: NDArray[np.float32],
        stale: NDArray[np.bool_],
        round: int,
    ) -> None:
        """Renew the probabilities of stale borders; their regions are sampled without the others.

        Farther away the heights hardly depend on them: a region's pixels outweigh its surroundings.
        """
        if not stale.any():
            return
        near = np.zeros(sites.size, np.bool_)
        near[graph.edges[stale]] = True
        part, among = induced(graph, near)
        same = self.sample(part, sites[near], share=_LATER_SHARE, round=round).same
        assert same is not None
        renewed = stale[among]
        probability[among[renewed]] = same[renewed]


def border_weights(graph: RegionGraph, parameters: ObjectParameters) -> NDArray[np.float32]:
    """Weight w_ij of every edge, mean about 1: all one, the border's length, or high where heights are alike."""
    kind = parameters.border_weights
    if kind == "adjacency" or not len(graph.length):
        return np.ones(len(graph.length), np.float32)
    if kind == "border":
        return np.asarray(graph.length / graph.length.mean(), np.float32)
    mean = graph.statistics.mean
    step = (mean[graph.edges[:, 0]] - mean[graph.edges[:, 1]]) / parameters.merge_height
    return np.asarray(1 / (1 + step**2), np.float32)


def join_small(graph: RegionGraph, least: float) -> tuple[RegionGraph, NDArray[np.int32]]:
    """Join regions of fewer than ``least`` pixels to the neighbour of the most similar height, until none is left.

    Regions without neighbours stay.  Of equally similar neighbours the one with the longer border counts, then the
    one of the lower number.
    """
    region = np.arange(graph.statistics.count.size, dtype=np.int32)
    while True:
        count, mean = graph.statistics.count, graph.statistics.mean
        small = np.flatnonzero((count < least) & (np.bincount(graph.edges.reshape(-1), minlength=count.size) > 0))
        if not small.size:
            return graph, region
        ends = np.concatenate([graph.edges, graph.edges[:, ::-1]])
        ends, length = ends[count[ends[:, 0]] < least], np.tile(graph.length, 2)[count[ends[:, 0]] < least]
        step = np.abs(mean[ends[:, 0]] - mean[ends[:, 1]])
        order = np.lexsort((ends[:, 1], -length, step, ends[:, 0]))
        ends = ends[order]
        best = ends[np.unique(ends[:, 0], return_index=True)[1]]
        number = unite(count.size, best.astype(np.int64)).astype(np.int32)
        graph, region = contract(graph, number, int(number.max()) + 1)[0], number[region]
