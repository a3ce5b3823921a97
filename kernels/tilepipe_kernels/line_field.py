"""Line elements given labels, and labels and elements at once, by minimising the energy of edge_model.py (`edges`).

All optimisers change one site at a time as far as the energy can tell: sites that change at once share no term.

- parallel: Highest Confidence First (HCF) in its local form (Swain & Wixson 1992), where in each round all sites
  change that are the least stable of their neighbourhood; the default.
- serial: HCF with a heap (Chou & Brown 1990): the least stable site of all is next.
- icm: iterated conditional modes (Besag 1986), class of colour after class.
- annealing: Gibbs sampler (Geman & Geman 1984) over the same classes at falling temperatures, and then icm.

HCF starts with sites uncommitted, of which no term speaks.  To a lone element between equal labels 0 and 1 are worth
the same, so that it would be committed last, by ties, when all edges are drawn.  But the labels already say that
there is nothing to part: such an element is *sure* and becomes 0 at once.  On photographs that ends in an energy 3 to
9 % lower than without (``sure=False``, the form of the papers), with a third of the edges and of the rounds.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .annealing import Annealing
from .compiled import loop
from .edge_model import UNCOMMITTED, EdgeModel, Field, Floats, Window, checked_field, checked_observed
from .line_energies import Block, Frame, Weights, energy_tables, wishes
from .line_hcf import parallel_rounds, serial_hcf
from .line_sites import FRAME, H, Neighbourhoods, V, X, neighbourhoods
from .line_sweeps import commit_alone, gibbs_class, icm_class
from .random import as_seed

Method = Literal["parallel", "serial", "icm", "annealing"]
Marks = NDArray[np.bool_]

ROUNDS = 24
"""Rounds of `parallel` after which, on photographs and noise alike, next to no site wants to change."""

_NOTHING = np.empty(0, np.float32)
_INNER = slice(FRAME, -FRAME)
_WHOLE: Window = (slice(None), slice(None))


class LineField(NamedTuple):
    """Line elements of a block.

    Attributes
    ----------
    horizontal, vertical
        h and v, uint8, shape of the labels; 0 where there is no element.
    rounds
        Rounds (of icm and annealing: sweeps) made; of the serial form, changes of a site.
    unresolved
        Sites of the core that still want to change.
    """

    horizontal: Field
    vertical: Field
    rounds: int
    unresolved: int


class CoupledFields(NamedTuple):
    """Labels and line elements of a block; labels are 255 without data, the rest as in `LineField`."""

    labels: Field
    horizontal: Field
    vertical: Field
    rounds: int
    unresolved: int


# ------------------------------------------------------------------------------------------------- halo


def halo(
    model: EdgeModel, rounds: int = ROUNDS, *, method: Method = "parallel", integrated: bool = False,
    annealing: Annealing | None = None,
) -> int:  # fmt: skip
    """Pixels around a block's core that its result depends on.

    In a round of `parallel` a site looks at the stabilities of its neighbours, which look at theirs; in a sweep of
    the others each colour class looks at the one before.

    Parameters
    ----------
    model, rounds, method, integrated, annealing
        As for `line_field`, or `coupled_fields` if integrated.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        For the serial form, in which a site may depend on any other.
    """
    near = neighbourhoods(model, integrated=integrated)
    if method == "serial":
        raise ValueError("serial HCF has no halo: it needs the whole raster in one block")
    if method == "parallel":
        return 2 * near.reach * rounds + 1
    sweeps = rounds + ((annealing or Annealing()).sweeps if method == "annealing" else 0)
    return near.reach * sum(near.moduli()) * sweeps + 1


# ------------------------------------------------------------------------------------------------- blocks


@loop
def _existing(has_data: Marks, exists: NDArray[np.bool_], with_labels: bool) -> None:
    """Mark the sites of the framed fields that exist and can change."""
    for i in range(has_data.shape[0] - 1):
        for j in range(has_data.shape[1] - 1):
            here = has_data[i, j]
            exists[X, i, j] = here & with_labels
            exists[H, i, j] = here & has_data[i + 1, j]
            exists[V, i, j] = here & has_data[i, j + 1]


@loop
def _part(labels: Field, exists: NDArray[np.bool_], state: NDArray[np.uint8]) -> None:
    """Commit the sure elements: those between equal labels to 0."""
    for i in range(labels.shape[0] - 1):
        for j in range(labels.shape[1] - 1):
            known = labels[i, j] != UNCOMMITTED
            below, right = labels[i, j] == labels[i + 1, j], labels[i, j] == labels[i, j + 1]
            state[H, i, j] = 0 if exists[H, i, j] & known & below else UNCOMMITTED
            state[V, i, j] = 0 if exists[V, i, j] & known & right else UNCOMMITTED


class _Sites(NamedTuple):
    """A block ready to be minimised."""

    block: Block
    weights: Weights
    near: Neighbourhoods
    shape: tuple[int, int]

    def fields(self) -> list[Field]:
        """X, H and V without their frames; 0 where there is no element."""
        framed = self.block.state.reshape(3, self.shape[0] + 2 * FRAME, self.shape[1] + 2 * FRAME)
        x, h, v = (np.ascontiguousarray(field[_INNER, _INNER]) for field in framed)
        exists = self.block.exists.reshape(framed.shape)[:, _INNER, _INNER]
        h[~exists[H]] = v[~exists[V]] = 0
        return [x, h, v]

    def commit(self, wanting: NDArray[np.int32]) -> NDArray[np.int32]:
        """Commit what the cap on the rounds left over, elements to 0, labels to the nearest; return all unresolved."""
        state, observed, frame = self.block.state, self.block.observed, self.block.frame
        if wanting.size == 0:
            return wanting
        left = np.flatnonzero(self.block.exists & (state == UNCOMMITTED)).astype(np.int32)
        state[left[left >= frame.plane]] = 0
        pixels = left[left < frame.plane]
        state[pixels] = np.clip(np.rint(observed[pixels]), 0, self.weights.levels - 1).astype(np.uint8)
        return np.union1d(wanting, left)

    def count_in(self, sites: NDArray[np.int32], core: Window) -> int:
        """How many of the sites lie in the core."""
        row, column = np.divmod(sites % self.block.frame.plane, self.block.frame.width)
        inside = np.ones(sites.size, np.bool_)
        for at, part, size in zip((row - FRAME, column - FRAME), core, self.shape, strict=True):
            first, end, _ = part.indices(size)
            inside &= (at >= first) & (at < end)
        return int(inside.sum())


def _sites(labels: Field, observed: Floats | None, model: EdgeModel, origin: tuple[int, int], sure: bool) -> _Sites:
    """Frame a block: of labels that are given, or only begun with where there are observed grey values."""
    shape = (labels.shape[0], labels.shape[1])
    near = neighbourhoods(model, integrated=observed is not None)
    framed = shape[0] + 2 * FRAME, shape[1] + 2 * FRAME
    if 3 * framed[0] * framed[1] >= 2**31:
        raise ValueError(f"a block of {shape} pixels is too large: make tiles of at most 26000 pixels a side")
    state = np.full((3, *framed), UNCOMMITTED)
    exists = np.zeros(state.shape, np.bool_)
    state[X, _INNER, _INNER] = labels
    grey = _NOTHING if observed is None else np.pad(observed, FRAME, constant_values=np.nan)
    has_data = state[X] != UNCOMMITTED if observed is None else ~np.isnan(grey)
    state[X][~has_data] = UNCOMMITTED
    _existing(has_data, exists, observed is not None)
    if sure:
        _part(state[X], exists, state)
    frame = Frame(framed[0] * framed[1], framed[1], origin[0] - FRAME, origin[1] - FRAME)
    offsets, bounds = near.offsets(shape)
    ranks = np.empty(state.size, np.uint32)
    fields = state.reshape(-1), grey.reshape(-1), exists.reshape(-1)
    block = Block(*fields, offsets, ranks, bounds, energy_tables(model), frame)
    return _Sites(block, Weights.of(model, sure), near, shape)


# ------------------------------------------------------------------------------------------------- optimisers


def _parallel(sites: _Sites, rounds: int, core: Window) -> tuple[int, int]:
    stabilities, choices = np.empty(sites.block.state.size, np.float32), np.empty(sites.block.state.size, np.uint8)
    wanting = wishes(sites.block, sites.weights, stabilities, choices, False)
    made, wanting = parallel_rounds(sites.block, sites.weights, stabilities, choices, wanting, rounds)
    return made, sites.count_in(sites.commit(wanting), core)


def _classes(near: Neighbourhoods) -> list[tuple[int, int, int]]:
    """Field, colour and modulus of every class, in order."""
    pairs = zip(near.fields, near.moduli(), strict=True)
    return [(field, colour, modulus) for field, modulus in pairs for colour in range(modulus)]


def _icm(sites: _Sites, rounds: int, core: Window) -> tuple[int, int]:
    stabilities, choices = np.empty(sites.block.state.size, np.float32), np.empty(sites.block.state.size, np.uint8)
    classes = _classes(sites.near)
    made, changes = 0, 1
    while made < rounds and changes:
        changes = sum(icm_class(sites.block, sites.weights, *each, stabilities, choices) for each in classes)
        made += 1
    wanting = wishes(sites.block, sites.weights, stabilities, choices, True)
    return made, sites.count_in(wanting, core)


def _anneal(sites: _Sites, schedule: Annealing) -> None:
    seed = as_seed(schedule.seed)
    for sweep, temperature in enumerate(schedule.temperatures()):
        for each in _classes(sites.near):
            gibbs_class(sites.block, sites.weights, *each, temperature, seed, np.uint64(sweep))


def _optimise(sites: _Sites, method: Method, rounds: int, core: Window, annealing: Annealing | None) -> tuple[int, int]:
    """Minimise in place; return the rounds made and the unresolved sites of the core."""
    if rounds < 1:
        raise ValueError(f"rounds must be 1 or more, not {rounds}")
    if method == "parallel":
        return _parallel(sites, rounds, core)
    if method == "serial":
        return serial_hcf(sites.block, sites.weights), 0
    if method not in ("icm", "annealing"):
        raise ValueError(f"method must be 'parallel', 'serial', 'icm' or 'annealing', not {method!r}")
    commit_alone(sites.block, sites.weights)
    schedule = annealing or Annealing()
    if method == "annealing":
        _anneal(sites, schedule)
    made, unresolved = _icm(sites, rounds, core)
    return made + (schedule.sweeps if method == "annealing" else 0), unresolved


def line_field(
    labels: ArrayLike,
    model: EdgeModel,
    *,
    method: Method = "parallel",
    rounds: int = ROUNDS,
    origin: tuple[int, int] = (0, 0),
    core: Window = _WHOLE,
    sure: bool = True,
    annealing: Annealing | None = None,
) -> LineField:
    """Find the line elements of given labels: the sequential form's second half.

    Parameters
    ----------
    labels
        uint8, shape (rows, columns): 0..K - 1, 255 = no data.
    model
        Weights of the energy.
    method
        Optimiser, see the module.
    rounds
        Cap on the rounds of `parallel` and the sweeps of `icm`; sites that still want to change are reported as
        unresolved, and those of them that are not committed become 0 (labels the nearest to the data).
    origin
        Global (row, column) of ``labels[0, 0]``, >= 0: by it ties are broken and random numbers drawn.
    core
        Rows and columns whose unresolved sites are counted; elsewhere the block goes on for `halo` pixels.
    sure
        Whether HCF starts with 0 between equal labels.
    annealing
        Schedule of that method.

    Returns
    -------
    LineField

    Raises
    ------
    ValueError
        For labels that are not a two-dimensional array of 0..K - 1 or 255, an unknown method, fewer than 1 round.
    """
    shape = np.shape(labels)
    if len(shape) != 2:
        raise ValueError(f"labels must be two-dimensional, not of shape {shape}")
    x = checked_field("labels", labels, shape, model.levels)
    sites = _sites(x, None, model, origin, sure)
    made, unresolved = _optimise(sites, method, rounds, core, annealing)
    _, h, v = sites.fields()
    return LineField(h, v, made, unresolved)


def coupled_fields(
    observed: ArrayLike,
    model: EdgeModel,
    *,
    method: Method = "parallel",
    rounds: int = ROUNDS,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = _WHOLE,
    sure: bool = True,
    annealing: Annealing | None = None,
) -> CoupledFields:
    """Find labels and line elements at once: the integrated form.

    Parameters
    ----------
    observed
        Grey values y, shape (rows, columns), cast to float32, in units in which label k has the value k; NaN = no data.
    start
        Labels that HCF begins with, uint8, same shape, 255 = uncommitted; None: all uncommitted.  With the labels of
        `intensity_field` by messages it ends far lower; their halo then adds to this one.
    model, method, rounds, origin, core, sure, annealing
        As for `line_field`.

    Returns
    -------
    CoupledFields

    Raises
    ------
    ValueError
        For an array that is not two-dimensional and real, an unknown method, fewer than 1 round.
    """
    y = checked_observed(observed)
    x = np.full(y.shape, UNCOMMITTED) if start is None else checked_field("start", start, y.shape, model.levels)
    sites = _sites(x, y, model, origin, sure)
    made, unresolved = _optimise(sites, method, rounds, core, annealing)
    x, h, v = sites.fields()
    return CoupledFields(x, h, v, made, unresolved)
