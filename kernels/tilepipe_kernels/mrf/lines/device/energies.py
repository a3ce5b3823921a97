"""`mrf.lines.energies` on the device: a thread for every site."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.array_rules import for_grids
from tilepipe_kernels.mrf.edge_model import UNCOMMITTED
from tilepipe_kernels.mrf.lines.energies import (
    NO_WISH,
    Block,
    Frame,
    Marks,
    Weights,
    around_label,
    edge_energy,
    element_choice,
    element_stability,
    label_stability,
    pixels_of,
)

edge_energy_at = for_grids(edge_energy)
around_label_at = for_grids(around_label)


@grid
def _look(
    count: int, marked: Any, state: Any, observed: Any, tables: Any, frame: Frame, weights: Weights, stabilities: Any,
    choices: Any,
) -> None:  # fmt: skip
    for site in range(cuda.grid(1), count, cuda.gridsize(1)):
        if not marked[site]:
            continue
        marked[site] = False
        present = state[site]
        if site >= frame.plane:
            energy = edge_energy_at(state, tables, frame, weights, site)
            pixel, other = pixels_of(site, frame)
            stabilities[site] = element_stability(energy, present, state[pixel], state[other], weights.sure)
            choices[site] = element_choice(energy, present)
        else:
            around = around_label_at(state, frame, site)
            stabilities[site], choices[site] = label_stability(observed[site], present, around, weights)


def look(block: Block, weights: Weights, marked: Marks, stabilities: Any, choices: Any) -> None:
    """Find stabilities and choices of the marked sites, as `mrf.lines.energies.find_stabilities`, and unmark them."""
    _look(
        marked.size, marked, block.state, block.observed, block.tables, block.frame, weights, stabilities, choices
    )  # fmt: skip


def first_look(block: Block, weights: Weights, committed: bool) -> tuple[Marks, Any, Any]:
    """Marks, all lifted; stabilities and choices of all sites, those of the committed only if these are looked at."""
    xp = namespace(block.state)
    marked = block.exists.copy() if committed else block.exists & (block.state == UNCOMMITTED)
    stabilities, choices = xp.full(marked.size, NO_WISH, dtype=xp.float32), xp.empty(marked.size, xp.uint8)
    look(block, weights, marked, stabilities, choices)
    return marked, stabilities, choices


def wanting_marks(block: Block, weights: Weights) -> Marks:
    """See `mrf.lines.energies.wanting_marks`."""
    _, stabilities, _ = first_look(block, weights, committed=True)
    wanting: Marks = stabilities < NO_WISH
    return wanting
