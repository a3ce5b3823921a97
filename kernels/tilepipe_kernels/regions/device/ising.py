"""`regions.ising` on the device: classes of colours, a thread for each of their nodes."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.random import uniform
from tilepipe_kernels.regions.colouring import Rows
from tilepipe_kernels.regions.ising import STREAM, draw_class, first_class, odds_of_neighbour


@grid
def _start(count: int, evidence: Any, state: Any) -> None:
    for row in range(cuda.grid(1), count, cuda.gridsize(1)):
        state[row] = first_class(evidence[row])


@grid
def _update(
    count: int, first: int, offsets: Any, neighbours: Any, coupling: Any, evidence: Any, sites: Any,
    seed: np.uint64, sweep: np.uint64, counts: bool, state: Any, total: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        row = first + p
        odds = evidence[row]
        for k in range(offsets[row], offsets[row + 1]):
            odds += odds_of_neighbour(coupling[k], state[neighbours[k]])
        state[row], chance = draw_class(odds, uniform(seed, np.uint64(sites[row]), sweep, STREAM))
        if counts:
            total[row] += chance


def sample(rows: Rows, bounds: Any, evidence: Any, sites: Any, seed: np.uint64, burn_in: int, draws: int) -> Any:
    """Sums of the chances of class 1 over the draws, as of `regions.ising`; nothing of it is read by the host."""
    xp = namespace(evidence)
    state, total = xp.empty_like(evidence), xp.zeros_like(evidence)
    _start(evidence.size, evidence, state)
    for sweep in range(burn_in + draws):
        for first, last in itertools.pairwise(bounds.tolist()):
            _update(
                last - first, first, rows.offsets, rows.neighbours, rows.weights, evidence, sites, seed,
                np.uint64(sweep), sweep >= burn_in, state, total,
            )  # fmt: skip
    return total
