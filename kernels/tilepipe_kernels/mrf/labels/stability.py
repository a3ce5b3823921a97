"""How much a site of a labelling problem wants to change, and what to: the rules that all optimisers share."""

from __future__ import annotations

import numpy as np

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.mrf.hcf import site_rank
from tilepipe_kernels.mrf.labels.problem import Field, Floats, Labelling, Place, Sites

_INFINITY = np.float32(np.inf)
_ONE = np.float32(1)

Choice = tuple[np.float32, np.float32, np.float32, np.uint8]

UNDECIDED: Choice = (_INFINITY, _INFINITY, _INFINITY, np.uint8(0))
"""What is known of a site's labels before the first is looked at, see `with_label`."""


@rule
def site_energy(
    cost: np.float32, above: np.float32, before: np.float32, after: np.float32, below: np.float32
) -> np.float32:
    """Energy of a label of a site: its own cost, and those of its four pairs."""
    return cost + ((above + before) + (after + below))


@rule
def with_label(choice: Choice, label: int, own: np.uint8, energy: np.float32) -> Choice:
    """What is known of a site's labels, once the energy of the next label is.

    It is the two least energies of the other labels, the energy of its own, and the other label of least energy, the
    lowest of equals.
    """
    least, second, current, best = choice
    other = _INFINITY if label == own else energy
    current = energy if label == own else current
    second = min(second, max(least, other))
    best = np.uint8(label) if other < least else best
    least = min(least, other)
    return least, second, current, best


@rule
def gain_of(choice: Choice, committed: bool) -> np.float32:
    """Stability G: the least energy of the other labels minus its own, or the next least if it is uncommitted."""
    return choice[0] - (choice[2] if committed else choice[1])


@rule
def wish(g: np.float32, committed: bool) -> np.float32:
    """Stability of a site that wants to change, infinite where it does not: nobody waits for it."""
    return g if g < 0 or not committed else _INFINITY


@loop
def weight_of(weights: Floats | None, p: Place) -> np.float32:
    """Weight of a pair; None stands for 1, and is compiled to no multiplication at all."""
    if weights is None:
        return _ONE
    return weights[p]


@loop
def stability(
    unary: Floats, tables: Floats, down: Field, right: Field, down_weight: Floats | None, right_weight: Floats | None,
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
    cost = unary[p]
    own = labels[p]
    w_above, w_before = weight_of(down_weight, p - stride), weight_of(right_weight, p - 1)
    w_after, w_below = weight_of(right_weight, p), weight_of(down_weight, p)
    choice = UNDECIDED
    for label in range(none):
        first, second = w_above * above[label], w_before * before[label]
        third, last = w_after * after[label], w_below * below[label]
        choice = with_label(choice, label, own, site_energy(cost[label], first, second, third, last))
    return gain_of(choice, own != none), choice[3]


@rule
def rank_of(row: int, column: int, stride: int, p: Place) -> np.uint32:
    """`site_rank` of a site of a frame whose first is at (row, column)."""
    return site_rank(row + p // stride, column + p % stride)


@loop
def _take_cheapest(problem: Labelling, labels: Field) -> None:
    for p in range(labels.size):
        if problem.exists[p]:
            unary = problem.unary[p]
            best = 0
            for label in range(1, unary.size):
                best = label if unary[label] < unary[best] else best
            labels[p] = best


def cheapest_labels(problem: Labelling, labels: Field) -> None:
    """Give every pixel the label of least unary cost, the lowest of equals."""
    take = device_form(__name__).take_cheapest if on_device(labels) else _take_cheapest
    take(problem, labels)


@loop
def _wanting_sites(problem: Labelling, labels: Field) -> Sites:
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


def wanting_sites(problem: Labelling, labels: Field) -> Sites:
    """Committed sites whose energy another label would lower, ascending."""
    find = device_form(__name__).wanting_sites if on_device(labels) else _wanting_sites
    sites: Sites = find(problem, labels)
    return sites
