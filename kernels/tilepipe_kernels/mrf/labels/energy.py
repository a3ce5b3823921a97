"""The energy of labels of any labelling problem on the pixel grid, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.sums import ordered_sum
from tilepipe_kernels.mrf.labels.problem import Field, Labelling, framed_labels, labelling
from tilepipe_kernels.mrf.labels.stability import weight_of


@rule
def energy_share(
    cost: np.float32, down_weight: np.float32, below: np.float32, right_weight: np.float32, after: np.float32
) -> np.float64:
    """What a pixel adds to the energy: its own cost and those of its pairs down and right, in float64."""
    pairs = np.float64(down_weight) * np.float64(below) + np.float64(right_weight) * np.float64(after)
    return np.float64(cost) + pairs


@loop
def _shares(problem: Labelling, labels: Field, shares: NDArray[np.float64]) -> None:
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    down_weight, right_weight = problem.down_weight, problem.right_weight
    for p in range(labels.size):
        if problem.exists[p]:
            own = labels[p]
            below, after = tables[down[p], labels[p + problem.stride], own], tables[right[p], labels[p + 1], own]
            weights = weight_of(down_weight, p), weight_of(right_weight, p)
            shares[p] = energy_share(unary[p, own], weights[0], below, weights[1], after)


def label_energy(
    labels: ArrayLike,
    unary: ArrayLike,
    pairwise: ArrayLike,
    *,
    down: ArrayLike | None = None,
    right: ArrayLike | None = None,
    down_weight: ArrayLike | None = None,
    right_weight: ArrayLike | None = None,
) -> float:
    """Energy that `mrf.labels.minimise.minimise` minimises: Σ U_s(x_s) + Σ w_st V_st(x_s, x_t), summed in float64.

    It is read by the host, and the same bits for arrays of a device.

    Parameters
    ----------
    labels
        x, integers (rows, columns) from 0 to K - 1; not looked at where there is no data.
    unary, pairwise, down, right, down_weight, right_weight
        The costs, as for `mrf.labels.problem.labelling`.

    Raises
    ------
    ValueError
        For costs or labels that do not fit together.

    Examples
    --------
    Taking the lone 0.9 for noise costs 0.81 at its pixel; believing it costs two borders of 0.5 and 0.01.

    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.labels.energy import label_energy
    >>> unary = (np.array([[0.0, 0.9, 0.0]])[:, :, None] - [0, 1]) ** 2
    >>> pairwise = 0.5 * (1 - np.eye(2))
    >>> round(label_energy([[0, 0, 0]], unary, pairwise), 4), round(label_energy([[0, 1, 0]], unary, pairwise), 4)
    (0.81, 1.01)
    """
    problem = labelling(unary, pairwise, down=down, right=right, down_weight=down_weight, right_weight=right_weight)
    sites = framed_labels(problem, labels, "labels")
    shares = namespace(sites).zeros(sites.size)
    find = device_form(__name__).shares if on_device(sites) else _shares
    find(problem, sites, shares)
    return ordered_sum(shares)
