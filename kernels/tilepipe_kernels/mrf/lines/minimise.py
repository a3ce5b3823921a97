"""Line elements given labels, and labels and elements at once, by minimising the energy of `mrf.edge_model` (`edges`).

All optimisers change one site at a time as far as the energy can tell: sites that change at once share no term.

HCF starts with sites uncommitted, of which no term speaks.  To a lone element between equal labels 0 and 1 are worth
the same, so that it would be committed last, by ties, when all edges are drawn.  But the labels already say that
there is nothing to part: such an element is *sure* and becomes 0 at once.  On photographs that ends in an energy 3 to
9 % lower than without (``sure=False``, the form of the papers), with a third of the edges and of the rounds.

Arrays of a device stay there, with the very elements of the host; only the serial form has none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tilepipe_kernels.core.arrays import as_array, namespace, on_device
from tilepipe_kernels.mrf.edge_model import UNCOMMITTED, EdgeModel, Field, Window, checked_field, checked_observed
from tilepipe_kernels.mrf.lines.energies import wanting_marks
from tilepipe_kernels.mrf.lines.framed import FramedSites, framed_sites
from tilepipe_kernels.mrf.lines.hcf import parallel_hcf, serial_hcf
from tilepipe_kernels.mrf.lines.sites import neighbourhoods
from tilepipe_kernels.mrf.lines.sweeps import classes_of, commit_alone, gibbs_sweeps, icm_sweeps
from tilepipe_kernels.mrf.search import DEFAULT, Search

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


def halo(model: EdgeModel, search: Search = DEFAULT, *, integrated: bool = False) -> int:
    """Pixels around a block's core that its result depends on.

    In a round of `parallel` a site looks at the stabilities of its neighbours, which look at theirs; in a sweep of
    the others each colour class looks at the one before.

    Parameters
    ----------
    model, search, integrated
        As for `line_field`, or `coupled_fields` if integrated.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        For the serial form, in which a site may depend on any other, and for messages.

    Examples
    --------
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.lines.minimise import halo
    >>> from tilepipe_kernels.mrf.search import Search
    >>> halo(EdgeModel(), Search(rounds=8))
    33
    >>> halo(EdgeModel(), Search(rounds=8), integrated=True)
    33
    """
    _refuse_messages(search)
    near = neighbourhoods(model, integrated=integrated)
    if search.method == "serial":
        raise ValueError("serial HCF has no halo: it needs the whole raster in one block")
    if search.method == "parallel":
        return 2 * near.reach * search.rounds + 1
    sweeps = search.rounds + (search.annealing.sweeps if search.method == "annealing" else 0)
    return near.reach * sum(near.moduli()) * sweeps + 1


# ------------------------------------------------------------------------------------------------- optimisers


def _refuse_messages(search: Search) -> None:
    if search.method == "messages":
        raise ValueError("messages are between labels: use the method parallel, serial, icm or annealing for lines")


def _descend(sites: FramedSites, search: Search, core: Window) -> tuple[int, int]:
    """Sweeps of icm, of annealing before if that is the method."""
    block, weights, classes = sites.block, sites.weights, classes_of(sites.near)
    commit_alone(block, weights)
    made = 0
    if search.method == "annealing":
        gibbs_sweeps(block, weights, classes, search.annealing)
        made = search.annealing.sweeps
    made += icm_sweeps(block, weights, classes, search.rounds)
    return made, sites.count_in(wanting_marks(block, weights), core)


def _optimise(sites: FramedSites, search: Search, core: Window) -> tuple[int, int]:
    """Minimise in place; return the rounds made and the unresolved sites of the core."""
    _refuse_messages(search)
    if search.method == "serial":
        if on_device(sites.block.state):
            raise ValueError("serial HCF runs on the host alone: move arrays there by to_host, or use another method")
        return serial_hcf(sites.block, sites.weights), 0
    if search.method == "parallel":
        made, wanting = parallel_hcf(sites.block, sites.weights, search.rounds)
        return made, sites.count_in(sites.commit(wanting), core)
    return _descend(sites, search, core)


def line_field(
    labels: ArrayLike,
    model: EdgeModel,
    *,
    search: Search = DEFAULT,
    origin: tuple[int, int] = (0, 0),
    core: Window = _WHOLE,
) -> LineField:
    """Find the line elements of given labels: the sequential form's second half.

    Parameters
    ----------
    labels
        uint8, shape (rows, columns): 0..K - 1, 255 = no data.
    model
        Weights of the energy.
    search
        Method, not messages, and its options.  Sites that still want to change after its rounds are reported as
        unresolved, and those of them that are not committed become 0 (labels the nearest to the data).
    origin
        Global (row, column) of ``labels[0, 0]``, >= 0: by it ties are broken and random numbers drawn.
    core
        Rows and columns whose unresolved sites are counted; elsewhere the block goes on for `halo` pixels.

    Returns
    -------
    LineField

    Raises
    ------
    ValueError
        For labels that are not a two-dimensional array of 0..K - 1 or 255, and for messages.

    Examples
    --------
    The crack between columns 1 and 2, where labels change by 3, becomes an edge from top to bottom.

    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.lines.minimise import line_field
    >>> labels = np.array([[0, 0, 3, 3], [0, 0, 3, 3], [0, 0, 3, 3]], np.uint8)
    >>> line_field(labels, EdgeModel(levels=4)).vertical
    array([[0, 1, 0, 0],
           [0, 1, 0, 0],
           [0, 1, 0, 0]], dtype=uint8)
    """
    shape = as_array(labels).shape
    if len(shape) != 2:
        raise ValueError(f"labels must be two-dimensional, not of shape {shape}")
    x = checked_field("labels", labels, shape, model.levels)
    sites = framed_sites(x, None, model, origin, search.sure)
    made, unresolved = _optimise(sites, search, core)
    _, h, v = sites.fields()
    return LineField(h, v, made, unresolved)


def coupled_fields(
    observed: ArrayLike,
    model: EdgeModel,
    *,
    search: Search = DEFAULT,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = _WHOLE,
) -> CoupledFields:
    """Find labels and line elements at once: the integrated form.

    Parameters
    ----------
    observed
        Grey values y, shape (rows, columns), cast to float32, in units in which label k has the value k; NaN = no data.
    start
        Labels that HCF begins with, uint8, same shape, 255 = uncommitted; None: all uncommitted.  With the labels of
        `intensity_field` by messages it ends far lower; their halo then adds to this one.
    model, search, origin, core
        As for `line_field`.

    Returns
    -------
    CoupledFields

    Raises
    ------
    ValueError
        For an array that is not two-dimensional and real, and for messages.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.lines.minimise import coupled_fields
    >>> grey = np.array([[0.1, 0.0, 2.9, 3.1], [0.0, 0.3, 3.0, 2.9], [0.1, 0.0, 3.0, 3.2]])
    >>> fields = coupled_fields(grey, EdgeModel(levels=4))
    >>> fields.labels.tolist()
    [[0, 0, 3, 3], [0, 0, 3, 3], [0, 0, 3, 3]]
    >>> fields.vertical.tolist()
    [[0, 1, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]]
    """
    y = checked_observed(observed)
    x = (
        namespace(y).full(y.shape, UNCOMMITTED, dtype=np.uint8)
        if start is None
        else checked_field("start", start, y.shape, model.levels)
    )
    sites = framed_sites(x, y, model, origin, search.sure)
    made, unresolved = _optimise(sites, search, core)
    x, h, v = sites.fields()
    return CoupledFields(x, h, v, made, unresolved)
