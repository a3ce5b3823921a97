"""Reconciliation of `objects`: sample the heights of the region graph, merge what is one, until nothing merges.

The variances are sampled once, on the leaves.  Rounds of merging then go by probabilities at the posterior means, which
take no sampling; the probabilities that are published come from the full sampler on the merged graph, and what still
merges by them begins further rounds.

The graph of a whole raster is one: with the backend cupy it is uploaded once, sampled and merged on the device, and
what is left of it downloaded once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.device import fitting
from tilepipe.engine.work import Work
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe_kernels.car_model.model import CarModel, Posterior, Traces
from tilepipe_kernels.car_model.sampler import expect, sample, sample_variances
from tilepipe_kernels.core.arrays import Backend, namespace, to_backend, to_host
from tilepipe_kernels.regions.contraction import RegionGraph, Statistics, first_members
from tilepipe_kernels.regions.merging import join_small, merge_best

_FEW_BORDERS = 0.02
"""Rounds end when fewer than this share of all borders can merge: small regions come first then, and free the rest."""

LOOKUP = "lookup.npy"
"""File in the state folder: region id of every local leaf number, tile after tile."""

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
        Variances of the leaves, before anything merged: they tell whether the sampler has converged.
    rounds
        Rounds of merging.
    """

    region: NDArray[np.int32]
    graph: RegionGraph
    probability: NDArray[np.float32]
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    first: Traces
    rounds: int


def merge_leaves(run: Work, leaves: Leaves, graph: RegionGraph) -> tuple[Leaves, Merged]:
    """The leaves and their merged regions, whose ids go to the state folder for the next pass."""
    with run.timed("merge"):
        given_up = [graph]
        del graph  # nobody holds the graph of the leaves any more once it has merged
        advice = "use larger leaves (smallest_leaf) or --backend numpy"
        with fitting("the region graph", advice, run.backend_here):
            merged = merge_regions(
                given_up.pop(),
                leaves.first,
                run.parameters,
                resolution=run.resolution,
                seed=run.options.seed,
                workers=run.options.resolved_workers,
                tell=run.progress,
                backend=run.backend_here,
            )
        np.save(run.folder / LOOKUP, leaves.lookup((merged.region + 1).astype(np.uint32)))
        return leaves, merged


