"""`nevatia_babu.links` on the device: a thread for every edge element of the core."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.network.tracing import COLUMN_STEP, ROW_STEP
from tilepipe_kernels.nevatia_babu.links import AHEAD, NO_CANDIDATE, continuations, rank_of
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION


@cuda.jit(device=True)
def _ranked(elements: Any, magnitude: Any, i: int, j: int, direction: int, heading: int, neighbour: int) -> Any:
    """Rank of a neighbour as continuation of an element, and its direction."""
    r, c = i + ROW_STEP[neighbour], j + COLUMN_STEP[neighbour]
    if r < 0 or c < 0 or r >= elements.shape[0] or c >= elements.shape[1]:
        return np.int64(NO_CANDIDATE), np.int64(NO_DIRECTION)
    other = int(np.int64(elements[r, c]))
    return rank_of(direction, heading, neighbour, other, magnitude[r, c]), other


@cuda.jit(device=True)
def _continuations(elements: Any, magnitude: Any, i: int, j: int, direction: int, heading: int, middle: int) -> Any:
    """Primary and secondary continuation of an element among the three neighbours around ``middle``."""
    one, a = _ranked(elements, magnitude, i, j, direction, heading, (middle - 1) & 7)
    two, b = _ranked(elements, magnitude, i, j, direction, heading, middle)
    three, c = _ranked(elements, magnitude, i, j, direction, heading, (middle + 1) & 7)
    return continuations(one, two, three, a, b, c)


@grid
def _link(
    count: int, places: Any, elements: Any, magnitude: Any, top: int, left: int, across: int, base: int, width: int,
    pixel: Any, direction: Any, strength: Any, links: Any,
) -> None:  # fmt: skip
    """Fill the table; ``places`` are those of the elements in the core, which is ``across`` columns wide."""
    for k in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = top + places[k] // across, left + places[k] % across
        d = np.int64(elements[i, j])
        pixel[k], direction[k], strength[k] = base + i * width + j, elements[i, j], magnitude[i, j]
        middle = AHEAD[d]
        before, second_before = _continuations(elements, magnitude, i, j, d, d + 3, middle ^ 4)
        after, second_after = _continuations(elements, magnitude, i, j, d, d - 3, middle)
        links[k, 0], links[k, 1], links[k, 2], links[k, 3] = before, second_before, after, second_after


def link(
    elements: Any, magnitude: Any, core: tuple[int, int, int, int], base: int, width: int
) -> tuple[Any, Any, Any, Any]:
    """Pixels, directions, magnitudes and links of the elements of a core, as of `nevatia_babu.links.link_elements`."""
    xp = namespace(elements, magnitude)
    top, bottom, left, right = core
    # how many there are is the one number that comes to the host: the table has their size
    places = xp.flatnonzero(elements[top:bottom, left:right] != NO_DIRECTION)
    n = int(places.size)
    pixel, direction = xp.empty(n, xp.int64), xp.empty(n, xp.uint8)
    strength, links = xp.empty(n, xp.float32), xp.empty((n, 4), xp.uint8)
    _link(
        n, places, elements, magnitude, top, left, right - left, base, width, pixel, direction, strength, links
    )  # fmt: skip
    return pixel, direction, strength, links
