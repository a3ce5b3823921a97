"""Highest Confidence First on a labelling problem: serial (Chou & Brown 1990) and parallel (Swain & Wixson 1992).

The parallel form keeps a list of the sites that want to change, those uncommitted or with G < 0.  In a round, the
sites of the list that come before their four neighbours change, and the stability of what they touch is computed
anew from scratch, so that no sum depends on the order of changes.  Sites that change at once are never adjacent: each
change lowers the energy by its ``|G|``.  Stable sites are given infinite G, for nobody waits for them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.mrf.hcf import comes_before
from tilepipe_kernels.mrf.labels.hcf_dense import DENSE_LABELS, change_first, cost_planes, find_stabilities
from tilepipe_kernels.mrf.labels.problem import Field, Floats, Labelling, Place, Sites
from tilepipe_kernels.mrf.labels.stability import rank_of, stability, wish

_INFINITY = np.float32(np.inf)

Ranks = NDArray[np.uint32]

_MISSING = np.uint8(255)
_SPARSE = 12
"""Rounds walk all rows until less than one site in so many wants to change."""

# ------------------------------------------------------------------------------------------------- parallel


@loop
def _goes_before(stabilities: Floats, row: int, column: int, stride: int, p: Place, other: Place) -> bool:
    """Whether a site need not wait for its neighbour."""
    if stabilities[p] != stabilities[other]:
        return bool(stabilities[p] < stabilities[other])
    return bool(rank_of(row, column, stride, p) < rank_of(row, column, stride, other))


@loop
def _comes_first(stabilities: Floats, row: int, column: int, stride: int, p: Place) -> bool:
    return (
        _goes_before(stabilities, row, column, stride, p, p - stride)
        and _goes_before(stabilities, row, column, stride, p, p - 1)
        and _goes_before(stabilities, row, column, stride, p, p + 1)
        and _goes_before(stabilities, row, column, stride, p, p + stride)
    )


@loop
def _find_stabilities(problem: Labelling, labels: Field, stabilities: Floats, best: Field) -> None:
    """Compute the stability of all sites that want to change; it is infinite for the others."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    stride, none, exists = problem.stride, unary.shape[1], problem.exists
    for p in range(labels.size):
        stabilities[p] = _INFINITY
        if exists[p]:
            g, best[p] = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
            stabilities[p] = wish(g, labels[p] != none)


@loop
def _dense_rounds(problem: Labelling, labels: Field, stabilities: Floats, best: Field, cap: int) -> int:
    """Rounds over whole rows as long as many sites want to change; stabilities are those after the last."""
    unary = np.empty((problem.unary.shape[1], labels.size), np.float32)
    cost_planes(problem.unary, unary)
    table = np.zeros((unary.shape[0], DENSE_LABELS), np.float32)
    table[:, : unary.shape[0]] = problem.tables[0, : unary.shape[0]]
    for p in range(labels.size):
        labels[p] = labels[p] if problem.exists[p] else _MISSING
    rounds = 0
    wanting = find_stabilities(stabilities, best, labels, unary, table, problem.stride)
    while rounds < cap and wanting * _SPARSE > labels.size:
        change_first(labels, stabilities, best, problem.row, problem.column, problem.stride)
        wanting = find_stabilities(stabilities, best, labels, unary, table, problem.stride)
        rounds += 1
    for p in range(labels.size):
        labels[p] = labels[p] if problem.exists[p] else np.uint8(unary.shape[0])
    return rounds


