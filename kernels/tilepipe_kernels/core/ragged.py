"""Ragged arrays: runs of rows of one flat array, run i being the rows from ``offsets[i]`` to ``offsets[i + 1]``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.compiled import loop

Int64 = NDArray[np.int64]


def offsets_of(sizes: ArrayLike) -> Int64:
    """Offsets of runs of these sizes, or numbers of the marked rows before each row: int64, shape (n + 1,).

    Examples
    --------
    >>> from tilepipe_kernels.core.ragged import offsets_of
    >>> offsets_of([2, 3]).tolist(), offsets_of([True, False, True]).tolist()
    ([0, 2, 5], [0, 1, 1, 2])
    """
    sizes = np.asarray(sizes)
    offsets = np.zeros(sizes.size + 1, np.int64)
    np.cumsum(sizes, out=offsets[1:])
    return offsets


def run_of_rows(offsets: Int64) -> Int64:
    """Number of the run of each row, int64."""
    return np.repeat(np.arange(offsets.size - 1), np.diff(offsets))


def reduce_runs(function: np.ufunc, values: NDArray[Any], offsets: Int64, dtype: Any = None) -> NDArray[Any]:
    """One value of each run, of which none is empty, by a function such as `numpy.add`; shape (n,).

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.ragged import reduce_runs
    >>> reduce_runs(np.maximum, np.array([4, 1, 2, 3, 5]), np.array([0, 2, 5])).tolist()
    [4, 5]
    """
    if offsets.size == 1:
        return np.empty(0, values.dtype if dtype is None else dtype)
    return function.reduceat(values, offsets[:-1], dtype=dtype)


@loop
def take_runs(order: NDArray[Any], offsets: Int64, rows: NDArray[Any]) -> tuple[Int64, NDArray[Any]]:
    """Some of the runs in a given order.

    Parameters
    ----------
    order
        Integers, shape (k,): numbers of the runs.
    offsets
        int64, shape (n + 1,).
    rows
        Shape (m,) or (m, columns).

    Returns
    -------
    offsets, rows
        Of the k runs; int64, shape (k + 1,), and of the dtype given.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.ragged import take_runs
    >>> offsets, rows = take_runs(np.array([1, 0]), np.array([0, 2, 5]), np.array([4, 1, 2, 3, 5]))
    >>> offsets.tolist(), rows.tolist()
    ([0, 3, 5], [2, 3, 5, 4, 1])
    """
    bounds = np.zeros(len(order) + 1, np.int64)
    for i, run in enumerate(order):
        bounds[i + 1] = bounds[i] + offsets[run + 1] - offsets[run]
    taken = np.empty((bounds[-1], *rows.shape[1:]), rows.dtype)
    for i, run in enumerate(order):
        taken[bounds[i] : bounds[i + 1]] = rows[offsets[run] : offsets[run + 1]]
    return bounds, taken
