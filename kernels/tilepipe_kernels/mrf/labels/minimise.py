"""Labels of least energy, of any labelling problem on the pixel grid.

Weak data, where the labels of wide areas hang on what is far from them (stereo, segmentation), take messages on coarser
grids too: with 32 rounds and 3 scales, stereo of 16 labels ends within a hundredth or two of α-expansion where HCF ends
two to four times as high; the halo is then 536 pixels.

All methods of a `Search` but the serial one are local: a result depends on the block within `halo` pixels and on the
global place alone.  They take arrays of a device too, which stay there; the labels are those of the CPU, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.mrf.labels.hcf import parallel_rounds, serial_changes
from tilepipe_kernels.mrf.labels.messages import message_labels
from tilepipe_kernels.mrf.labels.problem import (
    EVERYWHERE,
    Labelling,
    Labels,
    Window,
    as_result,
    framed_labels,
    labelling,
)
from tilepipe_kernels.mrf.labels.scales import reach
from tilepipe_kernels.mrf.labels.stability import cheapest_labels, wanting_sites
from tilepipe_kernels.mrf.labels.sweeps import anneal, iterated_modes
from tilepipe_kernels.mrf.search import DEFAULT, Search


def halo(search: Search = DEFAULT) -> int:
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
    >>> from tilepipe_kernels.mrf.search import Search
    >>> halo(Search(rounds=10)), halo(Search("icm", rounds=10))
    (21, 21)
    >>> halo(Search("serial"))
    Traceback (most recent call last):
        ...
    ValueError: serial HCF has no halo: it needs the whole raster in one block
    """
    if search.method == "serial":
        raise ValueError("serial HCF has no halo: it needs the whole raster in one block")
    before = {"annealing": 2 * search.annealing.sweeps, "messages": reach(search.messages, search.scales)}
    return 2 * search.rounds + before.get(search.method, 0) + 1


def minimised(problem: Labelling, search: Search, start: ArrayLike | None, core: Window) -> Labels:
    """Labels of a problem; arguments as for `minimise`."""
    sites = framed_labels(problem, start)
    if search.method == "serial":
        if on_device(sites):
            raise ValueError("serial HCF is for arrays of the host; move them there, or use the method parallel")
        changes = serial_changes(problem, sites)
        return as_result(problem, sites, changes, np.empty(0, np.int32), core)
    if search.method == "messages":
        sites = message_labels(problem, search.messages, search.scales)
    elif start is None and search.method != "parallel":
        cheapest_labels(problem, sites)
    if search.method == "icm":
        done = iterated_modes(problem, sites, search.rounds)
        return as_result(problem, sites, done, wanting_sites(problem, sites), core)
    if search.method == "annealing":
        anneal(problem, sites, search.annealing)
    done, wanting = parallel_rounds(problem, sites, search.rounds)
    return as_result(problem, sites, done, wanting, core)


def minimise(
    unary: ArrayLike,
    pairwise: ArrayLike,
    *,
    down: ArrayLike | None = None,
    right: ArrayLike | None = None,
    down_weight: ArrayLike | None = None,
    right_weight: ArrayLike | None = None,
    search: Search = DEFAULT,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = EVERYWHERE,
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
    search
        Method and its options; temperatures of annealing are in units of the energy: with costs of about 20 a start at
        1 is nearly a quench, so ``hot`` should be of the size of the cost of one pair of unequal labels.
    start
        uint8 (rows, columns): labels to descend from; None: uncommitted for HCF, those of least unary cost for icm
        and annealing.  Messages do without.
    core
        Rows and columns whose unresolved pixels are counted; elsewhere the block goes on for `halo` pixels.

    Returns
    -------
    Labels
        `tilepipe_kernels.mrf.labels.problem.Labels` with the fields ``labels``, uint8 (rows, columns), 0 to K - 1 and
        255 = no data; ``rounds`` made, of HCF or descent, or sweeps of icm (of the serial form: changes);
        ``unresolved``, how many pixels of the core still wanted to change then, 0 = a local minimum.

    Raises
    ------
    ValueError
        For costs that do not fit together or are not finite; for the serial form of arrays of a device.

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
    return minimised(problem, search, start, core)
