"""Sampler of the conditional autoregressive (CAR) model of region heights: see `car_model.model` for the mathematics.

A model whose arrays lie on a device is sampled there, to the very bits of the host; results stay there, but for the
traces of the variances, which the host draws.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Literal

import numpy as np

from tilepipe_kernels.car_model.chain import Variances, check_lengths, check_tolerance, moments, run_chain
from tilepipe_kernels.car_model.exact import check_variances, checked_sites, refuse_device
from tilepipe_kernels.car_model.model import CarModel, Float32, Float64, Int32, Int64, Posterior, Traces
from tilepipe_kernels.car_model.states import Exact, edge_probabilities, gibbs_chain, start_of
from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.random import as_seed
from tilepipe_kernels.core.sums import ordered_sum

_SETTLED = 0.01
"""Share of the tolerance below which steps of heights to their expectation are not worth a pass: the next steps are
smaller still."""

_MOST_PASSES = 100


def _edge_positions(graph_edges: Int32, edges: Int32, nodes: int) -> Int64:
    xp = namespace(graph_edges, edges)
    keys = graph_edges[:, 0].astype(xp.int64) * nodes + graph_edges[:, 1]
    low, high = edges.min(axis=1).astype(xp.int64), edges.max(axis=1).astype(xp.int64)
    wanted = low * nodes + high
    places: Int64 = xp.searchsorted(keys, wanted)
    last = xp.full(1, -1, xp.int64)
    if len(wanted) and (low.min() < 0 or high.max() >= nodes or (xp.concatenate((keys, last))[places] != wanted).any()):
        raise ValueError("edges must be pairs of node numbers that the graph joins")
    return places


def _start_variances(model: CarModel, fixed: float | None, key: np.uint64) -> Variances:
    return Variances.start(
        model.priors, len(model.count) - model.components, model.count, model.mean, ordered_sum(model.spread),
        ordered_sum(model.count), fixed, key,
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

    Examples
    --------
    Forty regions in a row, whose heights differ by little, each of 50 pixels with noise of variance 0.04 m².

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.model import CarModel
    >>> from tilepipe_kernels.car_model.sampler import sample_variances
    >>> edges, count = np.stack([np.arange(39), np.arange(1, 40)], axis=1).astype(np.int32), np.full(40, 50.0)
    >>> model = CarModel(edges, None, count, mean=np.sin(np.arange(40.0)), spread=0.04 * count)
    >>> traces = sample_variances(model, burn_in=50, draws=200)
    >>> round(float(traces.noise.mean()), 2)
    0.04
    """
    check_lengths(burn_in, draws, thinning, workers)
    key = as_seed(seed)
    sites, variances = checked_sites(site_ids, model), _start_variances(model, fixed_variance, key)
    with ExitStack() as stack:
        chain = gibbs_chain(model, sites, key, workers, _threads(stack, workers))
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
        one thread of the host).
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

    Examples
    --------
    Two regions of one roof, 6.0 m and 6.1 m, and a tower of 12 m beside them.

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.model import CarModel
    >>> from tilepipe_kernels.car_model.sampler import sample
    >>> count = np.array([80.0, 100.0, 90.0])
    >>> edges = np.array([[0, 1], [1, 2]], np.int32)
    >>> model = CarModel(edges, None, count, mean=np.array([6.0, 6.1, 12.0]), spread=0.04 * count)
    >>> posterior = sample(model, burn_in=50, draws=200, tolerance=0.3)
    >>> posterior.mean.round(1).tolist(), posterior.same.round(1).tolist()
    ([6.0, 6.1, 12.0], [1.0, 0.0])
    """
    check_lengths(burn_in, draws, thinning, workers)
    check_tolerance(tolerance)
    if method not in ("gibbs", "exact"):
        raise ValueError(f"method must be 'gibbs' or 'exact', not {method!r}")
    if method == "exact":
        refuse_device(model)
    key, nodes = as_seed(seed), len(model.count)
    sites, xp = checked_sites(site_ids, model), namespace(model.mean)
    places = None if edges is None else _edge_positions(model.edges, xp.asarray(edges).reshape(-1, 2), nodes)
    variances = _start_variances(model, fixed_variance, key)
    shift, square = xp.zeros(nodes), xp.zeros(nodes)
    with ExitStack() as stack:
        pool = _threads(stack, workers)
        chain = gibbs_chain(model, sites, key, workers, pool) if method == "gibbs" else Exact(model, sites, key)
        found = edge_probabilities(model, tolerance, workers, pool)

        def keep() -> None:
            nonlocal shift, square
            x = chain.heights()
            difference = x - model.mean
            shift += difference
            square += difference * difference
            if counting:
                found.count(x)
            else:
                smooth = 1 / variances.smoothness
                found.condition(smooth, 1 / variances.noise, x)
                found.add(smooth, x)

        traces = run_chain(chain.draw, keep, variances, burn_in, draws, thinning)
    mean, sd = moments(model.mean, shift, square, draws)
    same = found.same
    same /= draws
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

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.model import CarModel
    >>> from tilepipe_kernels.car_model.sampler import expect
    >>> count = np.array([80.0, 100.0, 90.0])
    >>> edges = np.array([[0, 1], [1, 2]], np.int32)
    >>> model = CarModel(edges, None, count, mean=np.array([6.0, 6.1, 12.0]), spread=0.04 * count)
    >>> mean, same = expect(model, smoothness=1.0, noise=0.04, tolerance=0.3)
    >>> mean.round(2).tolist(), same.round(2).tolist()
    ([6.0, 6.1, 12.0], [1.0, 0.0])
    """
    check_tolerance(tolerance)
    check_variances(smoothness, noise)
    smooth, fit = 1 / smoothness, 1 / noise
    with ExitStack() as stack:
        edges = edge_probabilities(model, tolerance, workers, _threads(stack, workers))
        x = edges.settle(smooth, fit, start_of(model), _SETTLED * tolerance, _MOST_PASSES)
        edges.add(smooth, x)
    return x, edges.same
