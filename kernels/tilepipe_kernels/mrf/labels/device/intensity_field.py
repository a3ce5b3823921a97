"""`intensity_field` on the device: the costs of an image."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.edge_model import data_energy


@grid
def _fill_planes(count: int, planes: Any, observed: Any, sigma: np.float32) -> None:
    columns = observed.shape[1]
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        y = observed[i, j]
        if not math.isnan(y):
            for label in range(planes.shape[0]):
                planes[label, i + 1, j + 1] = data_energy(y, np.float32(label), sigma)


def fill_unary(unary: Any, observed: Any, sigma: np.float32) -> None:
    """Write the costs of the labels of each pixel into a framed block of zeros."""
    _fill_planes(observed.size, unary.transpose(2, 0, 1), observed, sigma)
