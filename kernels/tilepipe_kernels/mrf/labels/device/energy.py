"""`label_energy` on the device: the share of every pixel."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.labels.device.stability import costs_of, weight_at
from tilepipe_kernels.mrf.labels.energy import energy_share
from tilepipe_kernels.mrf.labels.problem import Labelling


@grid
def _shares(
    count: int, unary: Any, tables: Any, down: Any, right: Any, down_weight: Any, right_weight: Any, exists: Any,
    labels: Any, stride: int, shares: Any,
) -> None:  # fmt: skip
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if exists[p]:
            own = labels[p]
            below, after = tables[down[p], labels[p + stride], own], tables[right[p], labels[p + 1], own]
            w_below, w_after = weight_at(down_weight, p), weight_at(right_weight, p)
            shares[p] = energy_share(unary[p, own], w_below, below, w_after, after)


def shares(problem: Labelling, labels: Any, into: Any) -> None:
    """Write what each pixel adds to the energy."""
    _shares(labels.size, *costs_of(problem), problem.exists, labels, problem.stride, into)
