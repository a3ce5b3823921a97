"""Coarser grids of a labelling problem, and the messages that finer ones begin with.

Messages go one site a round; where the data are weak, what decides is far away.  On a grid of blocks of 2 x 2 sites
they go twice as far (Felzenszwalb & Huttenlocher 2006, section 3.3): the energy of a labelling that is constant on
blocks is again of the same form.  Blocks begin at even global rows and columns, so that tiles do not show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.mrf.labels.problem import Field, Floats, Labelling, framed_costs
from tilepipe_kernels.mrf.labels.stability import weight_of

_HALF = np.float32(0.5)

Planes = NDArray[np.float32]


def reach(rounds: int, scales: int) -> int:
    """Pixels that messages go: `rounds` on the pixels, and as many on each of `scales` coarser grids.

    A block stands for all its pixels, whence what is added to the rounds.

    Examples
    --------
    >>> from tilepipe_kernels.mrf.labels.scales import reach
    >>> reach(rounds=8, scales=0), reach(rounds=8, scales=3)
    (8, 127)
    """
    return rounds * (2 ** (scales + 1) - 1) + 2**scales - 1


@loop
def _sum_blocks(fine: Labelling, unary: Floats, exists: NDArray[np.bool_], stride: int, row: int, column: int) -> None:
    """Sum the unary costs of the framed fine sites into the blocks of a frame whose first is at (row, column)."""
    rows = fine.exists.size // fine.stride
    for i in range(1, rows - 1):
        for j in range(1, fine.stride - 1):
            p = i * fine.stride + j
            block = (((fine.row + i) >> 1) - row) * stride + ((fine.column + j) >> 1) - column
            if fine.exists[p]:
                exists[block] = True
                for label in range(unary.shape[1]):
                    unary[block, label] += fine.unary[p, label]


@loop
def _sum_pairs(
    fine: Labelling, kinds: Field, weights: Floats | None, step: int, kind: Field, weight: Floats, stride: int,
    row: int, column: int,
) -> None:  # fmt: skip
    """Sum the weights of the pairs, `step` sites apart, of two blocks; their kind is that of the heaviest, the first.

    `kinds` and `weights` are those of the fine sites, `kind` and `weight` those of the blocks.
    """
    rows, none = fine.exists.size // fine.stride, fine.tables.shape[0] - 1
    heaviest = np.zeros(weight.size, np.float32)
    for i in range(1, rows - 1):
        for j in range(1, fine.stride - 1):
            p = i * fine.stride + j
            last = (fine.column + j if step == 1 else fine.row + i) % 2 == 1
            if last and kinds[p] != none:
                block = (((fine.row + i) >> 1) - row) * stride + ((fine.column + j) >> 1) - column
                w = weight_of(weights, p)
                weight[block] += w
                if kind[block] == none or w > heaviest[block]:
                    kind[block], heaviest[block] = kinds[p], w


def coarser(fine: Labelling) -> Labelling:
    """The problem of blocks of 2 x 2 sites: costs and weights are sums; pairs of several kinds take the heaviest's."""
    rows = fine.exists.size // fine.stride
    row, column = ((fine.row + 1) >> 1) - 1, ((fine.column + 1) >> 1) - 1
    height = ((fine.row + rows - 2) >> 1) - row + 2
    stride = ((fine.column + fine.stride - 2) >> 1) - column + 2
    xp, sites = namespace(fine.exists), height * stride
    forms = device_form(__name__) if on_device(fine.exists) else None
    sum_blocks, sum_pairs = (forms.sum_blocks, forms.sum_pairs) if forms else (_sum_blocks, _sum_pairs)
    unary = framed_costs(height - 2, stride - 2, fine.unary.shape[1], fine.exists).reshape(sites, -1)
    exists = xp.zeros(sites, xp.bool_)
    sum_blocks(fine, unary, exists, stride, row, column)
    kinds, weights = [], []
    for kind, weight, step in ((fine.down, fine.down_weight, fine.stride), (fine.right, fine.right_weight, 1)):
        kinds.append(xp.full(sites, len(fine.tables) - 1, xp.uint8))
        weights.append(xp.zeros(sites, xp.float32))
        sum_pairs(fine, kind, weight, step, kinds[-1], weights[-1], stride, row, column)
    return Labelling(
        unary, fine.tables, kinds[0], kinds[1], weights[0], weights[1], exists, stride, row, column
    )  # fmt: skip


@rule
def handed_down(heard: np.float32) -> np.float32:
    """What a site begins with of what its block hears: half, for a side of a block has two pairs."""
    return _HALF * heard


@loop
def _hand_down(
    problem: Labelling, messages: Planes, shift: int, coarse: Labelling, from_messages: Planes, from_shift: int
) -> None:
    stride, none = problem.stride, problem.tables.shape[0] - 1
    for i in range(1, messages.shape[0] - 1):
        block = ((problem.row + i) >> 1) - coarse.row
        for j in range(1, stride - 1):
            p = i * stride + j
            at = ((problem.column + j) >> 1) - coarse.column + from_shift
            q, m = (j + shift) % 2, (j + shift) // 2
            kinds = (problem.down[p - stride], problem.right[p - 1], problem.right[p], problem.down[p])
            for side in range(4):
                if kinds[side] != none:
                    for label in range(messages.shape[3]):
                        heard = from_messages[block, side, at % 2, label, at // 2]
                        messages[i, side, q, label, m] = handed_down(heard)


def hand_down(
    problem: Labelling, messages: Planes, shift: int, coarse: Labelling, from_messages: Planes, from_shift: int
) -> None:
    """Begin the messages with half of those of the blocks.

    Messages are (rows, 4, 2, K, n): what a site hears from above, left, right and below, parted as in
    `mrf.labels.messages`; a site of column j stands at colour (j + shift) % 2, place (j + shift) // 2.
    """
    form = device_form(__name__).hand_down if on_device(messages) else _hand_down
    form(problem, messages, shift, coarse, from_messages, from_shift)
