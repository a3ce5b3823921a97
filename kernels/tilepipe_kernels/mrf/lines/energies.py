"""Energies and stabilities of the sites of the coupled fields in a block.

The fields X, H and V of a block lie one after another in one flat array, each framed by two sites without a value, so
that a neighbour is a constant difference of addresses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.mrf.edge_model import UNCOMMITTED, EdgeModel, element_energy, label_energy

TOLERANCE = np.float32(1e-4)
"""A committed site changes only for more than this: less may be rounding, by which it could change for ever."""

NO_WISH = np.float32(np.inf)
"""Stability of a site that wants no change."""

SURE = np.float32(-np.inf)
"""Stability of an uncommitted element between equal labels that gains nothing: it becomes 0 before all others."""

_ZERO = np.uint8(0)

Flat = NDArray[np.uint8]
Marks = NDArray[np.bool_]
Floats = NDArray[np.float32]
Ranks = NDArray[np.uint32]
Eight = tuple[int, int, int, int, int, int, int, int]
Sites = NDArray[np.int32]
"""Addresses in the flat fields."""


class Weights(NamedTuple):
    """Parameters of the model as the rules take them."""

    alpha: np.float32
    gamma: np.float32
    xi: np.float32
    zeta: np.float32
    beta: np.float32
    sigma: np.float32
    reciprocal: bool
    levels: int
    sure: bool

    @classmethod
    def of(cls, model: EdgeModel, sure: bool = True) -> Weights:
        """Weights of a model."""
        alpha, gamma, xi, zeta, beta, sigma = (np.float32(getattr(model, name)) for name in cls._fields[:6])
        return cls(alpha, gamma, xi, zeta, beta, sigma, model.reciprocal, model.levels, sure)


class Frame(NamedTuple):
    """Where a block lies.

    Attributes
    ----------
    plane, width
        Sites of one framed field, and of one of its rows.
    row, column
        Global position of the first site of each framed field.
    """

    plane: int
    width: int
    row: int
    column: int


class Block(NamedTuple):
    """Framed fields of a block and what never changes of them; arrays of a device make a block of the device.

    Attributes
    ----------
    state
        uint8 (3 plane,): values of X, H and V; 255 where uncommitted or where there is no site.
    observed
        float32 (plane,): grey values, NaN = no data; of length 0 where labels are given.
    exists
        bool (3 plane,): the sites that exist and can change.
    ranks
        uint32 (3 plane,): whose turn it is among the equally stable (`hcf.site_rank`); those of sites that want to
        change, once HCF has filled them in.
    offsets, bounds
        Neighbours of a site of each field, see `Neighbourhoods.offsets`.
    tables
        `energy_tables` of the model.
    frame
        Where the block lies.
    """

    state: Flat
    observed: Floats
    exists: Marks
    offsets: NDArray[np.int64]
    ranks: Ranks
    bounds: NDArray[np.int64]
    tables: Floats
    frame: Frame


# ------------------------------------------------------------------------------------------------- energies of a site
# The rules of a site take the arrays one by one: counting the references of a tuple of arrays would cost more.


@rule
def field_of(site: int, plane: int) -> int:
    """X, H or V."""
    return int(site >= plane) + int(site >= 2 * plane)


@inlined_rule
def pixels_of(site: int, frame: Frame) -> tuple[int, int]:
    """Addresses of the two labels that an element parts."""
    if site < 2 * frame.plane:
        return site - frame.plane, site - frame.plane + frame.width
    return site - 2 * frame.plane, site - 2 * frame.plane + 1


@rule
def squared_step(a: np.uint8, b: np.uint8) -> np.float32:
    """Squared difference of two labels; 0 if one is not committed."""
    step = np.float32(np.int32(a) - np.int32(b))
    return step * step if (a != UNCOMMITTED) & (b != UNCOMMITTED) else np.float32(0)


def energy_tables(model: EdgeModel) -> Floats:
    """Energy of an element being 1 less that of it being 0, by the elements along it, across it and at its corners.

    Returns
    -------
    ndarray of float32, shape (3 * 256,)
        At ``256 * part + code``, where the code has two bits for each of the four elements of `element_energy`, in
        order: 0, 1, or 3 where it is uncommitted or not there.  Looked up, for that an edge goes on is a matter of
        chance to a processor that guesses the outcome of comparisons.
    """
    weights = Weights.of(model)[:4]
    tables = np.zeros((3, 256), np.float32)
    absent = (int(UNCOMMITTED),) * 4
    for part in range(3):
        for code in range(256):
            four = tuple(int(UNCOMMITTED) if code >> k & 3 == 3 else code >> k & 3 for k in (0, 2, 4, 6))
            others: list[Any] = [*absent * part, *four, *absent * (2 - part), *weights]
            e0, e1 = (element_energy(e, np.float32(0), *others) for e in (0, 1))
            tables[part, code] = e1 - e0
    return tables.reshape(-1)


@inlined_rule
def code_of(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8) -> np.int64:
    """Code of four elements in `energy_tables`."""
    return np.int64(a & 3) | np.int64(b & 3) << 2 | np.int64(c & 3) << 4 | np.int64(d & 3) << 6


@rule
def edge_energy_of(
    going_on: np.float32, beside: np.float32, corners: np.float32, a: np.uint8, b: np.uint8, alpha: np.float32
) -> np.float32:
    """Energy of an element being 1 less that of it being 0: what tables tell of its lines, and the two labels."""
    return np.float32(going_on + beside + corners - alpha * squared_step(a, b))


@inlined_rule
def edge_energy(state: Flat, tables: Floats, frame: Frame, weights: Weights, site: int) -> np.float32:
    """Energy of the terms that an element is in when it is 1, less that when it is 0."""
    # A vertical element is a horizontal one with rows and columns exchanged.
    level = site < 2 * frame.plane
    along, across = (1, frame.width) if level else (frame.width, 1)
    corner = site + frame.plane if level else site - frame.plane
    pixel, other = pixels_of(site, frame)
    going_on = code_of(state[site - 2 * along], state[site - along], state[site + along], state[site + 2 * along])
    beside = code_of(state[site - 2 * across], state[site - across], state[site + across], state[site + 2 * across])
    corners = code_of(state[corner], state[corner - along], state[corner + across], state[corner + across - along])
    return edge_energy_of(
        tables[going_on], tables[256 + beside], tables[512 + corners], state[pixel], state[other], weights.alpha
    )


@rule
def element_stability(energy: np.float32, present: np.uint8, a: np.uint8, b: np.uint8, sure: bool) -> np.float32:
    """Stability of an element between two labels by its `edge_energy`, as `find_stabilities` gives it."""
    uncommitted = SURE if sure & (a == b) & (energy >= 0) else -abs(energy)
    gain = energy if present == _ZERO else -energy
    committed = gain if gain < -TOLERANCE else NO_WISH
    stability = uncommitted if present == UNCOMMITTED else committed
    return stability if (a != UNCOMMITTED) & (b != UNCOMMITTED) else NO_WISH


@rule
def element_choice(energy: np.float32, present: np.uint8) -> np.uint8:
    """Value that an element would take."""
    return np.uint8(energy < 0 if present == UNCOMMITTED else present == _ZERO)


@inlined_rule
def around_label(state: Flat, frame: Frame, site: int) -> Eight:
    """The labels up, left, right and down of a pixel, and the elements between; in the order of `label_energy`."""
    width = frame.width
    h, v = site + frame.plane, site + 2 * frame.plane
    return (
        state[site - width], state[site - 1], state[site + 1], state[site + width],
        state[h - width], state[v - 1], state[v], state[h],
    )  # fmt: skip


@inlined_rule
def energy_of_label(observed: np.float32, label: int, around: Eight, weights: Weights) -> np.float32:
    """Energy of the terms that a pixel is in when it has a label."""
    up, left, right, down, line_up, line_left, line_right, line_down = around
    return label_energy(
        observed, label, up, left, right, down, line_up, line_left, line_right, line_down,
        weights.beta, weights.sigma, weights.alpha, weights.reciprocal,
    )  # fmt: skip


@rule
def label_stability(
    observed: np.float32, present: np.uint8, around: Eight, weights: Weights
) -> tuple[np.float32, np.uint8]:
    """Stability and choice of a label, as `find_stabilities` gives them."""
    best = second = NO_WISH
    choice = _ZERO
    own = np.float32(0)
    for label in range(weights.levels):
        energy = energy_of_label(observed, label, around, weights)
        if label == present:
            own = energy
        elif energy < best:
            second, best, choice = best, energy, np.uint8(label)
        elif energy < second:
            second = energy
    if present == UNCOMMITTED:
        return best - second, choice
    return best - own if best - own < -TOLERANCE else NO_WISH, choice


@loop
def find_stabilities(block: Block, weights: Weights, sites: Sites, stabilities: Floats, choices: Flat) -> None:
    """Find the stability G of sites, `NO_WISH` where one wants no change, and the value that it would take.

    G is the lowest energy among its other values less that of the present one; of an uncommitted site it is the
    lowest energy less the second lowest (Chou & Brown 1990).  Of equal energies the lower value is taken.  An element
    wants nothing before both its labels are committed.
    """
    state, observed, _, _, _, _, tables, frame = block
    for site in sites:
        if site >= frame.plane:
            energy = edge_energy(state, tables, frame, weights, site)
            pixel, other = pixels_of(site, frame)
            a, b = state[pixel], state[other]
            stabilities[site] = element_stability(energy, state[site], a, b, weights.sure)
            choices[site] = element_choice(energy, state[site])
    # Apart, because a call in the loop above, even when not taken, would make it several times as slow.
    if observed.size:
        for site in sites:
            if site < frame.plane:
                around = around_label(state, frame, site)
                stabilities[site], choices[site] = label_stability(observed[site], state[site], around, weights)


@loop
def wishes(block: Block, weights: Weights, stabilities: Floats, choices: Flat, committed: bool) -> Sites:
    """Find the sites that want to change, `committed` ones too or without looking at them.

    Stabilities and choices are filled in; a site that does not exist wants nothing.
    """
    count = 0
    for site in range(block.state.size):
        stabilities[site] = NO_WISH
        count += block.exists[site] & (committed | (block.state[site] == UNCOMMITTED))
    sites = np.empty(count + 1, np.int32)
    count = 0
    for site in range(block.state.size):
        sites[count] = site
        count += block.exists[site] & (committed | (block.state[site] == UNCOMMITTED))
    sites = sites[:count]
    find_stabilities(block, weights, sites, stabilities, choices)
    wanting = np.empty(count + 1, np.int32)
    count = 0
    for found in sites:
        wanting[count] = found
        count += stabilities[found] < NO_WISH
    return wanting[:count]


def wanting_marks(block: Block, weights: Weights) -> Marks:
    """Mark the sites that want to change; arrays of a device stay there."""
    if on_device(block.state):
        return device_form(__name__).wanting_marks(block, weights)
    stabilities, choices = np.empty(block.state.size, np.float32), np.empty(block.state.size, np.uint8)
    return marks_of(wishes(block, weights, stabilities, choices, True), block)


def marks_of(sites: Sites, block: Block) -> Marks:
    """Mark listed sites."""
    marks = np.zeros(block.state.size, np.bool_)
    marks[sites] = True
    return marks
