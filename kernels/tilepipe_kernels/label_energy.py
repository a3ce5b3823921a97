"""The energy of labels of any labelling problem on the pixel grid, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .compiled import loop
from .label_stability import weight_of
from .labelling import Field, Labelling, framed_labels, labelling


@loop
def _energy(problem: Labelling, labels: Field) -> float:
    total = 0.0
    for p in range(labels.size):
        if problem.exists[p]:
            own = labels[p]
            below = np.float64(problem.tables[problem.down[p], labels[p + problem.stride], own])
            after = np.float64(problem.tables[problem.right[p], labels[p + 1], own])
            total += problem.unary[p, own]
            total += weight_of(problem.down_weight, p) * below + weight_of(problem.right_weight, p) * after
    return total


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
    """Energy that `intensity_field.minimise` minimises: Σ U_s(x_s) + Σ w_st V_st(x_s, x_t), summed in float64.

    Parameters
    ----------
    labels
        x, integers (rows, columns) from 0 to K - 1; not looked at where there is no data.
    unary, pairwise, down, right, down_weight, right_weight
        The costs, as for `labelling.labelling`.

    Raises
    ------
    ValueError
        For costs or labels that do not fit together.
    """
    problem = labelling(
        unary, pairwise, down=down, right=right, down_weight=down_weight, right_weight=right_weight
    )  # fmt: skip
    return float(_energy(problem, framed_labels(problem, labels, "labels")))
