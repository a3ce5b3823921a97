"""`mrf.lines.sweeps` on the device: a thread for every site of a class."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.array_rules import for_grids
from tilepipe_kernels.mrf.edge_model import MAXIMUM_LEVELS
from tilepipe_kernels.mrf.lines.device.energies import around_label_at, edge_energy_at
from tilepipe_kernels.mrf.lines.energies import NO_WISH, Block, Frame, Weights, label_stability, pixels_of
from tilepipe_kernels.mrf.lines.sites import X
from tilepipe_kernels.mrf.lines.sweeps import (
    Class,
    best_element,
    draw_at,
    drawn_element,
    drawn_label,
    element_alone,
    first_of_class,
    label_alone,
)

_SWEEPS = 2
"""Sweeps between two looks of the host at whether anything still changes."""

_drawn_label_at = for_grids(drawn_label)


# ------------------------------------------------------------------------------------------------- alone


@grid
def _labels_alone(count: int, observed: Any, exists: Any, weights: Weights, state: Any) -> None:
    for site in range(cuda.grid(1), count, cuda.gridsize(1)):
        if exists[site]:
            state[site] = label_alone(observed[site], state[site], weights)


@grid
def _elements_alone(count: int, exists: Any, frame: Frame, alpha: np.float32, state: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        site = frame.plane + p
        if exists[site]:
            pixel, other = pixels_of(site, frame)
            state[site] = element_alone(state[pixel], state[other], alpha)


def commit_alone(block: Block, weights: Weights) -> None:
    """See `mrf.lines.sweeps.commit_alone`."""
    _labels_alone(block.observed.size, block.observed, block.exists, weights, block.state)
    _elements_alone(2 * block.frame.plane, block.exists, block.frame, weights.alpha, block.state)


# ------------------------------------------------------------------------------------------------- classes


@cuda.jit(device=True)
def _site_of_class(p: int, field: int, colour: int, modulus: int, frame: Frame) -> tuple[int, int, int]:
    """Site number p of a class, its framed row and column; the column lies beyond the row where there is none."""
    in_row = (frame.width + modulus - 1) // modulus
    i = p // in_row
    j = first_of_class(frame.row + i, frame.column, colour, modulus) + (p - i * in_row) * modulus
    return field * frame.plane + i * frame.width + j, i, j


def _count(frame: Frame, modulus: int) -> int:
    """Threads for the sites of a class, as `_site_of_class` numbers them."""
    return frame.plane // frame.width * -(-frame.width // modulus)


@grid
def _icm_class(
    count: int, field: int, colour: int, modulus: int, state: Any, observed: Any, exists: Any, tables: Any,
    frame: Frame, weights: Weights, turn: int, last: Any,
) -> None:  # fmt: skip
    """Give every site of a class its best value; note the sweep if one has changed."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        site, _, column = _site_of_class(p, field, colour, modulus, frame)
        if column >= frame.width or not exists[site]:
            continue
        present = state[site]
        value = present
        if field == X:
            stability, choice = label_stability(observed[site], present, around_label_at(state, frame, site), weights)
            if stability < NO_WISH:
                value = choice
        else:
            value = best_element(edge_energy_at(state, tables, frame, weights, site))
        if value != present:
            state[site] = value
            if last[0] != turn:
                last[0] = turn


def icm_sweeps(block: Block, weights: Weights, classes: list[Class], rounds: int) -> int:
    """See `mrf.lines.sweeps.icm_sweeps`."""
    last = namespace(block.state).zeros(1, np.int64)
    for turn in range(1, rounds + 1):
        for each in classes:
            _icm_class(
                _count(block.frame, each.modulus), *each, block.state, block.observed, block.exists, block.tables,
                block.frame, weights, turn, last,
            )  # fmt: skip
        # sweeps after the first one that changes nothing do nothing either
        if turn % _SWEEPS == 0 and int(last[0]) < turn:
            break
    return min(int(last[0]) + 1, rounds)


@grid
def _gibbs_class(
    count: int, field: int, colour: int, modulus: int, state: Any, observed: Any, exists: Any, tables: Any,
    frame: Frame, weights: Weights, temperature: float, seed: np.uint64, sweep: np.uint64,
) -> None:  # fmt: skip
    energies = cuda.local.array(MAXIMUM_LEVELS, np.float64)
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        site, row, column = _site_of_class(p, field, colour, modulus, frame)
        if column >= frame.width or not exists[site]:
            continue
        u = draw_at(frame.row + row, frame.column + column, seed, sweep, field)
        if field == X:
            around = around_label_at(state, frame, site)
            state[site] = _drawn_label_at(observed[site], around, weights, temperature, u, energies)
        else:
            state[site] = drawn_element(edge_energy_at(state, tables, frame, weights, site), temperature, u)


def gibbs_class(
    block: Block, weights: Weights, field: int, colour: int, modulus: int,
    temperature: float, seed: np.uint64, sweep: np.uint64,
) -> None:  # fmt: skip
    """Draw every site of a class from its conditional distribution at a temperature."""
    _gibbs_class(
        _count(block.frame, modulus), field, colour, modulus, block.state, block.observed, block.exists, block.tables,
        block.frame, weights, temperature, seed, sweep,
    )  # fmt: skip
