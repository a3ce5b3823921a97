"""`edge_energy` on the device: a thread for every piece of a row."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.edge_energy import PIECE, corners_of, difference, known, squared_residual, unparted_square
from tilepipe_kernels.mrf.edge_model import breaks_off, crowds

_NOTHING = np.int64(0)


@grid
def _existing(count: int, horizontal: Any, vertical: Any, observed: Any, h: Any, v: Any) -> None:
    rows, columns = observed.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        if not math.isnan(observed[i, j]):
            if i + 1 < rows and not math.isnan(observed[i + 1, j]):
                h[i + 2, j + 2] = horizontal[i, j]
            if j + 1 < columns and not math.isnan(observed[i, j + 1]):
                v[i + 2, j + 2] = vertical[i, j]


def existing(horizontal: Any, vertical: Any, observed: Any, h: Any, v: Any) -> None:
    """Write the elements that exist into framed fields."""
    _existing(observed.size, horizontal, vertical, observed, h, v)


@grid
def _count_lines(count: int, h: Any, v: Any, top: int, left: int, right: int, pieces: int, counts: Any) -> None:
    for thread in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, first = top + 2 + thread // pieces, left + 2 + thread % pieces * PIECE
        broken = corners = crowded = _NOTHING
        for j in range(first, min(first + PIECE, right + 2)):
            broken += breaks_off(h[i, j - 1], h[i, j], h[i, j + 1]) + breaks_off(v[i - 1, j], v[i, j], v[i + 1, j])
            corners += corners_of(h[i - 1, j], h[i, j], v[i, j - 1], v[i, j])
            crowded += crowds(h[i - 1, j], h[i, j], h[i + 1, j]) + crowds(v[i, j - 1], v[i, j], v[i, j + 1])
        cuda.atomic.add(counts, 1, broken)
        cuda.atomic.add(counts, 2, corners)
        cuda.atomic.add(counts, 3, crowded)


@grid
def _count_pairs(
    count: int, observed: Any, labels: Any, h: Any, v: Any, top: int, left: int, right: int, differences: Any,
    counts: Any, squares: Any,
) -> None:  # fmt: skip
    rows, columns = labels.shape
    pieces = squares.shape[1]
    for thread in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, first = top + thread // pieces, left + thread % pieces * PIECE
        total = 0.0
        equal = unparted = _NOTHING
        for j in range(first, min(first + PIECE, right)):
            if not known(labels[i, j], observed[i, j]):
                continue
            total += squared_residual(observed[i, j], labels[i, j])
            for side in range(2):
                other, beside = (i + 1, j) if side == 0 else (i, j + 1)
                if other < rows and beside < columns and known(labels[other, beside], observed[other, beside]):
                    d = difference(labels[i, j], labels[other, beside])
                    unparted += unparted_square(d, h[i + 2, j + 2] if side == 0 else v[i + 2, j + 2])
                    # most labels are those of their neighbours: these do not queue up
                    if d == 0:
                        equal += 1
                    else:
                        cuda.atomic.add(differences, d, 1)
        squares[thread // pieces, thread % pieces] = total
        cuda.atomic.add(differences, 0, equal)
        cuda.atomic.add(counts, 0, unparted)


def count(
    observed: Any, labels: Any, h: Any, v: Any, bounds: tuple[int, int, int, int], differences: Any, counts: Any,
    squares: Any,
) -> None:  # fmt: skip
    """See `edge_energy._count`."""
    top, _, left, right = bounds
    _count_pairs(squares.size, observed, labels, h, v, top, left, right, differences, counts, squares)
    _count_lines(squares.size, h, v, top, left, right, squares.shape[1], counts)
