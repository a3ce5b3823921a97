"""Sweeps over the colour classes of the coupled fields: iterated conditional modes and the Gibbs sampler."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .edge_model import data_energy
from .line_energies import (
    NO_WISH,
    TOLERANCE,
    Block,
    Flat,
    Floats,
    Weights,
    edge_energy,
    energy_of_label,
    find_stabilities,
    pixels_of,
    squared_step,
)  # fmt: skip
from .line_sites import X
from .random import uniform


@loop
def commit_alone(block: Block, weights: Weights) -> None:
    """Give every site the value that it has alone: the label nearest to the data, an edge between different labels."""
    state, observed, exists, _, _, _, _, frame = block
    for site in range(state.size):
        if not exists[site]:
            continue
        if site >= frame.plane:
            pixel, other = pixels_of(site, frame)
            state[site] = weights.alpha * squared_step(state[pixel], state[other]) > 0
            continue
        best = NO_WISH
        for label in range(weights.levels):
            energy = data_energy(observed[site], np.float32(label), weights.sigma)
            if energy < best:
                best = energy
                state[site] = label


@rule
def first_of_class(row: int, column: int, colour: int, modulus: int) -> int:
    """Columns from a global position to the first one in its row with (row + column) modulo `modulus` = colour."""
    return (colour - row - column) % modulus


@loop
def icm_class(
    block: Block, weights: Weights, field: int, colour: int, modulus: int, stabilities: Floats, choices: Flat
) -> int:
    """Give every site of a class its best value (Besag 1986), an element 0 on a tie; return how many have changed."""
    state, _, exists, _, _, _, tables, frame = block
    sites = np.empty(frame.width, np.int32)
    changes = 0
    for i in range(frame.plane // frame.width):
        start = field * frame.plane + i * frame.width
        first = first_of_class(frame.row + i, frame.column, colour, modulus)
        count = 0
        for site in range(start + first, start + frame.width, modulus):
            sites[count] = site
            count += exists[site]
        if field != X:
            for site in sites[:count]:
                value = np.uint8(edge_energy(state, tables, frame, weights, site) < -TOLERANCE)
                changes += state[site] != value
                state[site] = value
            continue
        find_stabilities(block, weights, sites[:count], stabilities, choices)
        for site in sites[:count]:
            if stabilities[site] < NO_WISH:
                state[site] = choices[site]
                changes += 1
    return changes


@loop
def _drawn_label(
    block: Block, weights: Weights, site: int, temperature: float, u: float, energies: NDArray[np.float64]
) -> int:
    """Label drawn from its conditional distribution by inversion of the uniform number u."""
    lowest = math.inf
    for label in range(weights.levels):
        energies[label] = energy_of_label(block.state, block.observed, block.frame, weights, site, label)
        lowest = min(lowest, energies[label])
    total = 0.0
    for label in range(weights.levels):
        total += math.exp((lowest - energies[label]) / temperature)
        energies[label] = total
    label = 0
    while label < weights.levels - 1 and energies[label] < u * total:
        label += 1
    return label


@loop
def gibbs_class(
    block: Block, weights: Weights, field: int, colour: int, modulus: int,
    temperature: float, seed: np.uint64, sweep: np.uint64,
) -> None:  # fmt: skip
    """Draw every site of a class from its conditional distribution at a temperature (Geman & Geman 1984)."""
    state, _, exists, _, _, _, tables, frame = block
    energies = np.empty(weights.levels)
    for i in range(frame.plane // frame.width):
        first = first_of_class(frame.row + i, frame.column, colour, modulus)
        for j in range(first, frame.width, modulus):
            site = field * frame.plane + i * frame.width + j
            if not exists[site]:
                continue
            key = np.uint64(frame.row + i) << np.uint64(32) | np.uint64(frame.column + j)
            u = uniform(seed, key, sweep, np.uint64(field))
            if field == X:
                state[site] = _drawn_label(block, weights, site, temperature, u, energies)
            else:
                energy = edge_energy(state, tables, frame, weights, site)
                state[site] = u * (1.0 + math.exp(energy / temperature)) < 1.0
