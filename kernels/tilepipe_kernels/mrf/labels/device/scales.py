"""`mrf.labels.scales` on the device: a thread for every block sums its sites, for every site takes from its block."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.labels.device.stability import weight_at
from tilepipe_kernels.mrf.labels.problem import Labelling
from tilepipe_kernels.mrf.labels.scales import handed_down


@grid
def _sum_blocks(
    count: int, fine: Any, has_data: Any, fine_stride: int, fine_row: int, fine_column: int, costs: Any, exists: Any,
    stride: int, row: int, column: int,
) -> None:  # fmt: skip
    for block in range(cuda.grid(1), count, cuda.gridsize(1)):
        top, left = 2 * (row + block // stride) - fine_row, 2 * (column + block % stride) - fine_column
        for site in range(4):
            i, j = top + site // 2, left + site % 2
            p = i * fine_stride + j
            if i > 0 and 0 < j < fine_stride - 1 and p < has_data.size and has_data[p]:
                exists[block] = True
                for label in range(costs.shape[0]):
                    costs[label, block] += fine[label, p]


def sum_blocks(fine: Labelling, unary: Any, exists: Any, stride: int, row: int, column: int) -> None:
    """See `mrf.labels.scales.coarser`."""
    costs = namespace(exists).ascontiguousarray(fine.unary.T)
    place = fine.stride, fine.row, fine.column
    _sum_blocks(exists.size, costs, fine.exists, *place, unary.T, exists, stride, row, column)


@grid
def _sum_pairs(
    count: int, kinds: Any, weights: Any, none: int, fine_stride: int, fine_row: int, fine_column: int, across: bool,
    kind: Any, weight: Any, stride: int, row: int, column: int,
) -> None:  # fmt: skip
    for block in range(cuda.grid(1), count, cuda.gridsize(1)):
        top, left = 2 * (row + block // stride) - fine_row, 2 * (column + block % stride) - fine_column
        heaviest = weight[block]
        for side in range(2):
            i, j = (top + side, left + 1) if across else (top + 1, left + side)
            p = i * fine_stride + j
            if i > 0 and 0 < j < fine_stride - 1 and p < kinds.size and kinds[p] != none:
                w = weight_at(weights, p)
                weight[block] += w
                if kind[block] == none or w > heaviest:
                    kind[block], heaviest = kinds[p], w


def sum_pairs(
    fine: Labelling, kinds: Any, weights: Any, step: int, kind: Any, weight: Any, stride: int, row: int, column: int
) -> None:
    """See `mrf.labels.scales.coarser`; `kind` and `weight` are none and 0 at first."""
    weights = namespace(kinds).ones(1, np.float32) if weights is None else weights
    place = fine.stride, fine.row, fine.column
    none = len(fine.tables) - 1
    _sum_pairs(kind.size, kinds, weights, none, *place, step == 1, kind, weight, stride, row, column)


@grid
def _hand_down(
    count: int, messages: Any, from_messages: Any, down: Any, right: Any, none: int, stride: int, shift: int, row: int,
    column: int, from_row: int, from_column: int, from_shift: int,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // stride, p % stride
        if not (0 < i < messages.shape[0] - 1 and 0 < j < stride - 1):
            continue
        block, at = ((row + i) >> 1) - from_row, ((column + j) >> 1) - from_column + from_shift
        q, m = (j + shift) % 2, (j + shift) // 2
        for side in range(4):
            kind = (down[p - stride], right[p - 1], right[p], down[p])[side]
            if kind != none:
                for label in range(messages.shape[3]):
                    heard = from_messages[block, side, at % 2, label, at // 2]
                    messages[i, side, q, label, m] = handed_down(heard)


def hand_down(
    problem: Labelling, messages: Any, shift: int, coarse: Labelling, from_messages: Any, from_shift: int
) -> None:
    """See `mrf.labels.scales.hand_down`."""
    _hand_down(
        problem.exists.size, messages, from_messages, problem.down, problem.right, len(problem.tables) - 1,
        problem.stride, shift, problem.row, problem.column, coarse.row, coarse.column, from_shift,
    )  # fmt: skip
