"""Labels of an image given its grey values: the intensity field of `mrf.edge_model` (`edges`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device, to_device
from tilepipe_kernels.core.compiled import device_form, loop
from tilepipe_kernels.mrf.edge_model import EdgeModel, Field, Floats, checked_elements, checked_observed, data_energy
from tilepipe_kernels.mrf.labels.minimise import minimised
from tilepipe_kernels.mrf.labels.problem import EVERYWHERE, Labelling, Labels, Window, framed_costs, framed_labelling
from tilepipe_kernels.mrf.search import DEFAULT, Search


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
    search: Search = DEFAULT,
    start: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
    core: Window = EVERYWHERE,
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
    search, start, origin, core
        As for `minimise`.

    Returns
    -------
    Labels

    Raises
    ------
    ValueError
        For arrays that do not fit together; for the serial form of an array of a device.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
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
    return minimised(problem, search, start, core)
