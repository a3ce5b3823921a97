"""Highest Confidence First (HCF) over the coupled fields, serial and in rounds."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.mrf.hcf import comes_before, site_rank
from tilepipe_kernels.mrf.lines.energies import (  # fmt: skip
    NO_WISH,
    SURE,
    Block,
    Flat,
    Floats,
    Frame,
    Marks,
    Ranks,
    Sites,
    Weights,
    field_of,
    find_stabilities,
    marks_of,
    pixels_of,
    wishes,
)
from tilepipe_kernels.mrf.lines.sites import H, V


@rule
def place_of(site: int, frame: Frame) -> tuple[int, int]:
    """Global place of a site on the grid of half a pixel, on which labels and elements all lie elsewhere."""
    field = field_of(site, frame.plane)
    at = site - field * frame.plane
    row = at // frame.width
    column = at - row * frame.width
    return 2 * (frame.row + row) + (field == H), 2 * (frame.column + column) + (field == V)


# ------------------------------------------------------------------------------------------------- serial


@loop
def serial_hcf(block: Block, weights: Weights) -> int:
    """Change the least stable site until none wants to; return the number of changes."""
    state, _, exists, offsets, _, bounds, _, frame = block
    stabilities, choices = np.full(state.size, NO_WISH, np.float32), np.empty(state.size, np.uint8)
    near = np.empty(1 + max(bounds[1:] - bounds[:-1]), np.int32)
    before = np.empty(near.size, np.float32)
    heap = [(NO_WISH, np.uint32(0), np.int64(0))]
    for site in wishes(block, weights, stabilities, choices, True):
        heapq.heappush(heap, (stabilities[site], site_rank(*place_of(site, frame)), np.int64(site)))
    changes = 0
    while len(heap) > 1:
        queued, _, site = heapq.heappop(heap)
        # An entry that is no longer true was left behind when a neighbour changed.
        if queued != stabilities[site]:
            continue
        state[site] = choices[site]
        changes += 1
        field = field_of(int(site), frame.plane)
        count = 0
        for k in range(bounds[field] - 1, bounds[field + 1]):
            other = site if k < bounds[field] else site + offsets[k]
            if exists[other]:
                near[count], before[count] = other, stabilities[other]
                count += 1
        find_stabilities(block, weights, near[:count], stabilities, choices)
        for k in range(count):
            other, now = near[k], stabilities[near[k]]
            if now != before[k] and now < NO_WISH:
                heapq.heappush(heap, (now, site_rank(*place_of(other, frame)), np.int64(other)))
    return changes


# ------------------------------------------------------------------------------------------------- parallel


@loop
def _rank(ranks: Ranks, frame: Frame, sites: Sites) -> None:
    for site in sites:
        ranks[site] = site_rank(*place_of(site, frame))


@inlined_rule
def is_least(
    stabilities: Floats, ranks: Ranks, offsets: NDArray[np.int64], bounds: NDArray[np.int64], frame: Frame, site: int
) -> bool:
    """Whether a site that wants to change is the least stable of its neighbourhood, ties by rank."""
    field = field_of(site, frame.plane)
    own, rank = stabilities[site], ranks[site]
    blocked = False
    # no branches: ties are as frequent as not
    for k in range(bounds[field], bounds[field + 1]):
        other = site + offsets[k]
        blocked |= comes_before(stabilities[other], ranks[other], own, rank)
    return not blocked


@loop
def _change_least(block: Block, stabilities: Floats, choices: Flat, wanting: Sites, changed: Sites) -> int:
    """Change the least stable sites of all neighbourhoods at once; return how many, listed in `changed`."""
    state, _, _, offsets, ranks, bounds, _, frame = block
    count = 0
    for site in wanting:
        changed[count] = site
        count += (stabilities[site] == SURE) | is_least(stabilities, ranks, offsets, bounds, frame, site)
    for site in changed[:count]:
        state[site] = choices[site]
    return count


@inlined_rule
def _is_quiet(state: Flat, stabilities: Floats, frame: Frame, site: int) -> bool:
    """Whether no neighbour feels that a sure element became 0: no edge to break off, and labels that are content."""
    along = 1 if site < 2 * frame.plane else frame.width
    pixel, other = pixels_of(site, frame)
    edges = (state[site - 2 * along] == 1) | (state[site - along] == 1)
    edges |= (state[site + along] == 1) | (state[site + 2 * along] == 1)
    return not edges and stabilities[pixel] == NO_WISH and stabilities[other] == NO_WISH


@loop
def _touch(block: Block, stabilities: Floats, changed: Sites, seen: Marks, touched: Sites) -> int:
    """List and mark the changed sites and the neighbours that may feel it, each once; return how many."""
    state, _, exists, offsets, _, bounds, _, frame = block
    count = 0
    for site in changed:
        field = field_of(site, frame.plane)
        end = bounds[field + 1]
        if stabilities[site] == SURE and _is_quiet(state, stabilities, frame, site):
            end = bounds[field]
        for k in range(bounds[field] - 1, end):
            other = site if k < bounds[field] else site + offsets[k]
            if exists[other] and not seen[other]:
                seen[other] = True
                touched[count] = other
                count += 1
    return count


@loop
def _one_round(
    block: Block, weights: Weights, stabilities: Floats, choices: Flat, wanting: Sites, seen: Marks
) -> Sites:  # fmt: skip
    """One round; return the sites that want to change after it.  `seen` is all False before and after."""
    widest = 1 + max(block.bounds[1:] - block.bounds[:-1])
    changed = np.empty(wanting.size, np.int32)
    changes = _change_least(block, stabilities, choices, wanting, changed)
    touched = np.empty(min(changes * widest, seen.size), np.int32)
    touches = _touch(block, stabilities, changed[:changes], seen, touched)
    following = np.empty(wanting.size + touches + 1, np.int32)
    count = 0
    for site in wanting:
        following[count] = site
        count += not seen[site]
    known = count
    find_stabilities(block, weights, touched[:touches], stabilities, choices)
    for site in touched[:touches]:
        seen[site] = False
        following[count] = site
        count += stabilities[site] < NO_WISH
    _rank(block.ranks, block.frame, following[known:count])
    return following[:count].copy()


def parallel_rounds(
    block: Block, weights: Weights, stabilities: Floats, choices: Flat, wanting: Sites, rounds: int
) -> tuple[int, Sites]:
    """Let all sites change at once that are least stable in their neighbourhood, for some rounds.

    Parameters
    ----------
    block, weights
        The state is changed.
    stabilities, choices
        G of every site, `NO_WISH` where there is none, and the values that the wanting ones would take; changed.
    wanting
        The sites that want to change.
    rounds
        Cap on the rounds.

    Returns
    -------
    rounds, wanting
        Rounds made, and the sites that still want to change.
    """
    seen = np.zeros(block.state.size, np.bool_)
    _rank(block.ranks, block.frame, wanting)
    made = 0
    while made < rounds and wanting.size > 0:
        wanting = _one_round(block, weights, stabilities, choices, wanting, seen)
        # neighbours are then near in memory too
        wanting.sort()
        made += 1
    return made, wanting


def parallel_hcf(block: Block, weights: Weights, rounds: int) -> tuple[int, Marks]:
    """Parallel HCF from the committed and uncommitted sites of a block; arrays of a device stay there.

    Parameters
    ----------
    block, weights
        The state is changed.
    rounds
        Cap on the rounds.

    Returns
    -------
    rounds, wanting
        Rounds made, and a mark for every site that still wants to change.
    """
    if on_device(block.state):
        return device_form(__name__).parallel_hcf(block, weights, rounds)
    stabilities, choices = np.empty(block.state.size, np.float32), np.empty(block.state.size, np.uint8)
    wanting = wishes(block, weights, stabilities, choices, False)
    made, wanting = parallel_rounds(block, weights, stabilities, choices, wanting, rounds)
    return made, marks_of(wanting, block)
