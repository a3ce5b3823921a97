"""Exact draws of region heights given the variances: perturbed right side, conjugate gradients."""

from __future__ import annotations

import math

import numpy as np

from tilepipe_kernels.car_model.model import CarModel, Float64, Graph, Int64, weight_of
from tilepipe_kernels.car_model.sweeps import NODE_STREAM
from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.random import as_seed, normal

_FIRST_EDGE_STREAM = 1

SOLVER_TOLERANCE = 1e-5
"""Residual at which conjugate gradients end, in standard deviations of the right side's noise."""

_SOLVER_LIMIT = 10_000


def checked_sites(site_ids: Int64 | None, model: CarModel) -> Int64:
    """Ascending global ids of the nodes, empty for 0..n-1; they lie where the model does."""
    xp = namespace(model.mean, site_ids)
    if site_ids is None:
        empty: Int64 = xp.empty(0, xp.int64)
        return empty
    sites: Int64 = xp.ascontiguousarray(site_ids, dtype=xp.int64)
    if sites.shape != model.mean.shape or sites[0] < 0 or (sites[1:] <= sites[:-1]).any():
        raise ValueError("site_ids must be ascending, 0 or more, one for each node: list the nodes in their order")
    return sites


def check_variances(smoothness: float, noise: float) -> None:
    """Refuse variances out of their range."""
    if not (0 < smoothness < math.inf and 0 < noise < math.inf):
        raise ValueError(f"variances must be positive, not {smoothness} and {noise} m²")


def refuse_device(model: CarModel) -> None:
    """Refuse a model on a device: conjugate gradients are a means of comparison, and run on the host."""
    if on_device(model.mean):
        raise ValueError("exact draws are made on the host: move the model there by to_host, or use the method 'gibbs'")


@loop
def _perturb(
    graph: Graph, sites: Int64, smooth: float, fit: float, seed: np.uint64, sweep: np.uint64,
    diagonal: Float64, side: Float64,
) -> None:  # fmt: skip
    """Diagonal of the precision P of x | rest, and a right side of mean P E[x] and covariance P.

    An edge's number is drawn at its lower node, in the stream of its rank among that node's upper neighbours.
    """
    for i in range(side.size):
        data = graph.pixels[i] * fit
        diagonal[i] = data
        site = np.uint64(sites[i] if sites.size else i)
        side[i] = data * graph.mean[i] + math.sqrt(data) * normal(seed, site, sweep, NODE_STREAM)
    before, stream = -1, _FIRST_EDGE_STREAM
    for e in range(graph.edges.shape[0]):
        i, j = graph.edges[e, 0], graph.edges[e, 1]
        stream = stream + 1 if i == before else _FIRST_EDGE_STREAM
        before = i
        site = np.uint64(sites[i] if sites.size else i)
        b = weight_of(graph.weights, e) * smooth
        diagonal[i] += b
        diagonal[j] += b
        part = math.sqrt(b) * normal(seed, site, sweep, np.uint64(stream))
        side[i] += part
        side[j] -= part


@loop
def _multiply(graph: Graph, smooth: float, diagonal: Float64, p: Float64, result: Float64) -> float:
    """Write the product of P and p; return p'Pp."""
    for i in range(p.size):
        result[i] = diagonal[i] * p[i]
    for e in range(graph.edges.shape[0]):
        i, j = graph.edges[e, 0], graph.edges[e, 1]
        b = weight_of(graph.weights, e) * smooth
        result[i] -= b * p[j]
        result[j] -= b * p[i]
    form = 0.0
    for i in range(p.size):
        form += p[i] * result[i]
    return form


