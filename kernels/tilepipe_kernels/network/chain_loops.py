"""Array loops of the line network: chains of joined things, and runs of points.

Things with two ends are met again and again here: fragments joined at seams, edges joined at nodes of degree
two.  End ``2 * i`` is the start of thing i and end ``2 * i + 1`` its end, so ``end ^ 1`` is the other end and
``end >> 1`` the thing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.network.fragment_table import axial_and_diagonal

Bool = NDArray[np.bool_]


@loop
def _walk(mate: Int64, entry: int, members: Int64, backward: Bool, cursor: int, seen: Bool) -> int:
    end = entry
    while True:
        members[cursor] = end >> 1
        backward[cursor] = end & 1
        seen[end >> 1] = True
        cursor += 1
        end = mate[end ^ 1]
        if end < 0 or end == entry:
            return cursor


@loop
def walk_chains(mate: Int64, priority: Int64) -> tuple[Int64, Int64, Bool, Bool]:
    """Join things to chains over their mated ends.

    Parameters
    ----------
    mate
        int64, shape (2 n,): the end to which each end is joined, or -1.
    priority
        int64, shape (2 n,): a cycle is entered at the end of lowest priority, ties at the lowest end.

    Returns
    -------
    offsets, members, backward, closed
        Chain c goes through ``members[offsets[c]:offsets[c + 1]]`` in order, each from its end to its start
        where ``backward``; ``closed`` tells the cycles, which come last.
    """
    n = len(mate) // 2
    members = np.empty(n, np.int64)
    backward = np.empty(n, np.bool_)
    offsets = np.zeros(n + 1, np.int64)
    seen = np.zeros(n, np.bool_)
    chains = cursor = 0
    for end in range(2 * n):
        if mate[end] < 0 and not seen[end >> 1]:
            cursor = _walk(mate, end, members, backward, cursor, seen)
            chains += 1
            offsets[chains] = cursor
    lines = chains
    for thing in range(n):
        if seen[thing]:
            continue
        best = end = 2 * thing
        while True:
            for side in (end, end ^ 1):
                if (priority[side], side) < (priority[best], best):
                    best = side
            end = mate[end ^ 1]
            if end == 2 * thing:
                break
        cursor = _walk(mate, best, members, backward, cursor, seen)
        chains += 1
        offsets[chains] = cursor
    closed = np.zeros(chains, np.bool_)
    closed[lines:] = True
    return offsets[: chains + 1].copy(), members, backward, closed


@loop
def rearrange(offsets: Int64, order: Int64, flip: Bool) -> tuple[Int64, Int64, Bool]:
    """Pick groups of a grouped list in a new order, and turn some of them round.

    Parameters
    ----------
    offsets
        int64, shape (g + 1,): bounds of the groups.
    order
        int64, shape (m,): groups to take; a group may be left out.
    flip
        bool, shape (m,): whether to turn the group.

    Returns
    -------
    offsets, source, flipped
        Bounds of the m new groups; for each new item its old place, and whether its group was turned.
    """
    bounds = np.zeros(len(order) + 1, np.int64)
    for i, group in enumerate(order):
        bounds[i + 1] = bounds[i] + offsets[group + 1] - offsets[group]
    source = np.empty(bounds[-1], np.int64)
    flipped = np.empty(bounds[-1], np.bool_)
    for i, group in enumerate(order):
        first, last = offsets[group], offsets[group + 1] - 1
        for j in range(bounds[i], bounds[i + 1]):
            k = j - bounds[i]
            source[j] = last - k if flip[i] else first + k
            flipped[j] = flip[i]
    return bounds, source, flipped


@loop
def expand_parts(
    start: Int64,
    stop: Int64,
    backward: Bool,
    slice_position: Int64,
    slice_source: Int64,
    slice_step: NDArray[np.int8],
) -> tuple[Int64, Int64, Int64, Int64]:
    """Turn ranges of canonical positions into runs of stored points.

    Parameters
    ----------
    start, stop, backward
        Parts, shape (m,): canonical positions [start, stop), read from the end where ``backward``.
    slice_position, slice_source, slice_step
        Slices, shape (s + 1,), (s,), (s,): slice i fills the canonical positions from ``slice_position[i]``
        to ``slice_position[i + 1]`` with the stored points ``slice_source[i]``, ``+ slice_step[i]``, ...

    Returns
    -------
    source, step, count, target
        Runs: ``count`` stored points from ``source`` on by ``step`` go to ``target``, ``target + 1``, ...
    """
    first = np.searchsorted(slice_position, start, side="right") - 1
    last = np.searchsorted(slice_position, stop - 1, side="right") - 1
    total = (last - first + 1).sum()
    source = np.empty(total, np.int64)
    step = np.empty(total, np.int64)
    count = np.empty(total, np.int64)
    target = np.empty(total, np.int64)
    cursor = written = 0
    for i in range(len(start)):
        for k in range(last[i] - first[i] + 1):
            j = last[i] - k if backward[i] else first[i] + k
            low, high = max(start[i], slice_position[j]), min(stop[i], slice_position[j + 1])
            begin = high - 1 if backward[i] else low
            source[cursor] = slice_source[j] + slice_step[j] * (begin - slice_position[j])
            step[cursor] = -slice_step[j] if backward[i] else slice_step[j]
            count[cursor] = high - low
            target[cursor] = written
            written += high - low
            cursor += 1
    return source, step, count, target


@loop
def copy_runs(
    values: NDArray[Any], source: Int64, step: Int64, count: Int64, target: Int64, result: NDArray[Any]
) -> None:
    """Copy runs of ``values`` into ``result``; arguments as returned by `expand_parts`."""
    for i in range(len(source)):
        for k in range(count[i]):
            result[target[i] + k] = values[source[i] + step[i] * k]


@loop
def count_steps(pixels: Int64, offsets: Int64, width: int) -> tuple[Int64, Int64]:
    """Axial and diagonal steps along each sequence ``pixels[offsets[i]:offsets[i + 1]]``."""
    axial = np.zeros(len(offsets) - 1, np.int64)
    diagonal = np.zeros(len(offsets) - 1, np.int64)
    for i in range(len(offsets) - 1):
        for j in range(offsets[i] + 1, offsets[i + 1]):
            straight, slanted = axial_and_diagonal(pixels[j - 1], pixels[j], width)
            axial[i] += straight
            diagonal[i] += slanted
    return axial, diagonal
