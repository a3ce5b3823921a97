"""Sweeps over a labelling problem in two colour classes: iterated conditional modes and Gibbs sampling.

Sites of one colour of the global checkerboard are never adjacent, so their order within a class cannot show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.random import as_seed, uniform
from tilepipe_kernels.mrf.annealing import Annealing, boltzmann_factor
from tilepipe_kernels.mrf.labels.problem import Field, Floats, Labelling
from tilepipe_kernels.mrf.labels.stability import site_energy, stability, weight_of

_ROW_BITS = np.uint64(32)
STREAM = np.uint64(0)
"""Of the random numbers that draw labels."""


@rule
def first_of_colour(row: int, column: int, colour: int) -> int:
    """First column of a framed row, after its frame at (row, column), whose sites have a colour, 0 or 1."""
    return 1 + (row + column + 1 + colour) % 2


@rule
def key_of_site(row: int, column: int) -> np.uint64:
    """What tells a site's random numbers from those of others."""
    return np.uint64(row) << _ROW_BITS | np.uint64(column)


@loop
def _icm_sweep(problem: Labelling, labels: Field) -> int:
    """Give every site, colour by colour, its label of least energy; return the number of changes."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride, none = problem.stride, unary.shape[1]
    changes = 0
    rows = labels.size // stride
    for colour in range(2):
        for i in range(1, rows - 1):
            first = first_of_colour(problem.row + i, problem.column, colour)
            for p in range(i * stride + first, i * stride + stride - 1, 2):
                if problem.exists[p]:
                    g, best = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
                    if g < 0:
                        labels[p] = best
                        changes += 1
    return changes


def iterated_modes(problem: Labelling, labels: Field, cap: int) -> int:
    """Give every site, colour by colour, its label of least energy until none changes (Besag 1986), in place.

    A site keeps its label among equals.  Returns the number of sweeps, the last of which changed nothing, or `cap`.
    """
    if on_device(labels):
        return int(device_form(__name__).iterated_modes(problem, labels, cap))
    for sweep in range(1, cap + 1):
        if _icm_sweep(problem, labels) == 0:
            return sweep
    return cap


@loop
def _draw(
    unary: Floats, tables: Floats, down: Field, right: Field, down_weight: Floats | None, right_weight: Floats | None,
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
        first, second = w_above * above[label], w_before * before[label]
        third, last = w_after * after[label], w_below * below[label]
        energies[label] = site_energy(cost[label], first, second, third, last)
        least = min(least, energies[label])
    total = 0.0
    for label in range(cost.size):
        total += boltzmann_factor(energies[label] - least, temperature)
        energies[label] = total
    drawn = 0
    while drawn < cost.size - 1 and energies[drawn] < u * total:
        drawn += 1
    return np.uint8(drawn)


@loop
def _gibbs_sweep(problem: Labelling, labels: Field, temperature: float, seed: np.uint64, sweep: np.uint64) -> None:
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride = problem.stride
    rows = labels.size // stride
    energies = np.empty(problem.unary.shape[1], np.float64)
    for colour in range(2):
        for i in range(1, rows - 1):
            first = first_of_colour(problem.row + i, problem.column, colour)
            for p in range(i * stride + first, i * stride + stride - 1, 2):
                if problem.exists[p]:
                    key = key_of_site(problem.row + i, problem.column + p - i * stride)
                    u = uniform(seed, key, sweep, STREAM)
                    labels[p] = _draw(
                        unary, tables, down, right, down_weight, right_weight, labels, stride, p, temperature, u,
                        energies,
                    )  # fmt: skip


def anneal(problem: Labelling, labels: Field, schedule: Annealing) -> None:
    """Draw every site, colour by colour, from its local conditional distribution (Geman & Geman 1984), in place."""
    draw = device_form(__name__).gibbs_sweep if on_device(labels) else _gibbs_sweep
    seed = as_seed(schedule.seed)
    for sweep, temperature in enumerate(schedule.temperatures()):
        draw(problem, labels, float(temperature), seed, np.uint64(sweep))
