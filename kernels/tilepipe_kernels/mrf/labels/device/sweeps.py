"""`mrf.labels.sweeps` on the device: a thread for every site of one colour."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.random import uniform
from tilepipe_kernels.mrf.annealing import boltzmann_factor
from tilepipe_kernels.mrf.labels.device.stability import costs_of, energy_of, stability
from tilepipe_kernels.mrf.labels.problem import Labelling
from tilepipe_kernels.mrf.labels.sweeps import STREAM, first_of_colour, key_of_site

_SWEEPS_BETWEEN_LOOKS = 4
_INFINITY = np.float64(np.inf)


def _sites_of_colour(problem: Labelling) -> tuple[int, int]:
    """Threads for the sites of one colour, and how many of them go through one row."""
    across = (problem.stride - 1) // 2
    return (problem.exists.size // problem.stride - 2) * across, across


@grid
def _update_colour(
    count: int, unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, exists: Any,
    labels: Any, stride: int, row: int, column: int, across: int, colour: int, sweep: int, last: Any,
) -> None:  # fmt: skip
    for thread in range(cuda.grid(1), count, cuda.gridsize(1)):
        i = 1 + thread // across
        j = first_of_colour(row + i, column, colour) + 2 * (thread % across)
        p = i * stride + j
        if j < stride - 1 and exists[p]:
            g, best = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, p)
            if g < 0:
                labels[p] = best
                if last[0] < sweep:
                    cuda.atomic.max(last, 0, sweep)


def iterated_modes(problem: Labelling, labels: Any, cap: int) -> int:
    """See `mrf.labels.sweeps.iterated_modes`; sweeps after the last that changes anything change nothing."""
    last, costs = namespace(labels).zeros(1, np.int64), costs_of(problem)
    count, across = _sites_of_colour(problem)
    frame = problem.stride, problem.row, problem.column
    launched = changed = 0
    while changed == launched < cap:
        for sweep in range(launched + 1, min(launched + _SWEEPS_BETWEEN_LOOKS, cap) + 1):
            for colour in range(2):
                _update_colour(count, *costs, problem.exists, labels, *frame, across, colour, sweep, last)
            launched = sweep
        changed = int(last[0])  # one number, to know when to stop
    return min(changed + 1, cap)


@grid
def _draw_colour(
    count: int, unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, exists: Any,
    labels: Any, stride: int, row: int, column: int, across: int, colour: int, temperature: float, seed: np.uint64,
    sweep: np.uint64,
) -> None:  # fmt: skip
    # energies are computed anew in each pass, for a thread has no room for those of all labels
    for thread in range(cuda.grid(1), count, cuda.gridsize(1)):
        i = 1 + thread // across
        j = first_of_colour(row + i, column, colour) + 2 * (thread % across)
        p = i * stride + j
        if not (j < stride - 1 and exists[p]):
            continue
        u = uniform(seed, np.uint64(key_of_site(row + i, column + j)), sweep, STREAM)
        least = _INFINITY
        for label in range(unary.shape[1]):
            energy = energy_of(unary, tables, down, right, down_weight, right_weight, labels, stride, p, label)
            least = min(least, np.float64(energy))
        total = 0.0
        for label in range(unary.shape[1]):
            energy = energy_of(unary, tables, down, right, down_weight, right_weight, labels, stride, p, label)
            total += boltzmann_factor(np.float64(energy) - least, temperature)
        drawn = -1
        below = 0.0
        while drawn < 0 or (drawn < unary.shape[1] - 1 and below < u * total):
            drawn += 1
            energy = energy_of(unary, tables, down, right, down_weight, right_weight, labels, stride, p, drawn)
            below += boltzmann_factor(np.float64(energy) - least, temperature)
        labels[p] = drawn


def gibbs_sweep(problem: Labelling, labels: Any, temperature: float, seed: np.uint64, sweep: np.uint64) -> None:
    """Draw every site once, colour by colour."""
    costs = costs_of(problem)
    count, across = _sites_of_colour(problem)
    for colour in range(2):
        _draw_colour(
            count, *costs, problem.exists, labels, problem.stride, problem.row, problem.column, across, colour,
            temperature, seed, sweep,
        )  # fmt: skip
