"""Sampler of the conditional autoregressive (CAR) model of region heights: see `car_model` for the mathematics."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Literal

import numpy as np

from .car_chain import Variances, check_lengths, moments, run_chain, spread_blocks
from .car_exact import SOLVER_TOLERANCE, checked_sites, draw_exactly, measure, perturb_and_map
from .car_grid import sample_grid
from .car_model import CarModel, Int32, Int64, Posterior, Priors
from .car_sweeps import BLOCK, add_counts, add_probabilities, find_edge_starts, prepare_nodes, update_blocks
from .colouring import colour_graph, order_by_colour
from .random import as_seed

__all__ = ["CarModel", "Posterior", "Priors", "perturb_and_map", "sample", "sample_grid"]


class _Chain:
    """State of one chain over a region graph: x, running sums, and how to draw and keep it."""

    def __init__(
        self, model: CarModel, sites: Int64, seed: np.uint64, workers: int, pool: ThreadPoolExecutor | None
    ) -> None:
        self.graph, self.sites, self.seed = model.graph, sites, seed
        self.serial, self.spread_out = pool is None, partial(spread_blocks, pool, workers)
        self.colours = colour_graph(model.offsets, model.neighbours)
        self.order, classes = order_by_colour(self.colours)
        starts = [np.arange(a, b, BLOCK) for a, b in itertools.pairwise(classes)]
        self.bounds = np.append(np.concatenate(starts), classes[-1:])
        self.class_bounds = [0, *itertools.accumulate(map(len, starts))]
        self.sums = np.empty((len(self.bounds) - 1, 2))
        n = len(model.count)
        level = float((model.count * model.mean).sum() / model.count.sum())
        self.x = np.where(model.count > 0, model.mean, level)
        self.shift, self.square, self.precision, self.pull = np.zeros(n), np.zeros(n), np.empty(n), np.empty(n)
        self.edge_starts = np.empty(-(-n // BLOCK) + 1, np.int64)
        find_edge_starts(model.offsets, model.neighbours, self.edge_starts)
        self.same = np.zeros(self.edge_starts[-1], np.float32)

    def gibbs(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all sites, colour by colour; return roughness and misfit."""
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)

        def work(first: int, last: int) -> None:
            update_blocks(
                self.graph, self.order, self.colours, self.sites, self.bounds, first, last,
                smooth, fit, self.seed, at, self.x, self.sums,
            )  # fmt: skip

        if self.serial:  # blocks stand in the order of their colours
            work(0, len(self.sums))
        else:
            for first, last in itertools.pairwise(self.class_bounds):
                self.spread_out(work, first, last)
        roughness, misfit = self.sums.sum(axis=0)
        return float(roughness), float(misfit)

    def exact(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Draw all sites at once; return roughness and misfit."""
        draw_exactly(
            self.graph, self.sites, variances.smoothness, variances.noise, self.seed, sweep, self.x,
            SOLVER_TOLERANCE, (self.precision, self.pull),
        )  # fmt: skip
        return measure(self.graph, self.x)

    def keep(self, variances: Variances, tolerance: float, counting: bool) -> None:
        """Add the present state to the sums."""
        smooth, fit, x = 1 / variances.smoothness, 1 / variances.noise, self.x

        def nodes(first: int, last: int) -> None:
            prepare_nodes(
                self.graph, smooth, fit, x, first, last, self.precision, self.pull, self.shift, self.square
            )  # fmt: skip

        def edges(first: int, last: int) -> None:
            if counting:
                add_counts(self.graph, tolerance, x, self.edge_starts, first, last, self.same)
            else:
                add_probabilities(
                    self.graph, smooth, tolerance, x, self.precision, self.pull, self.edge_starts,
                    first, last, self.same,
                )  # fmt: skip

        blocks = len(self.edge_starts) - 1
        self.spread_out(nodes, 0, blocks)
        self.spread_out(edges, 0, blocks)


def _edge_positions(graph_edges: Int32, edges: Int32, nodes: int) -> Int64:
    keys = graph_edges[:, 0].astype(np.int64) * nodes + graph_edges[:, 1]
    low, high = edges.min(axis=1).astype(np.int64), edges.max(axis=1).astype(np.int64)
    wanted = low * nodes + high
    places: Int64 = np.searchsorted(keys, wanted)
    if len(wanted) and (low.min() < 0 or high.max() >= nodes or (np.append(keys, -1)[places] != wanted).any()):
        raise ValueError("edges must be pairs of node numbers that the graph joins")
    return places


def sample(
    model: CarModel,
    *,
    burn_in: int,
    draws: int,
    tolerance: float,
    thinning: int = 1,
    seed: int = 0,
    fixed_variance: float | None = None,
    site_ids: Int64 | None = None,
    edges: Int32 | None = None,
    method: Literal["gibbs", "exact"] = "gibbs",
    counting: bool = False,
    workers: int = 1,
) -> Posterior:
    """Draw from the posterior of region heights and variances.

    A sweep updates x given the variances, then v and s2 given x.

    Parameters
    ----------
    model
        Graph, data, priors.
    burn_in, draws, thinning
        Sweeps left out; sweeps kept; one sweep is kept of every `thinning`.
    tolerance
        δ, m: largest difference of two heights that count as the same.
    seed
        0 to 2⁶⁴ - 1.
    fixed_variance
        s2 in m², if it is not to be learned.
    site_ids
        int64 (n,), ascending: global ids that the random numbers are drawn for; 0..n-1 by default.
    edges
        int32 (k, 2): edges to report, in this order; by default all of ``model.edges()``.
    method
        ``"gibbs"`` updates site by site in colour classes, ``"exact"`` draws all x at once (`perturb_and_map`; in
        one thread).
    counting
        Estimate the edge probabilities by counting draws, not by the mean of the probabilities given all other
        sites (Gelfand & Smith 1990), which has less noise; for comparison.
    workers
        Threads; they do not change the result.

    Returns
    -------
    Posterior

    Raises
    ------
    ValueError
        For arguments out of their ranges, ids that do not ascend, edges that the graph has not.
    """
    check_lengths(burn_in, draws, thinning, tolerance, workers)
    if method not in ("gibbs", "exact"):
        raise ValueError(f"method must be 'gibbs' or 'exact', not {method!r}")
    key, nodes = as_seed(seed), len(model.count)
    sites = checked_sites(site_ids, nodes)
    places = None if edges is None else _edge_positions(model.edges(), np.asarray(edges).reshape(-1, 2), nodes)
    variances = Variances.start(
        model.priors, nodes - model.components, model.count, model.mean, float(model.spread.sum()),
        float(model.count.sum()), fixed_variance, key,
    )  # fmt: skip
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(workers)) if workers > 1 else None
        chain = _Chain(model, sites, key, workers, pool)
        draw = chain.gibbs if method == "gibbs" else chain.exact
        traces = run_chain(
            draw, lambda: chain.keep(variances, tolerance, counting), variances, burn_in, draws, thinning
        )
        chain.precision = chain.pull = chain.x[:0]  # room for the results
    mean, sd = moments(model.mean, chain.shift, chain.square, draws)
    same = np.divide(chain.same, draws, out=chain.same)
    return Posterior(*traces, mean, sd, same if places is None else same[places])
