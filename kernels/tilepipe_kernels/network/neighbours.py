"""What the eight neighbours of a pixel say of it: whether it may be taken off a mask, and its links in a skeleton."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule

# neighbour k of a pixel, clockwise from north-west: bit k of every neighbour mask here
NEIGHBOURS: tuple[tuple[int, int], ...] = (
    (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1),
)  # fmt: skip


def _neighbour_table(property_of: Any) -> NDArray[Any]:
    """Tabulate a function of the eight neighbours, 0 or 1 in the order of `NEIGHBOURS`, by their code."""
    return np.array([property_of(tuple(code >> k & 1 for k in range(8))) for code in range(256)], np.uint8)


def _is_simple(neighbours: tuple[int, ...]) -> bool:
    """Whether a pixel can go and leave 8-components and 4-holes: Yokoi's connectivity number is 1."""
    absent = [1 - value for value in neighbours]
    return sum(absent[k] - absent[k] * absent[(k + 1) % 8] * absent[(k + 2) % 8] for k in (1, 3, 5, 7)) == 1


def _link_bits(neighbours: tuple[int, ...]) -> int:
    """Neighbours linked in mixed adjacency: those at a side, and at a corner with both its sides empty."""
    return sum(
        neighbours[k] << k for k in range(8) if k % 2 == 1 or not (neighbours[(k - 1) % 8] or neighbours[(k + 1) % 8])
    )


IS_SIMPLE = _neighbour_table(_is_simple)

# the end of a line is simple too, and must stay when lines are only to be made thin
IS_REMOVABLE = _neighbour_table(lambda neighbours: _is_simple(neighbours) and sum(neighbours) > 1)

LINKS = _neighbour_table(_link_bits)


@rule
def neighbour_code(
    northwest: np.uint8, north: np.uint8, northeast: np.uint8, east: np.uint8, southeast: np.uint8, south: np.uint8,
    southwest: np.uint8, west: np.uint8,
) -> int:  # fmt: skip
    """Bits of the neighbours present, given their states in the order of `NEIGHBOURS`."""
    code = (
        (northwest & 1)
        | (north & 1) << 1
        | (northeast & 1) << 2
        | (east & 1) << 3
        | (southeast & 1) << 4
        | (south & 1) << 5
        | (southwest & 1) << 6
        | (west & 1) << 7
    )
    return code  # type: ignore[return-value]


@loop
def code_at(state: NDArray[np.uint8], p: int, stride: int) -> int:
    """`neighbour_code` of a flat position p."""
    north, south = p - stride, p + stride
    code: int = neighbour_code(
        state[north - 1], state[north], state[north + 1], state[p + 1], state[south + 1], state[south],
        state[south - 1], state[p - 1],
    )  # fmt: skip
    return code
