"""The steps of `ground` on the device: a thread for each pixel or each coarse cell.

Results of rules are made float32 where another rule takes them: a simulated grid would pass them on as 64 bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.heights.ground import Steps
from tilepipe_kernels.heights.ground_loops import (
    FEW,
    MISSING,
    add_ground,
    between_columns,
    between_rows,
    corner,
    ground_band,
    mean_of_present,
    share,
    two_lowest,
)

_ZERO = np.float32(0)


@grid
def _lowest_in_line(count: int, out: Any, values: Any, length: int, step: int, half_width: int) -> None:
    """Minimum of 2 half_width + 1 neighbours in lines of `length` pixels that lie `step` apart."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        place = p // step % length
        lowest = values[p]
        for d in range(-min(place, half_width), min(length - 1 - place, half_width) + 1):
            lowest = min(lowest, values[p + d * step])
        out[p] = lowest


@grid
def _lowest_of_cells(count: int, low: Any, dsm: Any, side: int, row_shift: int, column_shift: int) -> None:
    rows, columns = dsm.shape
    across = low.shape[1]
    for cell in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = cell // across, cell % across
        first, second, number = MISSING, MISSING, 0
        for y in range(max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)):
            for x in range(max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)):
                first, second, number = two_lowest(first, second, number, dsm[y, x])
        low[i, j] = second if number >= FEW else first


@grid
def _mean_of_cells(
    count: int, mean: Any, low: Any, surface: Any, dsm: Any, most: np.float32, side: int, row_shift: int,
    column_shift: int,
) -> None:  # fmt: skip
    rows, columns = dsm.shape
    down, across = low.shape
    for cell in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = cell // across, cell % across
        if mean[i, j] == MISSING:
            continue
        north, south = surface[max(0, i - 1), j], surface[min(down - 1, i + 1), j]
        west, east = surface[i, max(0, j - 1)], surface[i, min(across - 1, j + 1)]
        lowest, band = low[i, j], np.float32(ground_band(north, south, west, east, most))
        total, number = _ZERO, _ZERO
        for y in range(max(0, i * side - row_shift), min(rows, (i + 1) * side - row_shift)):
            for x in range(max(0, j * side - column_shift), min(columns, (j + 1) * side - column_shift)):
                total, number = add_ground(np.float32(total), np.float32(number), dsm[y, x] - lowest, band)
        mean[i, j] = lowest + np.float32(total) / np.float32(number)


@grid
def _pull(count: int, coarse: Any, fine: Any) -> None:
    across = coarse.shape[1]
    for cell in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = 2 * (cell // across), 2 * (cell % across)
        coarse[cell // across, cell % across] = mean_of_present(
            fine[i, j], fine[i, j + 1], fine[i + 1, j], fine[i + 1, j + 1]
        )


@grid
def _spread(count: int, fine: Any, wanted: Any, coarse: Any, side: int, row_shift: int, column_shift: int) -> None:
    rows, columns = coarse.shape
    across = fine.shape[1]
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // across, p % across
        if not wanted[i, j]:
            continue
        y, x = corner(i + row_shift, side), corner(j + column_shift, side)
        above, below, left, right = max(y, 0), min(y + 1, rows - 1), max(x, 0), min(x + 1, columns - 1)
        down, to_the_right = np.float32(share(i + row_shift, side, y)), np.float32(share(j + column_shift, side, x))
        a, a_weight = between_rows(coarse[above, left], coarse[below, left], down)
        b, b_weight = between_rows(coarse[above, right], coarse[below, right], down)
        fine[i, j] = between_columns(
            np.float32(a), np.float32(a_weight), np.float32(b), np.float32(b_weight), to_the_right, fine[i, j]
        )


def window_lowest(values: Any, half_width: int) -> Any:
    """See `ground.window_lowest`; windows are small and lie in the cache, so every neighbour is looked at."""
    xp = namespace(values)
    along, out = xp.empty(values.shape, xp.float32), xp.empty(values.shape, xp.float32)
    rows, columns = values.shape
    _lowest_in_line(values.size, along.reshape(-1), values.reshape(-1), columns, 1, half_width)
    _lowest_in_line(values.size, out.reshape(-1), along.reshape(-1), rows, columns, half_width)
    return out


def lowest_of_cells(low: Any, dsm: Any, side: int, row_shift: int, column_shift: int) -> None:
    """See `ground_loops.lowest_of_cells`."""
    _lowest_of_cells(low.size, low, dsm, side, row_shift, column_shift)


def mean_of_cells(
    mean: Any, low: Any, surface: Any, dsm: Any, most: np.float32, side: int, row_shift: int, column_shift: int
) -> None:
    """See `ground_loops.mean_of_cells`."""
    _mean_of_cells(mean.size, mean, low, surface, dsm, most, side, row_shift, column_shift)


def pull(coarse: Any, fine: Any) -> None:
    """See `ground_loops.pull`."""
    _pull(coarse.size, coarse, fine)


def spread(fine: Any, wanted: Any, coarse: Any, side: int, row_shift: int, column_shift: int) -> None:
    """See `ground_loops.spread`."""
    _spread(fine.size, fine, wanted, coarse, side, row_shift, column_shift)


STEPS = Steps(window_lowest, lowest_of_cells, mean_of_cells, pull, spread)
