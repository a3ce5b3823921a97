"""`label_stability` on the device: the energy of a label, and what a site makes of them all."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.labels.problem import Labelling
from tilepipe_kernels.mrf.labels.stability import UNDECIDED, gain_of, site_energy, wish, with_label

_INFINITY = np.float32(np.inf)

Arrays = tuple[Any, ...]


def costs_of(problem: Labelling) -> Arrays:
    """The arrays of a problem that the energy of a label needs; where all weights are 1, they have one entry."""
    one = namespace(problem.unary).ones(1, np.float32)
    weights = (one if weight is None else weight for weight in (problem.down_weight, problem.right_weight))
    return (problem.unary, problem.tables, problem.down, problem.right, *weights)


@cuda.jit(device=True)
def weight_at(weights: Any, p: int) -> np.float32:
    """Weight of a pair."""
    return weights[p if weights.size > 1 else 0]


@cuda.jit(device=True)
def energy_of(
    unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, labels: Any, stride: int,
    p: int, label: int,
) -> np.float32:  # fmt: skip
    """Energy of a label of a site, given those of its neighbours."""
    above = weight_at(down_weight, p - stride) * tables[down[p - stride], labels[p - stride], label]
    before = weight_at(right_weight, p - 1) * tables[right[p - 1], labels[p - 1], label]
    after = weight_at(right_weight, p) * tables[right[p], labels[p + 1], label]
    below = weight_at(down_weight, p) * tables[down[p], labels[p + stride], label]
    return site_energy(unary[p, label], above, before, after, below)


@cuda.jit(device=True)
def stability(
    unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, labels: Any, stride: int,
    p: int,
) -> tuple[np.float32, np.uint8]:  # fmt: skip
    """See `mrf.labels.stability.stability`."""
    own = labels[p]
    choice = UNDECIDED
    for label in range(unary.shape[1]):
        energy = energy_of(unary, tables, down, right, down_weight, right_weight, labels, stride, p, label)
        choice = with_label(choice, label, own, energy)
    return gain_of(choice, own < unary.shape[1]), choice[3]


@grid
def _find_stabilities(
    count: int, unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, exists: Any,
    labels: Any, stride: int, stabilities: Any, best: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        stabilities[p] = _INFINITY
        if exists[p]:
            g, label = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, p)
            stabilities[p] = wish(g, labels[p] < unary.shape[1])
            best[p] = label


def find_stabilities(problem: Labelling, costs: Arrays, labels: Any, stabilities: Any, best: Any) -> None:
    """Write the stability of all sites that want to change, and what to; it is infinite for the others."""
    _find_stabilities(labels.size, *costs, problem.exists, labels, problem.stride, stabilities, best)


def wanting_sites(problem: Labelling, labels: Any) -> Any:
    """See `mrf.labels.stability.wanting_sites`; labels are committed."""
    xp = namespace(labels)
    stabilities, best = xp.empty(labels.size, xp.float32), xp.zeros(labels.size, xp.uint8)
    find_stabilities(problem, costs_of(problem), labels, stabilities, best)
    return xp.flatnonzero(stabilities < _INFINITY)


@grid
def _take_cheapest(count: int, unary: Any, exists: Any, labels: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if exists[p]:
            best = 0
            for label in range(1, unary.shape[1]):
                best = label if unary[p, label] < unary[p, best] else best
            labels[p] = best


def take_cheapest(problem: Labelling, labels: Any) -> None:
    """See `mrf.labels.stability.cheapest_labels`."""
    _take_cheapest(labels.size, problem.unary, problem.exists, labels)
