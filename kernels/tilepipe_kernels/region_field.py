"""Binary Markov random field on a region graph (Ising model): marginal probabilities by Gibbs sampling.

Besag 1986, "On the statistical analysis of dirty pictures", JRSS B 48, section 2.3; Geman & Geman 1984, IEEE PAMI 6.
The probabilities are means of conditional ones instead of counts (Gelfand & Smith 1990, JASA 85, section 2.3), which
takes fewer draws.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .random import as_seed, uniform

_STREAM = np.uint64(1 << 30)
"""Stream of the random numbers: none of the sampler of heights."""

Floats = NDArray[np.float64]


@rule
def probability_of(evidence: float) -> float:
    """Probability whose log-odds is ``evidence``, without overflow."""
    if evidence >= 0.0:
        return 1.0 / (1.0 + math.exp(-evidence))
    odds = math.exp(evidence)
    return odds / (1.0 + odds)


@loop
def _sample(
    offsets: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    coupling: Floats,
    evidence: Floats,
    sites: NDArray[np.int64],
    seed: np.uint64,
    burn_in: int,
    draws: int,
) -> Floats:
    """Sweep the sites in their order: each is drawn given its neighbours as they are, classes being 1 and -1."""
    state, total = np.where(evidence > 0.0, 1.0, -1.0), np.zeros(evidence.size)
    for sweep in range(burn_in + draws):
        for i in range(evidence.size):
            odds = evidence[i]
            for k in range(offsets[i], offsets[i + 1]):
                odds += coupling[k] * state[neighbours[k]]
            chance = probability_of(odds)
            state[i] = 1.0 if uniform(seed, np.uint64(sites[i]), np.uint64(sweep), _STREAM) < chance else -1.0
            if sweep >= burn_in:
                total[i] += chance
    return total / draws


@loop
def _by_node(
    edges: NDArray[np.int32], coupling: Floats, nodes: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], Floats]:
    """Both ways of every edge by node: its bounds, the other ends and their couplings."""
    bounds = np.zeros(nodes + 1, np.int64)
    for edge in range(edges.shape[0]):
        for side in range(2):
            bounds[edges[edge, side] + 1] += 1
    for node in range(nodes):
        bounds[node + 1] += bounds[node]
    place = bounds[:-1].copy()
    ends, strength = np.empty(2 * edges.shape[0], np.int32), np.empty(2 * edges.shape[0], np.float64)
    for edge in range(edges.shape[0]):
        for side in range(2):
            at = place[edges[edge, side]]
            ends[at], strength[at] = edges[edge, 1 - side], coupling[edge]
            place[edges[edge, side]] += 1
    return bounds, ends, strength


def field_marginals(
    edges: NDArray[np.int32],
    coupling: NDArray[Any],
    evidence: NDArray[Any],
    *,
    sites: NDArray[np.int64] | None = None,
    burn_in: int = 50,
    draws: int = 200,
    seed: int = 0,
) -> NDArray[np.float64]:
    """Probability of class 1 at each node, given the evidence at all of them.

    Parameters
    ----------
    edges
        Pairs of neighbours, int32 (m, 2), each once.
    coupling
        Of each edge, ≥ 0: two neighbours have one class exp(coupling) times more likely than without the edge.
    evidence
        Log-odds of class 1 at each node by itself, shape (n,), finite.
    sites
        Names of the nodes for their random numbers, int64 (n,); their places by default.
    burn_in, draws
        Sweeps before the first draw, and draws.
    seed
        Of the random numbers.

    Returns
    -------
    ndarray of float64, shape (n,)
        Depends on the order of the nodes and edges, not on threads; nodes without neighbours get their own
        probability exactly.

    Raises
    ------
    ValueError
        For shapes that do not fit, couplings or evidence out of range.
    """
    evidence = np.ascontiguousarray(evidence, np.float64)
    coupling = np.ascontiguousarray(coupling, np.float64)
    edges = np.ascontiguousarray(edges, np.int32)
    if edges.shape != (coupling.size, 2) or evidence.ndim != 1:
        raise ValueError(f"edges must be (m, 2) for couplings (m,), not {edges.shape} and {coupling.shape}")
    if edges.size and not (edges.min() >= 0 and edges.max() < evidence.size):
        raise ValueError(f"edges must join nodes 0..{evidence.size - 1}")
    if not (np.isfinite(evidence).all() and np.isfinite(coupling).all() and (coupling >= 0).all()):
        raise ValueError("evidence must be finite and couplings finite and 0 or more")
    if draws < 1 or burn_in < 0:
        raise ValueError(f"draws must be 1 or more and burn_in 0 or more, not {draws} and {burn_in}")
    names = np.arange(evidence.size, dtype=np.int64) if sites is None else np.ascontiguousarray(sites, np.int64)
    by_node = _by_node(edges, coupling, evidence.size)
    return _sample(*by_node, evidence, names, as_seed(seed), burn_in, draws)