def merge_regions(
    graph: RegionGraph,
    sites: NDArray[np.int64],
    parameters: ObjectParameters,
    *,
    resolution: float,
    seed: int = 0,
    workers: int = 1,
    tell: Tell | None = None,
    backend: Backend = "numpy",
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
    backend
        Where to sample and merge; it does not show in the result.

    Returns
    -------
    Merged
        On the host.
    """
    move = partial(to_backend, backend=backend)
    graph, sites = _moved(graph, move), move(sites)
    sampler = _Sampler(parameters, seed, workers)
    first = sampler.variances(graph, sites)
    smoothness, noise = float(first.smoothness.mean()), float(first.noise.mean())
    state = _State(parameters, graph, namespace(sites).arange(sites.size, dtype=np.int32), tell)
    del graph
    smallest = parameters.smallest_region(resolution)
    while True:
        state.merge_expected(smoothness, noise, workers, _FEW_BORDERS)
        # what small regions have joined may be one with its neighbours now, so that merging goes on after them
        state.join_small(smallest)
        state.merge_expected(smoothness, noise, workers, 0.0)
        posterior = sampler.posterior(state.graph, sites[state.first_leaves()], noise, round=state.rounds)
        assert posterior.same is not None
        if not state.merge(posterior.same):
            if tell is not None:
                tell("merge", state.rounds, state.rounds)
            same, mean, deviation = map(to_host, (posterior.same, posterior.mean, posterior.sd))
            graph = _moved(state.graph, to_host)
            return Merged(to_host(state.region), graph, same, mean, deviation, first, state.rounds)


def _moved(graph: RegionGraph, move: Callable[[NDArray[Any]], NDArray[Any]]) -> RegionGraph:
    s = graph.statistics
    return RegionGraph(Statistics(move(s.count), move(s.mean), move(s.spread)), move(graph.edges), move(graph.length))


@dataclass
class _State:
    """Regions while they merge."""

    parameters: ObjectParameters
    graph: RegionGraph
    region: NDArray[np.int32]
    tell: Tell | None
    rounds: int = 0

    def merge(self, probability: NDArray[np.float32], share: float = 0.0) -> bool:
        """One round; whether more than a share of the borders could merge and rounds were left."""
        p = self.parameters
        # of arrays of a device the host reads this count, which tells whether to go on
        candidates = int((probability >= p.merge_probability).sum())
        if self.rounds >= p.merge_rounds or candidates <= share * probability.size:
            return False
        self.graph, number = merge_best(self.graph, probability, p.merge_probability)
        self.region, self.rounds = number[self.region], self.rounds + 1
        if self.tell is not None:
            self.tell("merge", self.rounds, self.rounds + 1)
        return True

    def merge_expected(self, smoothness: float, noise: float, workers: int, share: float) -> None:
        """Rounds by the probabilities at the posterior means given the variances, which take no sampling."""
        merging = True
        while merging:
            model = car_model(self.graph, self.parameters)
            _, probability = expect(
                model, smoothness, noise, tolerance=self.parameters.merge_height, workers=workers
            )  # fmt: skip
            merging = self.merge(probability, share)

    def join_small(self, least: float) -> None:
        """Join regions of fewer than ``least`` pixels to the neighbour of the most similar height."""
        self.graph, number = join_small(self.graph, least)
        self.region = number[self.region]

    def first_leaves(self) -> NDArray[np.int64]:
        """Lowest leaf of each region."""
        return first_members(self.region, self.graph.statistics.count.size)


def car_model(graph: RegionGraph, parameters: ObjectParameters) -> CarModel:
    """The model of the heights of a region graph."""
    s = graph.statistics
    return CarModel(graph.edges, border_weights(graph, parameters), s.count, s.mean, s.spread)


@dataclass(frozen=True)
class _Sampler:
    """Samples a region graph."""

    parameters: ObjectParameters
    seed: int
    workers: int

    def variances(self, graph: RegionGraph, sites: NDArray[np.int64]) -> Traces:
        """Variances of the heights of a graph."""
        p = self.parameters
        return sample_variances(
            car_model(graph, p),
            burn_in=p.burn_in,
            draws=p.draws,
            thinning=p.thinning,
            seed=self.seed,
            fixed_variance=p.variance,
            site_ids=sites,
            workers=self.workers,
        )

    def posterior(self, graph: RegionGraph, sites: NDArray[np.int64], noise: float, *, round: int) -> Posterior:
        """Posterior of the regions of a graph, their noise known."""
        p = self.parameters
        return sample(
            car_model(graph, p),
            burn_in=p.burn_in,
            draws=p.draws,
            thinning=p.thinning,
            seed=self.seed + round,
            fixed_variance=noise,
            site_ids=sites,
            tolerance=p.merge_height,
            workers=self.workers,
        )


def border_weights(graph: RegionGraph, parameters: ObjectParameters) -> NDArray[np.float32] | None:
    """Weight w_ij of every edge, mean about 1: all one (None), the border's length, or high where heights are alike."""
    kind = parameters.border_weights
    if kind == "adjacency" or not len(graph.length):
        return None
    if kind == "border":
        weights: NDArray[np.float64] = graph.length / graph.length.mean()
    else:
        mean = graph.statistics.mean
        step = (mean[graph.edges[:, 0]] - mean[graph.edges[:, 1]]) / parameters.merge_height
        weights = 1 / (1 + step * step)
    of_edges: NDArray[np.float32] = weights.astype(np.float32)
    return of_edges
