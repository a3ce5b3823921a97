"""`mrf.lines.hcf` on the device: in each round a thread for every site, first to change and mark, then to look.

A site that is not marked, because nothing near it has changed, keeps its stability as on the host.
"""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.array_rules import for_grids
from tilepipe_kernels.mrf.hcf import site_rank
from tilepipe_kernels.mrf.lines.device.energies import first_look, look
from tilepipe_kernels.mrf.lines.energies import NO_WISH, SURE, Block, Frame, Marks, Weights, field_of
from tilepipe_kernels.mrf.lines.hcf import is_least, place_of

_ROUNDS = 4
"""Rounds between two looks of the host at whether anything still wants to change."""

_is_least_at = for_grids(is_least)


@grid
def _rank(count: int, exists: Any, frame: Frame, ranks: Any) -> None:
    for site in range(cuda.grid(1), count, cuda.gridsize(1)):
        if exists[site]:
            row, column = place_of(site, frame)
            ranks[site] = site_rank(row, column)


@grid
def _change_least(
    count: int, turn: int, stabilities: Any, choices: Any, ranks: Any, offsets: Any, bounds: Any, exists: Any,
    frame: Frame, state: Any, marked: Any, last: Any,
) -> None:  # fmt: skip
    """Change the least stable sites of all neighbourhoods; mark them and their neighbours, and note the round."""
    for site in range(cuda.grid(1), count, cuda.gridsize(1)):
        if not stabilities[site] < NO_WISH:
            continue
        # all write the same, and few find that they must
        if last[0] != turn:
            last[0] = turn
        if stabilities[site] != SURE and not _is_least_at(stabilities, ranks, offsets, bounds, frame, site):
            continue
        state[site] = choices[site]
        marked[site] = True
        field = field_of(site, frame.plane)
        for k in range(bounds[field], bounds[field + 1]):
            other = site + offsets[k]
            if exists[other]:
                marked[other] = True


def parallel_hcf(block: Block, weights: Weights, rounds: int) -> tuple[int, Marks]:
    """See `mrf.lines.hcf.parallel_hcf`."""
    xp = namespace(block.state)
    size = block.state.size
    _rank(size, block.exists, block.frame, block.ranks)
    marked, stabilities, choices = first_look(block, weights, committed=False)
    last = xp.zeros(1, xp.int64)
    for turn in range(1, rounds + 1):
        _change_least(
            size, turn, stabilities, choices, block.ranks, block.offsets, block.bounds, block.exists, block.frame,
            block.state, marked, last,
        )  # fmt: skip
        look(block, weights, marked, stabilities, choices)
        # rounds after the last one in which a site wanted to change do nothing
        if turn % _ROUNDS == 0 and int(last[0]) < turn:
            break
    return int(last[0]), stabilities < NO_WISH
