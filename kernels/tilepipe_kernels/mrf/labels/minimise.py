"""Labels of an image given its grey values, and of any labelling problem on the pixel grid (`edges`).

- parallel: Highest Confidence First (HCF) in rounds (Swain & Wixson 1992); the default.
- serial: HCF with a heap (Chou & Brown 1990): the least stable site of all is next.
- icm: iterated conditional modes (Besag 1986), one colour of the checkerboard after the other, from the labels of
  least unary cost.
- annealing: Gibbs sampler (Geman & Geman 1984) over the colours at falling temperatures, then rounds of descent.
- messages: reweighted messages (Wainwright et al. 2005) decide, then rounds of descent.  With many labels or much
  noise this ends far lower than HCF, as low as graph cuts do.  Weak data, where the labels of wide areas hang on
  what is far from them (stereo, segmentation), take messages on coarser grids too: with 32 rounds and 3 scales,
  stereo of 16 labels ends within a hundredth or two of α-expansion where HCF ends two to four times as high; the halo
  is then 536 pixels.

All but the serial form are local: a result depends on the block within `halo` pixels and on the global place alone.
They take arrays of a device too, which stay there; the labels are those of the CPU, bit for bit.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device, to_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_model import EdgeModel, Field, Floats, checked_elements, checked_observed, data_energy
from tilepipe_kernels.mrf.labels.hcf import parallel_rounds, serial_changes
from tilepipe_kernels.mrf.labels.messages import message_labels
from tilepipe_kernels.mrf.labels.problem import (
    EVERYWHERE,
    Labelling,
    Labels,
    Window,
    as_result,
    framed_costs,
    framed_labelling,
    framed_labels,
    labelling,
)
from tilepipe_kernels.mrf.labels.scales import reach
from tilepipe_kernels.mrf.labels.stability import cheapest_labels, wanting_sites
from tilepipe_kernels.mrf.labels.sweeps import anneal, iterated_modes

Method = Literal["parallel", "serial", "icm", "annealing", "messages"]

ROUNDS = 24
"""Cap on rounds, within which next to no site of a photograph still wants to change."""

MESSAGES = 16
"""Rounds of messages after which the energy hardly falls where the data are strong."""

LARGEST_SCALES = 10


def halo(
    rounds: int = ROUNDS, *, method: Method = "parallel", annealing: Annealing | None = None,
    messages: int = MESSAGES, scales: int = 0,
) -> int:  # fmt: skip
    """Pixels around a block's core that its result depends on.

    In a round of HCF a site looks at the stabilities of its neighbours, which look at theirs; in a sweep the second
    colour looks at the first; a message goes one pixel a round, and twice as far on each coarser grid.

    Raises
    ------
    ValueError
        For the serial form, in which a site may depend on any other.

    Examples
    --------
    >>> from tilepipe_kernels.mrf.labels.minimise import halo
    >>> halo(rounds=10), halo(rounds=10, method="icm")
    (21, 21)
    >>> halo(rounds=10, method="serial")
    Traceback (most recent call last):
        ...
    ValueError: serial HCF has no halo: it needs the whole raster in one block
    """
    if method == "serial":
        raise ValueError("serial HCF has no halo: it needs the whole raster in one block")
    _check(method, rounds, messages, scales)
    before = {"annealing": 2 * (annealing or Annealing()).sweeps, "messages": reach(messages, scales)}.get(method, 0)
    return 2 * rounds + before + 1


def _check(method: Method, rounds: int, messages: int, scales: int) -> None:
    if method not in get_args(Method):
        raise ValueError(f"method must be one of {', '.join(get_args(Method))}, not {method!r}")
    if not 1 <= rounds < 2**16:
        raise ValueError(f"rounds must be from 1 to 65535, not {rounds}")
    if messages < 1:
        raise ValueError(f"messages must be 1 round or more, not {messages}")
    if not 0 <= scales <= LARGEST_SCALES:
        raise ValueError(f"scales must be from 0 to {LARGEST_SCALES} coarser grids, not {scales}")


# ------------------------------------------------------------------------------------------------- optimisers


def _optimise(
    problem: Labelling, method: Method, rounds: int, start: ArrayLike | None, core: Window,
    annealing: Annealing | None, messages: int, scales: int,
) -> Labels:  # fmt: skip
    _check(method, rounds, messages, scales)
    sites = framed_labels(problem, start)
    if method == "serial":
        if on_device(sites):
            raise ValueError("serial HCF is for arrays of the host; move them there, or use the method parallel")
        changes = serial_changes(problem, sites)
        return as_result(problem, sites, changes, np.empty(0, np.int32), core)
    if method == "messages":
        sites = message_labels(problem, messages, scales)
    elif start is None and method != "parallel":
        cheapest_labels(problem, sites)
    if method == "icm":
        done = iterated_modes(problem, sites, rounds)
        return as_result(problem, sites, done, wanting_sites(problem, sites), core)
    if method == "annealing":
        anneal(problem, sites, annealing or Annealing())
    done, wanting = parallel_rounds(problem, sites, rounds)
    return as_result(problem, sites, done, wanting, core)


def minimise(
    unary: ArrayLike,
    pairwise: ArrayLike,
    *,
    down: ArrayLike | None = None,
    right: ArrayLike | None = None,
    down_weight: ArrayLike | None = None,
    right_weight: ArrayLike | None = None,
    method: Method = "parallel",
    rounds: int = ROUNDS,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = EVERYWHERE,
    annealing: Annealing | None = None,
    messages: int = MESSAGES,
    scales: int = 0,
) -> Labels:
    """Minimise Σ U_s(x_s) + Σ w_st V_st(x_s, x_t) over the labels of pixels and pairs of 4-adjacent ones.

    `tilepipe_kernels.mrf.labels.energy.label_energy` gives the energy of a result.

    Parameters
    ----------
    unary
        U, real, shape (rows, columns, K), K from 2 to 254, computed in float32: cost of each label of each pixel.  A
        pixel with ONE label of NaN has no data at all: it takes no label and has no pairs.  For a label that a pixel
        cannot have, give a large finite cost instead, such as 1e6; infinite ones are refused.
    pairwise
        V, shape (K, K), finite and symmetric: cost of the labels of two pixels side by side.  Or (T, K, K), several.
    down, right, down_weight, right_weight
        Shape (rows, columns): which table the pair of each pixel and the one below, or right of it, takes (the first
        unless given), and weights w >= 0 of these pairs (1 unless given): contrast-sensitive smoothness, say.  See
        `tilepipe_kernels.mrf.labels.problem.labelling`.
    origin
        Global row and column of the block's first pixel: by it ties are broken and random numbers drawn.
    method
        Optimiser:

        - ``parallel``: Highest Confidence First (HCF) in rounds; the fastest, for strong data.
        - ``messages``: reweighted messages, then rounds of descent; the lowest energies, with many labels, much
          noise or weak data above all.
        - ``icm``: iterated conditional modes; the simplest, it often ends highest.
        - ``annealing``: Gibbs sampler at falling temperatures, then rounds of descent; slow, and needs `annealing`.
        - ``serial``: HCF with a heap, of arrays of the host alone; it has no `halo`, so that tiles would show.
    rounds
        Cap on the rounds of HCF and of descent, and on the sweeps of icm.
    start
        uint8 (rows, columns): labels to descend from; None: uncommitted for HCF, those of least unary cost for icm
        and annealing.  `messages` do without.
    core
        Rows and columns whose unresolved pixels are counted; elsewhere the block goes on for `halo` pixels.
    annealing
        Schedule of that method, `tilepipe_kernels.mrf.annealing.Annealing`: ``Annealing(sweeps=100, hot=1.0, cold=0.05,
        seed=0)`` unless given.  Temperatures are in units of the energy: with costs of about 20 a start at 1 is
        nearly a quench, so `hot` should be of the size of the cost of one pair of unequal labels.
    messages
        Rounds of messages of that method, on each grid.
    scales
        Coarser grids of blocks of 2, 4, 8, … pixels that messages go over first.  0 does for strong data; weak data
        take 3 with 32 rounds.  All of them together cost a third more time; each doubles the halo.

    Returns
    -------
    Labels
        `tilepipe_kernels.mrf.labels.problem.Labels` with the fields ``labels``, uint8 (rows, columns), 0 to K - 1 and
        255 = no data; ``rounds`` made, of HCF or descent, or sweeps of icm (of the serial form: changes);
        ``unresolved``, how many pixels of the core still wanted to change then, 0 = a local minimum.

    Raises
    ------
    ValueError
        For costs that do not fit together or are not finite, an unknown method, a number of rounds below 1, scales
        below 0; for the serial form of arrays of a device.

    Examples
    --------
    Two labels, of grey value 0 and 1, and a cost of 0.5 where neighbours differ: the lone 0.9 is taken for noise.

    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.labels.minimise import minimise
    >>> grey = np.array([[0.1, 0.9, 0.0, 1.0], [0.0, 0.2, 0.1, 0.8]])
    >>> unary = (grey[:, :, None] - [0, 1]) ** 2
    >>> minimise(unary, 0.5 * (1 - np.eye(2))).labels
    array([[0, 0, 0, 1],
           [0, 0, 0, 1]], dtype=uint8)
    """
    problem = labelling(
        unary, pairwise, down=down, right=right, down_weight=down_weight, right_weight=right_weight, origin=origin
    )
    return _optimise(problem, method, rounds, start, core, annealing, messages, scales)


# ------------------------------------------------------------------------------------------------- images


@loop
def _fill_unary(unary: NDArray[np.float32], observed: Floats, sigma: np.float32) -> None:
    for i in range(observed.shape[0]):
        for j in range(observed.shape[1]):
            if not np.isnan(observed[i, j]):
                for label in range(unary.shape[2]):
                    unary[i + 1, j + 1, label] = data_energy(observed[i, j], np.float32(label), sigma)


def _image_labelling(
    observed: Floats, model: EdgeModel, elements: tuple[Field, Field], origin: tuple[int, int]
) -> Labelling:
    """Problem of the intensity field; pairs parted by an element of 0 pay for their contrast."""
    rows, columns = observed.shape
    if (rows + 2) * (columns + 2) >= 2**31:
        raise ValueError(f"a block of {observed.shape} pixels is too large: make tiles of at most 46000 pixels a side")
    xp = namespace(observed)
    unary = framed_costs(rows, columns, model.levels, observed)
    fill = device_form(__name__).fill_unary if on_device(observed) else _fill_unary
    fill(unary, observed, np.float32(model.sigma))
    label = np.arange(model.levels, dtype=np.float32)
    contrast = np.float32(model.alpha) * (label[:, None] - label) ** 2
    free = model.pairwise()
    tables = np.stack([free, free + contrast])
    kinds = tuple((field == 0).astype(xp.uint8) for field in elements)
    if not any(bool(kind.any()) for kind in kinds):
        tables = tables[:1]
    tables = to_device(tables) if on_device(observed) else tables
    return framed_labelling(unary, ~xp.isnan(observed), tables, kinds, origin)


def intensity_field(
    observed: ArrayLike,
    model: EdgeModel,
    *,
    horizontal: ArrayLike | None = None,
    vertical: ArrayLike | None = None,
    method: Method = "parallel",
    rounds: int = ROUNDS,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = EVERYWHERE,
    annealing: Annealing | None = None,
    messages: int = MESSAGES,
    scales: int = 0,
) -> Labels:
    """Find the labels of an image by minimising the energy of `edge_model` over them.

    Parameters
    ----------
    observed
        Grey values y in units of labels, shape (rows, columns), real, computed in float32; NaN = no data.
    model
        Parameters of the energy.
    horizontal, vertical
        Line elements, uint8 of the same shape: where they are 0 the labels also pay for their contrast.  None: no
        element is committed, as in the first half of the sequential form.
    method, rounds, start, origin, core, annealing, messages, scales
        As for `minimise`.

    Returns
    -------
    Labels

    Raises
    ------
    ValueError
        For arrays that do not fit together, an unknown method, a number of rounds below 1; for the serial form of
        an array of a device.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.labels.minimise import intensity_field
    >>> grey = np.array([[0.1, 0.0, 0.9, 1.1], [0.0, 0.6, 1.0, 0.9], [0.1, 0.0, 1.0, np.nan]])
    >>> intensity_field(grey, EdgeModel(levels=2)).labels
    array([[  0,   0,   1,   1],
           [  0,   1,   1,   1],
           [  0,   0,   1, 255]], dtype=uint8)
    """
    y = checked_observed(observed)
    if bool(namespace(y).isinf(y).any()):
        raise ValueError("observed must be finite, or NaN where there is no data")
    problem = _image_labelling(y, model, checked_elements(horizontal, vertical, y), origin)
    return _optimise(problem, method, rounds, start, core, annealing, messages, scales)