@loop
def _listed_rounds(problem: Labelling, labels: Field, stabilities: Floats, best: Field, cap: int) -> tuple[int, Sites]:
    """Rounds over a list of the sites that want to change."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    sites, stride, none = labels.size, problem.stride, unary.shape[1]
    row, column, exists = problem.row, problem.column, problem.exists
    waiting, changing = np.empty(sites, np.int32), np.empty(sites, np.int32)
    renewed_in = np.zeros(sites, np.uint16)
    count = rounds = 0
    for site in range(sites):
        if stabilities[site] < _INFINITY:
            waiting[count] = site
            count += 1
    while count > 0 and rounds < cap:
        rounds += 1
        changes = 0
        for n in range(count):
            if _comes_first(stabilities, row, column, stride, np.int64(waiting[n])):
                changing[changes] = waiting[n]
                changes += 1
        for n in range(changes):
            labels[changing[n]] = best[changing[n]]
        for n in range(changes):
            centre = np.int64(changing[n])
            for p in (centre - stride, centre - 1, centre, centre + 1, centre + stride):
                if not exists[p] or renewed_in[p] == rounds:
                    continue
                renewed_in[p] = rounds
                listed = stabilities[p] < _INFINITY
                g, best[p] = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
                stabilities[p] = wish(g, labels[p] != none)
                if not listed and g < 0:
                    waiting[count] = p
                    count += 1
        kept = 0
        for n in range(count):
            if stabilities[waiting[n]] < _INFINITY:
                waiting[kept] = waiting[n]
                kept += 1
        count = kept
    return rounds, waiting[:count].copy()


def parallel_rounds(problem: Labelling, labels: Field, cap: int) -> tuple[int, Sites]:
    """Change labels in place, in rounds, until no site wants to or `cap` rounds are done.

    Parameters
    ----------
    problem
        The costs.
    labels
        uint8 (sites,), framed; K = uncommitted.  Sites still so at the end take their best label.
    cap
        Largest number of rounds, below 65536.

    Returns
    -------
    rounds, wanting
        Rounds done, and the sites that still wanted to change.
    """
    if on_device(labels):
        found: tuple[int, Sites] = device_form(__name__).parallel_rounds(problem, labels, cap)
        return found
    stabilities, best = np.empty(labels.size, np.float32), np.zeros(labels.size, np.uint8)
    none = problem.unary.shape[1]
    rounds = 0
    if none <= DENSE_LABELS and problem.tables.shape[0] == 2 and problem.down_weight is None:
        rounds = _dense_rounds(problem, labels, stabilities, best, cap)
    else:
        _find_stabilities(problem, labels, stabilities, best)
    more, waiting = _listed_rounds(problem, labels, stabilities, best, cap - rounds)
    last = waiting[labels[waiting] == none]
    labels[last] = best[last]
    return rounds + more, waiting


# ------------------------------------------------------------------------------------------------- serial


@loop
def _less_stable(stabilities: Floats, ranks: Ranks, p: Place, other: Place) -> bool:
    return comes_before(stabilities[p], ranks[p], stabilities[other], ranks[other])


@loop
def _move_up(heap: Sites, place: Sites, stabilities: Floats, ranks: Ranks, slot: Place) -> Place:
    """Move the site of a slot up the heap, before all that are more stable; return its new slot."""
    p = heap[slot]
    while slot > 0:
        parent = (slot - 1) >> 1
        if not _less_stable(stabilities, ranks, p, heap[parent]):
            break
        heap[slot] = heap[parent]
        place[heap[slot]] = slot
        slot = parent
    heap[slot] = p
    place[p] = slot
    return slot


@loop
def _move_down(heap: Sites, place: Sites, stabilities: Floats, ranks: Ranks, slot: Place) -> None:
    """Move the site of a slot down the heap, after all that are less stable."""
    p = heap[slot]
    while 2 * slot + 1 < heap.size:
        child = 2 * slot + 1
        if child + 1 < heap.size and _less_stable(stabilities, ranks, heap[child + 1], heap[child]):
            child += 1
        if not _less_stable(stabilities, ranks, heap[child], p):
            break
        heap[slot] = heap[child]
        place[heap[slot]] = slot
        slot = child
    heap[slot] = p
    place[p] = slot


@loop
def serial_changes(problem: Labelling, labels: Field) -> int:
    """Change the least stable site of all, in place, until every site is committed and stable.

    Ties go by rank, as in the parallel form.  Returns the number of changes.
    """
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    sites, stride, none = labels.size, problem.stride, unary.shape[1]
    exists = problem.exists
    stabilities, best = np.empty(sites, np.float32), np.zeros(sites, np.uint8)
    # Stable sites have infinite G, lest one of G = 0 end the work before the uncommitted ones of G = 0.
    _find_stabilities(problem, labels, stabilities, best)
    ranks = np.empty(sites, np.uint32)
    place = np.empty(sites, np.int32)
    heap = np.flatnonzero(problem.exists).astype(np.int32)
    for slot in range(heap.size):
        place[heap[slot]] = slot
        ranks[heap[slot]] = rank_of(problem.row, problem.column, stride, np.int64(heap[slot]))
    for slot in range(heap.size // 2 - 1, -1, -1):
        _move_down(heap, place, stabilities, ranks, slot)
    changes = 0
    while heap.size > 0:
        centre = np.int64(heap[0])
        if stabilities[centre] == _INFINITY:
            break
        labels[centre] = best[centre]
        changes += 1
        for p in (centre, centre - stride, centre - 1, centre + 1, centre + stride):
            if exists[p]:
                g, best[p] = stability(unary, tables, down, right, down_weight, right_weight, labels, stride, none, p)
                stabilities[p] = wish(g, labels[p] != none)
                higher = _move_up(heap, place, stabilities, ranks, np.int64(place[p]))
                _move_down(heap, place, stabilities, ranks, higher)
    return changes
