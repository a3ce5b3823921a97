"""`mrf.labels.hcf` on the device: in a round, all sites look at their wishes and those that come first change.

What a round changes depends on the labels before it alone, so that rounds without a list of the sites that want to
change give what those with one do; rounds after the last that changes anything change nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.hcf import comes_before, site_rank
from tilepipe_kernels.mrf.labels.device.stability import costs_of, find_stabilities
from tilepipe_kernels.mrf.labels.problem import Labelling

_INFINITY = np.float32(np.inf)

ROUNDS_BETWEEN_LOOKS = 4
"""Rounds that are launched before the host looks whether any of them changed anything."""


@grid
def _change_first(
    count: int, labels: Any, stabilities: Any, best: Any, stride: int, row: int, column: int, turn: int, last: Any
) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        g = stabilities[p]
        if not g < _INFINITY:
            continue
        i = p // stride
        at_row, at_column = row + i, column + (p - i * stride)
        rank = site_rank(at_row, at_column)
        if (
            comes_before(g, rank, stabilities[p - stride], site_rank(at_row - 1, at_column))
            and comes_before(g, rank, stabilities[p - 1], site_rank(at_row, at_column - 1))
            and comes_before(g, rank, stabilities[p + 1], site_rank(at_row, at_column + 1))
            and comes_before(g, rank, stabilities[p + stride], site_rank(at_row + 1, at_column))
        ):
            labels[p] = best[p]
            if last[0] < turn:
                cuda.atomic.max(last, 0, turn)


def parallel_rounds(problem: Labelling, labels: Any, cap: int) -> tuple[int, Any]:
    """See `mrf.labels.hcf.parallel_rounds`."""
    xp = namespace(labels)
    stabilities, best = xp.empty(labels.size, xp.float32), xp.zeros(labels.size, xp.uint8)
    last, costs = xp.zeros(1, xp.int64), costs_of(problem)
    find_stabilities(problem, costs, labels, stabilities, best)
    launched = rounds = 0
    while rounds == launched < cap:
        for turn in range(launched + 1, min(launched + ROUNDS_BETWEEN_LOOKS, cap) + 1):
            _change_first(
                labels.size, labels, stabilities, best, problem.stride, problem.row, problem.column, turn, last
            )  # fmt: skip
            find_stabilities(problem, costs, labels, stabilities, best)
            launched = turn
        rounds = int(last[0])  # one number, to know when to stop
    wanting = stabilities < _INFINITY
    labels[...] = xp.where(wanting & (labels == problem.unary.shape[1]), best, labels)
    return rounds, xp.flatnonzero(wanting)
