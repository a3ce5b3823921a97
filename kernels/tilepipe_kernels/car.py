"""Sampler of the conditional autoregressive (CAR) model of region heights: see `car_model` for the mathematics."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Literal

import numpy as np

from .car_chain import Variances, check_lengths, check_tolerance, moments, run_chain, spread_blocks
from .car_exact import SOLVER_TOLERANCE, check_variances, checked_sites, draw_exactly, measure, perturb_and_map
from .car_grid import sample_grid
from .car_model import CarModel, Float32, Float64, Int32, Int64, Posterior, Priors, Traces
from .car_sweeps import BLOCK, add_counts, add_probabilities, condition, settle, update_blocks
from .colouring import colour_graph, order_by_colour, rows_in_order
from .random import as_seed

__all__ = [
    "CarModel", "Posterior", "Priors", "Traces", "expect", "perturb_and_map", "sample", "sample_grid",
    "sample_variances",
]  # fmt: skip

_SETTLED = 0.01
"""Share of the tolerance below which steps of heights to their expectation are not worth a pass: the next steps are
smaller still."""

_MOST_PASSES = 100


def _start(model: CarModel) -> Float64:
    """The means, and the mean of all where a node has no data."""
    if model.count.all():
        return model.mean
    level = float((model.count * model.mean).sum() / model.count.sum())
    return np.where(model.count > 0, model.mean, level)


class _Gibbs:
    """State of one chain that updates site by site: rows and heights stand in the order of their colours."""

    def __init__(
        self, model: CarModel, sites: Int64, seed: np.uint64, workers: int, pool: ThreadPoolExecutor | None
    ) -> None:
        self.graph, self.sites, self.seed = model.graph, sites, seed
        self.serial, self.spread_out = pool is None, partial(spread_blocks, pool, workers)
        order, classes = order_by_colour(colour_graph(model.edges, len(model.count)))
        self.rows = rows_in_order(self.graph.edges, self.graph.weights, order)
        starts = [np.arange(a, b, BLOCK) for a, b in itertools.pairwise(classes)]
        self.bounds = np.append(np.concatenate(starts), classes[-1:])
        self.class_bounds = [0, *itertools.accumulate(map(len, starts))]
        self.sums = np.empty((len(self.bounds) - 1, 2))
        self.x = _start(model)[order]

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all sites, colour by colour; return roughness and misfit."""
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)

        def work(first: int, last: int) -> None:
            update_blocks(
                self.rows, self.graph, self.sites, self.bounds, first, last, smooth, fit, self.seed, at, self.x,
                self.sums,
            )  # fmt: skip

        if self.serial:  # blocks stand in the order of their colours
            work(0, len(self.sums))
        else:
            for first, last in itertools.pairwise(self.class_bounds):
                self.spread_out(work, first, last)
        roughness, misfit = self.sums.sum(axis=0)
        return float(roughness), float(misfit)

    def heights(self) -> Float64:
        """Heights x in the order of the nodes."""
        heights = np.empty_like(self.x)
        heights[self.rows.order] = self.x
        return heights


