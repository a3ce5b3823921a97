"""How site rules and loops are compiled, and how a local kernel runs over one large array.

A *rule* is a scalar function of the values at one site and holds a formula once.  A *loop* walks the sites of a
block on the CPU and calls rules.  The CUDA form of a kernel calls the very same rules from a grid of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., Any])


def rule(function: Function) -> Function:
    """Compile a scalar site rule: scalars in, scalars out, no arrays, no fast-math, so that every backend agrees."""
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def loop(function: Function) -> Function:
    """Compile a serial CPU loop that releases the GIL; it must stand at module level to be found in the disk cache."""
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def in_bands(
    function: Callable[..., NDArray[Any]], arrays: Sequence[NDArray[Any]], halo: int, workers: int
) -> NDArray[Any]:
    """Run a local kernel over row bands of one large array in threads.

    Parameters
    ----------
    function
        Called as ``function(*bands, first_row)`` with the bands of ``arrays`` padded by ``halo`` rows where the array
        has them, and the global row of the band's first row; returns an array with the band's number of rows.
    arrays
        Arrays of equal shape (rows, columns).
    halo
        Rows that the kernel needs on each side, in pixels.
    workers
        Number of threads and of bands; 1 runs in the caller's thread.

    Returns
    -------
    ndarray
        The bands' cores put together, shape (rows, ...).
    """
    rows = arrays[0].shape[0]
    edges = np.linspace(0, rows, min(workers, rows) + 1).astype(int)
    spans = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))

    def run(span: tuple[int, int]) -> NDArray[Any]:
        start, stop = span
        low, high = max(0, start - halo), min(rows, stop + halo)
        result = function(*(array[low:high] for array in arrays), low)
        return result[start - low : stop - low]

    if len(spans) == 1:
        return run(spans[0])
    with ThreadPoolExecutor(len(spans)) as pool:
        return np.concatenate(list(pool.map(run, spans)))
