"""Sweeps over the colour classes of the coupled fields: iterated conditional modes and the Gibbs sampler."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.core.random import as_seed, uniform
from tilepipe_kernels.mrf.annealing import Annealing, boltzmann_factor
from tilepipe_kernels.mrf.edge_model import data_energy
from tilepipe_kernels.mrf.lines.energies import (  # fmt: skip
    NO_WISH,
    TOLERANCE,
    Block,
    Eight,
    Flat,
    Floats,
    Weights,
    around_label,
    edge_energy,
    energy_of_label,
    find_stabilities,
    pixels_of,
    squared_step,
)
from tilepipe_kernels.mrf.lines.sites import Neighbourhoods, X


class Class(NamedTuple):
    """The sites of a field whose global row + column is `colour` modulo `modulus`: none are neighbours."""

    field: int
    colour: int
    modulus: int


def classes_of(near: Neighbourhoods) -> list[Class]:
    """All classes, in the order of sweeps."""
    pairs = zip(near.fields, near.moduli(), strict=True)
    return [Class(field, colour, modulus) for field, modulus in pairs for colour in range(modulus)]


# ------------------------------------------------------------------------------------------------- alone


@rule
def label_alone(observed: np.float32, present: np.uint8, weights: Weights) -> np.uint8:
    """Label nearest to the data; the present one if none is."""
    best = NO_WISH
    for label in range(weights.levels):
        energy = data_energy(observed, np.float32(label), weights.sigma)
        if energy < best:
            best = energy
            present = np.uint8(label)
    return present


@rule
def element_alone(a: np.uint8, b: np.uint8, alpha: np.float32) -> np.uint8:
    """Element that its two labels alone would have: an edge if they differ."""
    return np.uint8(alpha * squared_step(a, b) > 0)


@loop
def _commit_alone(block: Block, weights: Weights) -> None:
    state, observed, exists, _, _, _, _, frame = block
    for site in range(state.size):
        if not exists[site]:
            continue
        if site >= frame.plane:
            pixel, other = pixels_of(site, frame)
            state[site] = element_alone(state[pixel], state[other], weights.alpha)
        else:
            state[site] = label_alone(observed[site], state[site], weights)


def commit_alone(block: Block, weights: Weights) -> None:
    """Give every site the value that it has alone: the label nearest to the data, an edge between different labels."""
    if on_device(block.state):
        device_form(__name__).commit_alone(block, weights)
    else:
        _commit_alone(block, weights)


# ------------------------------------------------------------------------------------------------- conditional modes


@rule
def first_of_class(row: int, column: int, colour: int, modulus: int) -> int:
    """Columns from a global position to the first one in its row with (row + column) modulo `modulus` = colour."""
    return (colour - row - column) % modulus


@rule
def best_element(energy: np.float32) -> np.uint8:
    """Better value of an element by its `edge_energy`, 0 on a tie."""
    return np.uint8(energy < -TOLERANCE)


@loop
def _icm_class(
    block: Block, weights: Weights, field: int, colour: int, modulus: int, stabilities: Floats, choices: Flat
) -> int:
    """Give every site of a class its best value (Besag 1986); return how many have changed."""
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
                value = best_element(edge_energy(state, tables, frame, weights, site))
                changes += state[site] != value
                state[site] = value
            continue
        find_stabilities(block, weights, sites[:count], stabilities, choices)
        for site in sites[:count]:
            if stabilities[site] < NO_WISH:
                state[site] = choices[site]
                changes += 1
    return changes


def icm_sweeps(block: Block, weights: Weights, classes: list[Class], rounds: int) -> int:
    """Sweep over all classes until nothing changes, `rounds` times at most; return the sweeps made."""
    if on_device(block.state):
        return int(device_form(__name__).icm_sweeps(block, weights, classes, rounds))
    stabilities, choices = np.empty(block.state.size, np.float32), np.empty(block.state.size, np.uint8)
    made, changes = 0, 1
    while made < rounds and changes:
        changes = sum(_icm_class(block, weights, *each, stabilities, choices) for each in classes)
        made += 1
    return made


# ------------------------------------------------------------------------------------------------- annealing


@inlined_rule
def drawn_label(
    observed: np.float32, around: Eight, weights: Weights, temperature: float, u: float, energies: NDArray[np.float64]
) -> int:
    """Label drawn from its conditional distribution by inversion of the uniform number u; `energies` is for notes."""
    lowest = math.inf
    for label in range(weights.levels):
        energies[label] = energy_of_label(observed, label, around, weights)
        lowest = min(lowest, energies[label])
    total = 0.0
    for label in range(weights.levels):
        total += boltzmann_factor(energies[label] - lowest, temperature)
        energies[label] = total
    label = 0
    while label < weights.levels - 1 and energies[label] < u * total:
        label += 1
    return label


@rule
def drawn_element(energy: np.float32, temperature: float, u: float) -> np.uint8:
    """Element drawn likewise, by its `edge_energy`."""
    factor = boltzmann_factor(float(abs(energy)), temperature)
    return np.uint8(u * (1.0 + factor) < (factor if energy > 0 else 1.0))


@rule
def draw_at(row: int, column: int, seed: np.uint64, sweep: np.uint64, field: int) -> float:
    """Uniform number of a site of a field at a global place."""
    return uniform(seed, np.uint64(row) << np.uint64(32) | np.uint64(column), sweep, np.uint64(field))


@loop
def _gibbs_class(
    block: Block, weights: Weights, field: int, colour: int, modulus: int,
    temperature: float, seed: np.uint64, sweep: np.uint64,
) -> None:  # fmt: skip
    """Draw every site of a class from its conditional distribution at a temperature (Geman & Geman 1984)."""
    state, observed, exists, _, _, _, tables, frame = block
    energies = np.empty(weights.levels)
    for i in range(frame.plane // frame.width):
        first = first_of_class(frame.row + i, frame.column, colour, modulus)
        for j in range(first, frame.width, modulus):
            site = field * frame.plane + i * frame.width + j
            if not exists[site]:
                continue
            u = draw_at(frame.row + i, frame.column + j, seed, sweep, field)
            if field == X:
                around = around_label(state, frame, site)
                state[site] = drawn_label(observed[site], around, weights, temperature, u, energies)
            else:
                state[site] = drawn_element(edge_energy(state, tables, frame, weights, site), temperature, u)


def gibbs_sweeps(block: Block, weights: Weights, classes: list[Class], schedule: Annealing) -> None:
    """Sweep over all classes at falling temperatures, drawing every site; arrays of a device stay there."""
    seed = as_seed(schedule.seed)
    draw = device_form(__name__).gibbs_class if on_device(block.state) else _gibbs_class
    for sweep, temperature in enumerate(schedule.temperatures()):
        for each in classes:
            draw(block, weights, *each, float(temperature), seed, np.uint64(sweep))
