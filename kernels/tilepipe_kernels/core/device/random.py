"""`random` on the device: the same rules, hence the same words, uniforms and normals."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.random import normal, uniform


@grid
def fill_normals(count: int, sites: Any, seed: np.uint64, sweep: np.uint64, stream: np.uint64, result: Any) -> None:
    """Write the `normal` of each site into `result`."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        result[p] = normal(seed, np.uint64(sites[p]), sweep, stream)


@grid
def fill_uniforms(count: int, sites: Any, seed: np.uint64, sweep: np.uint64, stream: np.uint64, result: Any) -> None:
    """Write the `uniform` of each site into `result`."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        result[p] = uniform(seed, np.uint64(sites[p]), sweep, stream)
