"""Rounds of parallel HCF over whole rows, for up to four labels and one table, no weights (see `mrf.labels.hcf`).

At first nearly every site wants to change, and a pass over rows that vectorises beats a list.  Costs and energies lie
in one plane for each label; energies are summed in the order of `mrf.labels.stability.stability`, so that both give the
same bits.  The loops are over few arrays each, or LLVM would not vectorise them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.mrf.hcf import comes_before, site_rank
from tilepipe_kernels.mrf.labels.problem import Field, Floats

DENSE_LABELS = 4
"""Most labels that the rows are made for."""

_INFINITY = np.float32(np.inf)
_NOTHING = np.float32(0)
_L0, _L1, _L2, _L3 = (np.uint8(label) for label in range(DENSE_LABELS))

Ranks = NDArray[np.uint32]
Planes = NDArray[np.float32]


@rule
def _lower(a: np.float32, b: np.float32) -> np.float32:
    return a if a < b else b


@rule
def _higher(a: np.float32, b: np.float32) -> np.float32:
    return b if a < b else a


@loop
def cost_planes(unary: Floats, planes: Planes) -> None:
    """Write unary costs (sites, K) as planes (K, sites)."""
    for label in range(unary.shape[1]):
        plane = planes[label]
        for p in range(plane.size):
            plane[p] = unary[p, label]


@loop
def _pair_costs(costs: Floats, labels: Field, table: Floats) -> None:
    """What each site of a row costs a neighbour of one label; table has the cost for 0, 1, 2, 3."""
    v0, v1, v2, v3 = table[0], table[1], table[2], table[3]
    for n in range(costs.size):
        low = v0 if labels[n] == _L0 else (v1 if labels[n] == _L1 else _NOTHING)
        costs[n] = v2 if labels[n] == _L2 else (v3 if labels[n] == _L3 else low)


@loop
def _energies(energies: Floats, unary: Floats, above: Floats, here: Floats, below: Floats) -> None:
    """Energy of one label along a row; `here` with its frame."""
    for n in range(energies.size):
        energies[n] = unary[n] + ((above[n] + here[n]) + (here[n + 2] + below[n]))


@loop
def _stabilities(
    stabilities: Floats, labels: Field, first: Floats, second: Floats, third: Floats, fourth: Floats, none: np.uint8
) -> None:
    """Stability of the sites of a row that want to change, infinite for the others; label 255 = no site."""
    for n in range(stabilities.size):
        own = labels[n]
        e0, e1, e2, e3 = first[n], second[n], third[n], fourth[n]
        a, b = _INFINITY if own == _L0 else e0, _INFINITY if own == _L1 else e1
        c, d = _INFINITY if own == _L2 else e2, _INFINITY if own == _L3 else e3
        low, high = e0 if own == _L0 else e1, e2 if own == _L2 else e3
        current = low if own < _L2 else high
        ab, cd = _lower(a, b), _lower(c, d)
        next_least = _lower(_higher(ab, cd), _lower(_higher(a, b), _higher(c, d)))
        g = _lower(ab, cd) - (next_least if own == none else current)
        wants = (own == none) | ((own < none) & (g < _NOTHING))
        stabilities[n] = g if wants else _INFINITY


@loop
def _choices(best: Field, labels: Field, first: Floats, second: Floats, third: Floats, fourth: Floats) -> None:
    """The other label of least energy, the lowest of equals, of the sites of a row."""
    for n in range(best.size):
        own = labels[n]
        a, b = _INFINITY if own == _L0 else first[n], _INFINITY if own == _L1 else second[n]
        c, d = _INFINITY if own == _L2 else third[n], _INFINITY if own == _L3 else fourth[n]
        low, high = _L1 if b < a else _L0, _L3 if d < c else _L2
        best[n] = low if _lower(a, b) <= _lower(c, d) else high


@loop
def _stabilities_of_two(stabilities: Floats, labels: Field, first: Floats, second: Floats) -> None:
    """As `_stabilities`, for two labels."""
    for n in range(stabilities.size):
        own = labels[n]
        excess = second[n] - first[n]
        g = -abs(excess) if own == _L2 else (excess if own == _L0 else -excess)
        wants = (own == _L2) | ((own < _L2) & (g < _NOTHING))
        stabilities[n] = g if wants else _INFINITY


@loop
def _choices_of_two(best: Field, labels: Field, first: Floats, second: Floats) -> None:
    """As `_choices`, for two labels."""
    for n in range(best.size):
        free = _L1 if second[n] < first[n] else _L0
        best[n] = free if labels[n] == _L2 else np.uint8(_L1 - labels[n])


@loop
def _count_finite(values: Floats) -> int:
    count = 0
    for n in range(values.size):
        count += values[n] < _INFINITY
    return count


@loop
def find_stabilities(stabilities: Floats, best: Field, labels: Field, unary: Planes, table: Floats, stride: int) -> int:
    """Stability and choice of all framed sites that want to change; return how many do.

    Labels are 255 where there is no data, K where uncommitted; `table` is (K, 4), its columns the neighbour's label.
    Stabilities of the other sites become infinite.
    """
    rows, count = labels.size // stride, unary.shape[0]
    none = np.uint8(count)
    pairs = np.zeros((3, count, stride), np.float32)
    e = np.full((DENSE_LABELS, stride - 2), _INFINITY)
    stabilities[:stride] = stabilities[-stride:] = _INFINITY
    wanting = 0
    for i in range(rows):
        # Pair costs of row i, then what row i - 1 makes of those around it.
        for label in range(count):
            _pair_costs(pairs[i % 3, label], labels[i * stride : (i + 1) * stride], table[label])
        if i < 2:
            continue
        start = (i - 1) * stride
        inner = slice(start + 1, start + stride - 1)
        stabilities[start] = stabilities[start + stride - 1] = _INFINITY
        for label in range(count):
            above, here, below = pairs[(i - 2) % 3, label], pairs[(i - 1) % 3, label], pairs[i % 3, label]
            _energies(e[label], unary[label, inner], above[1:-1], here, below[1:-1])
        if count == 2:
            _stabilities_of_two(stabilities[inner], labels[inner], e[0], e[1])
            _choices_of_two(best[inner], labels[inner], e[0], e[1])
        else:
            _stabilities(stabilities[inner], labels[inner], e[0], e[1], e[2], e[3], none)
            _choices(best[inner], labels[inner], e[0], e[1], e[2], e[3])
        wanting += _count_finite(stabilities[inner])
    return wanting


# ------------------------------------------------------------------------------------------------- changes


@loop
def _rank_row(ranks: Ranks, row: int, column: int) -> None:
    for n in range(ranks.size):
        ranks[n] = site_rank(row, column + n)


@loop
def _mark_beside(marks: Field, stabilities: Floats, ranks: Ranks) -> None:
    """Mark the sites that want to change and come before those on both sides; the others with their frame."""
    for n in range(marks.size):
        g, rank = stabilities[n + 1], ranks[n + 1]
        before_left = comes_before(g, rank, stabilities[n], ranks[n])
        before_right = comes_before(g, rank, stabilities[n + 2], ranks[n + 2])
        marks[n] = (g < _INFINITY) & before_left & before_right


@loop
def _keep_before(marks: Field, stabilities: Floats, ranks: Ranks, others: Floats, other_ranks: Ranks) -> None:
    """Keep the marks of the sites that come before those of another row."""
    for n in range(marks.size):
        marks[n] &= comes_before(stabilities[n], ranks[n], others[n], other_ranks[n])


@loop
def _change_marked(labels: Field, best: Field, marks: Field) -> None:
    for n in range(labels.size):
        labels[n] = best[n] if marks[n] != 0 else labels[n]


@loop
def change_first(labels: Field, stabilities: Floats, best: Field, row: int, column: int, stride: int) -> None:
    """Change every site that comes before its four neighbours; (row, column) is the place of the frame's first."""
    ranks = np.empty((3, stride), np.uint32)
    marks = np.empty(stride - 2, np.uint8)
    rows = labels.size // stride
    for i in range(rows):
        _rank_row(ranks[i % 3], row + i, column)
        if i < 2:
            continue
        start = (i - 1) * stride
        above, here, below = ranks[(i - 2) % 3], ranks[(i - 1) % 3], ranks[i % 3]
        inner = slice(start + 1, start + stride - 1)
        up, down = slice(inner.start - stride, inner.stop - stride), slice(inner.start + stride, inner.stop + stride)
        _mark_beside(marks, stabilities[start : start + stride], here)
        _keep_before(marks, stabilities[inner], here[1:-1], stabilities[up], above[1:-1])
        _keep_before(marks, stabilities[inner], here[1:-1], stabilities[down], below[1:-1])
        _change_marked(labels[inner], best[inner], marks)
