"""How much a site of a labelling problem wants to change, and what to: the rules that all optimisers share."""

from __future__ import annotations

import numpy as np

from .compiled import loop, rule
from .hcf import site_rank
from .labelling import Field, Floats, Labelling, Place, Sites

_INFINITY = np.float32(np.inf)
_ONE = np.float32(1)


@loop
def weight_of(weights: Floats, p: Place) -> np.float32:
    """Weight of a pair; no weights stand for 1."""
    return weights[p] if weights.size > 0 else _ONE


@loop
def stability(
    unary: Floats, tables: Floats, down: Field, right: Field, down_weight: Floats, right_weight: Floats,
    labels: Field, stride: int, none: int, p: Place,
) -> tuple[np.float32, np.uint8]:  # fmt: skip
    """Stability G of a site, and the label it would change to: the lowest of those of least energy.

    G is the least energy of the other labels minus that of its own, or minus the difference of the two least
    energies if it is uncommitted (Chou & Brown 1990).  Arrays as in `Labelling`, one by one: a tuple of them would
    be counted as a reference at each call.
    """
    above = tables[down[p - stride], labels[p - stride]]
    before = tables[right[p - 1], labels[p - 1]]
    after = tables[right[p], labels[p + 1]]
    below = tables[down[p], labels[p + stride]]
    w_above, w_before = weight_of(down_weight, p - stride), weight_of(right_weight, p - 1)
    w_after, w_below = weight_of(right_weight, p), weight_of(down_weight, p)
    cost = unary[p]
    own = labels[p]
    best = np.uint8(0)
    least = second = current = _INFINITY
    for label in range(none):
        first = w_above * above[label] + w_before * before[label]
        last = w_after * after[label] + w_below * below[label]
        energy = cost[label] + (first + last)
        if label == own:
            current = energy
        elif energy < least:
            second = least
            least = energy
            best = np.uint8(label)
        elif energy < second:
            second = energy
    return (least - second if own == none else least - current), best


@rule
def rank_of(row: int, column: int, stride: int, p: Place) -> np.uint32:
    """`site_rank` of a site of a frame whose first is at (row, column)."""
    return site_rank(row + p // stride, column + p % stride)


@loop
def cheapest_labels(problem: Labelling, labels: Field) -> None:
    """Give every pixel the label of least unary cost, the lowest of equals."""
    for p in range(labels.size):
        if problem.exists[p]:
            unary = problem.unary[p]
            best = 0
            for label in range(1, unary.size):
                best = label if unary[label] < unary[best] else best
            labels[p] = best


@loop
def wanting_sites(problem: Labelling, labels: Field) -> Sites:
    """Committed sites whose energy another label would lower, ascending."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride, none = problem.stride, unary.shape[1]
    found = np.empty(labels.size, np.int32)
    count = 0
    for p in range(labels.size):
        if problem.exists[p]:
            g, _ = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
            if g < 0:
                found[count] = p
                count += 1
    return found[:count].copy()