@loop
def _solve(
    graph: Graph, smooth: float, diagonal: Float64, side: Float64, x: Float64, p: Float64, product: Float64,
    tolerance: float, limit: int,
) -> int:  # fmt: skip
    """Conjugate gradients with Jacobi's preconditioner from `x` on; `side` becomes the residual.

    Ends when the residual, in units of its own standard deviation, is below `tolerance`; returns the iterations.
    """
    n = x.size
    _multiply(graph, smooth, diagonal, x, product)
    norm = 0.0
    for i in range(n):
        side[i] -= product[i]
        p[i] = side[i] / diagonal[i]
        norm += side[i] * p[i]
    iterations = 0
    while norm > tolerance * tolerance * n and iterations < limit:
        step = norm / _multiply(graph, smooth, diagonal, p, product)
        new = 0.0
        for i in range(n):
            x[i] += step * p[i]
            side[i] -= step * product[i]
            new += side[i] * side[i] / diagonal[i]
        ratio = new / norm
        for i in range(n):
            p[i] = side[i] / diagonal[i] + ratio * p[i]
        norm = new
        iterations += 1
    return iterations


@loop
def measure(graph: Graph, x: Float64) -> tuple[float, float]:
    """Sum w (x_i - x_j)² over the edges, and n (m - x)² over the nodes."""
    roughness = misfit = 0.0
    for e in range(graph.edges.shape[0]):
        d = x[graph.edges[e, 0]] - x[graph.edges[e, 1]]
        roughness += weight_of(graph.weights, e) * d * d
    for i in range(x.size):
        d = x[i] - graph.mean[i]
        misfit += graph.pixels[i] * d * d
    return roughness, misfit


def draw_exactly(
    graph: Graph, sites: Int64, smoothness: float, noise: float, seed: np.uint64, sweep: int, x: Float64,
    tolerance: float, scratch: tuple[Float64, Float64],
) -> None:  # fmt: skip
    """Overwrite x, from where the solver starts, by a draw; see `perturb_and_map`."""
    diagonal, side = scratch
    _perturb(graph, sites, 1 / smoothness, 1 / noise, seed, np.uint64(sweep), diagonal, side)
    p, product = np.empty_like(x), np.empty_like(x)
    iterations = _solve(graph, 1 / smoothness, diagonal, side, x, p, product, tolerance, _SOLVER_LIMIT)
    if iterations == _SOLVER_LIMIT:
        raise ValueError(f"conjugate gradients did not converge in {_SOLVER_LIMIT} iterations: v = {smoothness} m²")


def perturb_and_map(
    model: CarModel,
    smoothness: float,
    noise: float,
    *,
    seed: int = 0,
    sweep: int = 0,
    site_ids: Int64 | None = None,
    solver_tolerance: float = SOLVER_TOLERANCE,
) -> Float64:
    """Draw x given both variances, independently of any other draw (Papandreou & Yuille 2010); on the host only.

    The precision is P = diag(n/s2) + L/v with the graph's Laplacian L.  Noise of covariance P is made of one
    number for each datum and edge, added to the right side, and the system solved by conjugate gradients.

    Parameters
    ----------
    model
        Graph and data.
    smoothness, noise
        v and s2, m².
    seed, sweep, site_ids
        What the numbers are a function of, as for `sample`.
    solver_tolerance
        Root mean square residual, in standard deviations of the noise, at which to stop.

    Returns
    -------
    ndarray of float64, shape (n,)
        One draw, m.

    Raises
    ------
    ValueError
        For variances that are not positive, ids that do not ascend, or if the solver does not converge.

    Examples
    --------
    A region of one pixel lies between two large ones, which it is drawn to; its own 11 m count for little.

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.exact import perturb_and_map
    >>> from tilepipe_kernels.car_model.model import CarModel
    >>> edges = np.array([[0, 1], [1, 2]], np.int32)
    >>> model = CarModel(edges, None, np.array([900.0, 1.0, 900.0]), np.array([6.0, 11.0, 6.2]), np.zeros(3))
    >>> draws = [perturb_and_map(model, smoothness=0.01, noise=1.0, sweep=sweep) for sweep in range(200)]
    >>> np.mean(draws, axis=0).round(1).tolist()
    [6.0, 6.1, 6.2]
    """
    check_variances(smoothness, noise)
    refuse_device(model)
    x = model.mean.copy()
    sites = checked_sites(site_ids, model)
    scratch = np.empty_like(x), np.empty_like(x)
    draw_exactly(model.graph, sites, smoothness, noise, as_seed(seed), sweep, x, solver_tolerance, scratch)
    return x