class _Exact:
    """State of one chain that draws all sites at once."""

    def __init__(self, model: CarModel, sites: Int64, seed: np.uint64) -> None:
        self.graph, self.sites, self.seed, self.x = model.graph, sites, seed, _start(model).copy()
        self.scratch = np.empty_like(self.x), np.empty_like(self.x)

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Draw all sites; return roughness and misfit."""
        draw_exactly(
            self.graph, self.sites, variances.smoothness, variances.noise, self.seed, sweep, self.x,
            SOLVER_TOLERANCE, self.scratch,
        )  # fmt: skip
        return measure(self.graph, self.x)

    def heights(self) -> Float64:
        """Heights x in the order of the nodes."""
        return self.x


class _Edges:
    """Probabilities that the two sides of each edge have the same height, given all other heights and the variances."""

    def __init__(self, model: CarModel, tolerance: float, workers: int, pool: ThreadPoolExecutor | None) -> None:
        self.graph, self.tolerance, self.spread_out = model.graph, tolerance, partial(spread_blocks, pool, workers)
        self.precision, self.pull = np.empty_like(model.mean), np.empty_like(model.mean)
        self.same: Float32 = np.zeros(len(model.edges), np.float32)

    def condition(self, smooth: float, fit: float, x: Float64) -> None:
        """Find the conditionals of all heights given the others at x, and the precisions 1/v and 1/s2."""
        condition(self.graph, smooth, fit, x, self.precision, self.pull)

    def add(self, smooth: float, x: Float64) -> None:
        """Add the probabilities given the heights that the conditionals were found at."""
        graph = self.graph

        def work(first: int, last: int) -> None:
            add_probabilities(
                graph, smooth, self.tolerance, x, self.precision, self.pull, first, last, self.same
            )  # fmt: skip

        self.spread_out(work, 0, len(self.same))

    def count(self, x: Float64) -> None:
        """Add one where heights x are the same."""
        add_counts(self.graph, self.tolerance, x, 0, len(self.same), self.same)


def _edge_positions(graph_edges: Int32, edges: Int32, nodes: int) -> Int64:
    keys = graph_edges[:, 0].astype(np.int64) * nodes + graph_edges[:, 1]
    low, high = edges.min(axis=1).astype(np.int64), edges.max(axis=1).astype(np.int64)
    wanted = low * nodes + high
    places: Int64 = np.searchsorted(keys, wanted)
    if len(wanted) and (low.min() < 0 or high.max() >= nodes or (np.append(keys, -1)[places] != wanted).any()):
        raise ValueError("edges must be pairs of node numbers that the graph joins")
    return places


def _start_variances(model: CarModel, fixed: float | None, key: np.uint64) -> Variances:
    return Variances.start(
        model.priors, len(model.count) - model.components, model.count, model.mean, float(model.spread.sum()),
        float(model.count.sum()), fixed, key,
    )  # fmt: skip


def _threads(stack: ExitStack, workers: int) -> ThreadPoolExecutor | None:
    return stack.enter_context(ThreadPoolExecutor(workers)) if workers > 1 else None


def sample_variances(
    model: CarModel,
    *,
    burn_in: int,
    draws: int,
    thinning: int = 1,
    seed: int = 0,
    fixed_variance: float | None = None,
    site_ids: Int64 | None = None,
    workers: int = 1,
) -> Traces:
    """Draw from the posterior of the variances: `sample` without what the draws say of heights and edges.

    Arguments, errors and traces are those of `sample`; it takes less time and memory.
    """
    check_lengths(burn_in, draws, thinning, workers)
    key = as_seed(seed)
    sites, variances = checked_sites(site_ids, len(model.count)), _start_variances(model, fixed_variance, key)
    with ExitStack() as stack:
        chain = _Gibbs(model, sites, key, workers, _threads(stack, workers))
        return Traces(*run_chain(chain.draw, lambda: None, variances, burn_in, draws, thinning))


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
        int32 (k, 2): edges to report, in this order; by default all of ``model.edges``.
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
    check_lengths(burn_in, draws, thinning, workers)
    check_tolerance(tolerance)
    if method not in ("gibbs", "exact"):
        raise ValueError(f"method must be 'gibbs' or 'exact', not {method!r}")
    key, nodes = as_seed(seed), len(model.count)
    sites = checked_sites(site_ids, nodes)
    places = None if edges is None else _edge_positions(model.edges, np.asarray(edges).reshape(-1, 2), nodes)
    variances = _start_variances(model, fixed_variance, key)
    shift, square = np.zeros(nodes), np.zeros(nodes)
    with ExitStack() as stack:
        pool = _threads(stack, workers)
        chain = _Gibbs(model, sites, key, workers, pool) if method == "gibbs" else _Exact(model, sites, key)
        found = _Edges(model, tolerance, workers, pool)

        def keep() -> None:
            x = chain.heights()
            difference = x - model.mean
            np.add(shift, difference, out=shift)
            np.add(square, difference * difference, out=square)
            if counting:
                found.count(x)
            else:
                smooth = 1 / variances.smoothness
                found.condition(smooth, 1 / variances.noise, x)
                found.add(smooth, x)

        traces = run_chain(chain.draw, keep, variances, burn_in, draws, thinning)
    mean, sd = moments(model.mean, shift, square, draws)
    same = np.divide(found.same, draws, out=found.same)
    return Posterior(*traces, mean, sd, same if places is None else same[places])


def expect(
    model: CarModel, smoothness: float, noise: float, *, tolerance: float, workers: int = 1
) -> tuple[Float64, Float32]:
    """Posterior means of the heights given both variances, and edge probabilities with all other heights there.

    The probabilities are those that `sample` averages over its draws, taken once, at the means: without the scatter of
    the surroundings they are a little too sure, the less the more pixels a region has.  Means are found by Jacobi's
    iteration, which converges because every row of the precision is dominated by its diagonal.

    Parameters
    ----------
    model
        Graph and data.
    smoothness, noise
        v and s2, m².
    tolerance
        As for `sample`.
    workers
        Threads; they do not change the result.

    Returns
    -------
    mean, same
        float64 (n,), m, and float32 (m,).

    Raises
    ------
    ValueError
        For variances that are not positive, a negative tolerance.
    """
    check_tolerance(tolerance)
    check_variances(smoothness, noise)
    smooth, fit, x = 1 / smoothness, 1 / noise, _start(model).copy()
    with ExitStack() as stack:
        edges = _Edges(model, tolerance, workers, _threads(stack, workers))
        edges.condition(smooth, fit, x)
        passes = 1
        while passes < _MOST_PASSES and settle(edges.precision, edges.pull, x, _SETTLED * tolerance):
            edges.condition(smooth, fit, x)
            passes += 1
        edges.add(smooth, x)
    return x, edges.same
