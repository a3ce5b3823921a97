"""`elements` on the device: first the winners of all pixels, then which of them stay."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.nevatia_babu.elements import element_of, winning_line
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION

_NO_LINE = np.uint8(0)


@cuda.jit(device=True)
def _around(values: Any, i: int, j: int) -> Any:
    """Values of the eight neighbours of a pixel in row-major order."""
    return (
        values[i - 1, j - 1], values[i - 1, j], values[i - 1, j + 1], values[i, j - 1],
        values[i, j + 1], values[i + 1, j - 1], values[i + 1, j], values[i + 1, j + 1],
    )  # fmt: skip


@cuda.jit(device=True)
def _wide(d: Any) -> Any:
    """Eight directions as float32, in which the rules compare them."""
    return (
        np.float32(d[0]), np.float32(d[1]), np.float32(d[2]), np.float32(d[3]),
        np.float32(d[4]), np.float32(d[5]), np.float32(d[6]), np.float32(d[7]),
    )  # fmt: skip


@grid
def _find_winners(count: int, magnitude: Any, direction: Any, lines: Any) -> None:
    rows, columns = lines.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        if direction[i, j] == NO_DIRECTION or min(i, rows - 1 - i, j, columns - 1 - j) < 1:
            lines[i, j] = _NO_LINE
            continue
        lines[i, j] = winning_line(
            magnitude[i, j], np.float32(direction[i, j]), _around(magnitude, i, j), _wide(_around(direction, i, j))
        )


@grid
def _keep_winners(count: int, lines: Any, magnitude: Any, direction: Any, threshold: np.float32, elements: Any) -> None:
    columns = lines.shape[1]
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        # there are no winners on the border of a block, so that a winner has eight neighbours
        if lines[i, j] == _NO_LINE:
            elements[i, j] = NO_DIRECTION
            continue
        elements[i, j] = element_of(lines[i, j], _around(lines, i, j), magnitude[i, j], direction[i, j], threshold)


def thin(magnitude: Any, direction: Any, threshold: np.float32) -> Any:
    """Edge elements of device arrays, as of `nevatia_babu.elements.thin_edges`."""
    xp = namespace(magnitude, direction)
    lines, elements = xp.empty(magnitude.shape, xp.uint8), xp.empty(magnitude.shape, xp.uint8)
    _find_winners(magnitude.size, magnitude, direction, lines)
    _keep_winners(magnitude.size, lines, magnitude, direction, threshold, elements)
    return elements
