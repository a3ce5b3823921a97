"""Sweeps over a labelling problem in two colour classes: iterated conditional modes and Gibbs sampling.

Sites of one colour of the global checkerboard are never adjacent, so their order within a class cannot show.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .compiled import loop
from .label_stability import stability, weight_of
from .labelling import Field, Floats, Labelling
from .random import uniform

_ROW_BITS = np.uint64(32)
_STREAM = np.uint64(0)


@loop
def icm_sweep(problem: Labelling, labels: Field) -> int:
    """Give every site, colour by colour, its label of least energy (Besag 1986); return the number of changes.

    A site keeps its label among equals.
    """
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride, none = problem.stride, unary.shape[1]
    changes = 0
    rows = labels.size // stride
    for colour in range(2):
        for i in range(1, rows - 1):
            first = 1 + (problem.row + i + problem.column + 1 + colour) % 2
            for p in range(i * stride + first, i * stride + stride - 1, 2):
                if problem.exists[p]:
                    g, best = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
                    if g < 0:
                        labels[p] = best
                        changes += 1
    return changes


@loop
def _draw(
    unary: Floats, tables: Floats, down: Field, right: Field, down_weight: Floats, right_weight: Floats,
    labels: Field, stride: int, p: int, temperature: float, u: float, energies: NDArray[np.float64],
) -> np.uint8:  # fmt: skip
    """Label drawn from the local conditional distribution at a temperature, by inversion."""
    above = tables[down[p - stride], labels[p - stride]]
    before = tables[right[p - 1], labels[p - 1]]
    after = tables[right[p], labels[p + 1]]
    below = tables[down[p], labels[p + stride]]
    w_above, w_before = weight_of(down_weight, p - stride), weight_of(right_weight, p - 1)
    w_after, w_below = weight_of(right_weight, p), weight_of(down_weight, p)
    cost = unary[p]
    least = np.inf
    for label in range(cost.size):
        first = w_above * above[label] + w_before * before[label]
        last = w_after * after[label] + w_below * below[label]
        energies[label] = cost[label] + (first + last)
        least = min(least, energies[label])
    total = 0.0
    for label in range(cost.size):
        total += math.exp((least - energies[label]) / temperature)
        energies[label] = total
    drawn = 0
    while drawn < cost.size - 1 and energies[drawn] < u * total:
        drawn += 1
    return np.uint8(drawn)


@loop
def gibbs_sweep(problem: Labelling, labels: Field, temperature: float, seed: np.uint64, sweep: np.uint64) -> None:
    """Draw every site, colour by colour, from its local conditional distribution (Geman & Geman 1984)."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride = problem.stride
    rows = labels.size // stride
    energies = np.empty(problem.unary.shape[1], np.float64)
    for colour in range(2):
        for i in range(1, rows - 1):
            first = 1 + (problem.row + i + problem.column + 1 + colour) % 2
            row = np.uint64(problem.row + i) << _ROW_BITS
            for p in range(i * stride + first, i * stride + stride - 1, 2):
                if problem.exists[p]:
                    site = row | np.uint64(problem.column + p - i * stride)
                    u = uniform(seed, site, sweep, _STREAM)
                    labels[p] = _draw(
                        unary, tables, down, right, down_weight, right_weight, labels, stride, p, temperature, u,
                        energies,
                    )  # fmt: skip
