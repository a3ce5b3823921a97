"""Binary Markov random field on a region graph (Ising model): marginal probabilities by Gibbs sampling.

Besag 1986, "On the statistical analysis of dirty pictures", JRSS B 48, section 2.3; Geman & Geman 1984, IEEE PAMI 6.
The probabilities are means of conditional ones instead of counts (Gelfand & Smith 1990, JASA 85, section 2.3), which
takes fewer draws.

Nodes are drawn by colour classes: those of one class do not depend on each other, so that a device draws them at once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.random import as_seed, uniform
from tilepipe_kernels.regions.colouring import Rows, colour_graph, in_order, order_by_colour, rows_in_order

STREAM = np.uint64(1 << 30)
"""Stream of the random numbers: none of the sampler of heights."""

Floats = NDArray[np.float64]


@rule
def probability_of(evidence: float) -> float:
    """Probability whose log-odds is ``evidence``, without overflow."""
    if evidence >= 0.0:
        return 1.0 / (1.0 + math.exp(-evidence))
    odds = math.exp(evidence)
    return odds / (1.0 + odds)


@rule
def first_class(evidence: float) -> float:
    """Class that a node starts in."""
    return 1.0 if evidence > 0.0 else -1.0


@rule
def odds_of_neighbour(coupling: float, state: float) -> float:
    """Log-odds of class 1 that a neighbour of class ``state``, 1 or -1, speaks for."""
    return coupling * state


@rule
def draw_class(odds: float, number: float) -> tuple[float, float]:
    """Class 1 or -1 of a node by its log-odds and a uniform number, and the probability of class 1."""
    chance = probability_of(odds)
    return 1.0 if number < chance else -1.0, chance


@loop
def _sample(
    rows: Rows, evidence: Floats, sites: NDArray[np.int64], seed: np.uint64, burn_in: int, draws: int
) -> Floats:
    """Sum the chances of class 1 over the draws; all arrays stand in the order of the rows, hence of their classes."""
    state, total = np.empty(evidence.size), np.zeros(evidence.size)
    for row in range(evidence.size):
        state[row] = first_class(evidence[row])
    for sweep in range(burn_in + draws):
        for row in range(evidence.size):
            odds = evidence[row]
            for k in range(rows.offsets[row], rows.offsets[row + 1]):
                odds += odds_of_neighbour(rows.weights[k], state[rows.neighbours[k]])
            number = uniform(seed, np.uint64(sites[row]), np.uint64(sweep), STREAM)
            state[row], chance = draw_class(odds, number)
            if sweep >= burn_in:
                total[row] += chance
    return total


def _sorted(edges: NDArray[np.int32], coupling: Floats, nodes: int) -> tuple[NDArray[np.int32], Floats]:
    """Edges from lower to upper node and sorted, as colours want them, and their couplings."""
    if in_order(edges, nodes):
        return edges, coupling
    xp = namespace(edges)
    low, high = edges.min(axis=1), edges.max(axis=1)
    order = xp.lexsort(xp.stack((high, low)))
    return xp.stack((low[order], high[order]), axis=1), coupling[order]


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
        probability exactly.  Arrays of a device stay there; exponentials differ in the last bits, and with them
        the marginals by 1e-12 or less.

    Raises
    ------
    ValueError
        For shapes that do not fit, couplings or evidence out of range.

    Examples
    --------
    Three regions in a row: the middle one knows nothing by itself, and follows its neighbours.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.ising import field_marginals
    >>> edges, evidence = np.array([[0, 1], [1, 2]], np.int32), np.array([3.0, 0.0, 3.0])
    >>> alone = field_marginals(edges, np.zeros(2), evidence)
    >>> beside = field_marginals(edges, np.full(2, 2.0), evidence)
    >>> round(float(alone[1]), 1), bool(beside[1] > 0.9)
    (0.5, True)
    """
    xp = namespace(edges, coupling, evidence, sites)
    evidence = xp.ascontiguousarray(evidence, xp.float64)
    coupling = xp.ascontiguousarray(coupling, xp.float64)
    edges = xp.ascontiguousarray(edges, xp.int32)
    if edges.shape != (coupling.size, 2) or evidence.ndim != 1:
        raise ValueError(f"edges must be (m, 2) for couplings (m,), not {edges.shape} and {coupling.shape}")
    if edges.size and not (edges.min() >= 0 and edges.max() < evidence.size):
        raise ValueError(f"edges must join nodes 0..{evidence.size - 1}")
    if not (xp.isfinite(evidence).all() and xp.isfinite(coupling).all() and (coupling >= 0).all()):
        raise ValueError("evidence must be finite and couplings finite and 0 or more")
    if draws < 1 or burn_in < 0:
        raise ValueError(f"draws must be 1 or more and burn_in 0 or more, not {draws} and {burn_in}")
    names = xp.arange(evidence.size, dtype=xp.int64) if sites is None else xp.ascontiguousarray(sites, xp.int64)
    edges, coupling = _sorted(edges, coupling, evidence.size)
    order, bounds = order_by_colour(colour_graph(edges, evidence.size))
    rows, by_row, names = rows_in_order(edges, coupling, order), evidence[order], names[order]
    if on_device(evidence):
        device = device_form(__name__)
        total = device.sample(rows, bounds, by_row, names, as_seed(seed), burn_in, draws)
    else:
        total = _sample(rows, by_row, names, as_seed(seed), burn_in, draws)
    marginals: NDArray[np.float64] = xp.empty_like(total)
    marginals[order] = total / draws
    return marginals
