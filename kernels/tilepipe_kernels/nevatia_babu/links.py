"""Linking edge elements in each tile to their predecessors and successors; `nevatia_babu.tracing` walks them.

Nevatia and Babu, "Linear Feature Extraction and Description", Computer Graphics and Image Processing 13, 1980,
Section 2.3; directions as in `nevatia_babu.masks`, neighbours numbered clockwise from north-west.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.network.tracing import BY_PIXEL, COLUMN_STEP, ROW_STEP
from tilepipe_kernels.nevatia_babu.elements import halo as elements_halo
from tilepipe_kernels.nevatia_babu.elements import similar, thin_edges
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION, Directions, Floats, edge_responses

NO_LINK = 255
"""Neighbour number of a link that does not exist."""

PREDECESSOR, SECOND_PREDECESSOR, SUCCESSOR, SECOND_SUCCESSOR = 0, 1, 2, 3
"""Columns of `EdgeElements.links`."""

AHEAD = np.array([5, 4, 4, 3, 2, 2, 1, 0, 0, 7, 6, 6], np.int64)
"""Neighbour into which an edge of each direction runs, bright side on the left; diagonal for 30° and 60°."""

# Place of each neighbour in row-major order.
_ORDER = np.argsort(BY_PIXEL)

Int64 = NDArray[np.int64]
Links = NDArray[np.uint8]
NO_CANDIDATE = 1 << 62
"""Rank of a neighbour that does not continue an element."""


@dataclass(frozen=True)
class EdgeElements:
    """Edge elements with the elements before and after them, sorted by pixel; 17 bytes each.

    Attributes
    ----------
    pixel
        int64, shape (n,): global flat index, row · width + column, of a raster of ``width`` columns.
    direction
        uint8, shape (n,): 0 … 11, where the bright side lies, in units of 30°; see `nevatia_babu.masks`.
    magnitude
        float32, shape (n,): response of the strongest mask.
    links
        uint8, shape (n, 4): numbers of the neighbours that are primary and secondary predecessor, primary and
        secondary successor; `NO_LINK` where there is none.
    width
        Columns of the raster.
    """

    pixel: Int64
    direction: Directions
    magnitude: Floats
    links: Links
    width: int

    def __len__(self) -> int:
        return len(self.pixel)


def halo() -> int:
    """Pixels around a core on which its elements and their links depend: 5."""
    return elements_halo() + 1


# ------------------------------------------------------------------------------------------------- links


@inlined_rule
def rank_of(direction: int, heading: int, neighbour: int, other: int, magnitude: np.float32) -> int:
    """Order of a neighbour as continuation of an element, lowest first; `NO_CANDIDATE` if it is none.

    Equal direction, nearer pixel, smaller turn (in 15°), stronger response, earlier pixel: the last three bits are its
    place in row-major order.
    """
    if other == NO_DIRECTION or not similar(np.float32(direction), np.float32(other)):
        return NO_CANDIDATE
    unequal, diagonal = int(other != direction), 1 - (neighbour & 1)
    # In units of 15° counterclockwise from rightward neighbour k lies at 9 - 3 k.
    turn = abs(9 - 3 * neighbour - 2 * heading) % 24
    # The bits of positive numbers are ordered as the numbers are.
    weakness = 0x7FFFFFFF - np.int64(np.float32(magnitude).view(np.int32))
    return int(((unequal << 4 | diagonal << 3 | min(turn, 24 - turn)) << 31 | weakness) << 3 | _ORDER[neighbour])


@rule
def _pair_and_branch(one: int, two: int, branch: int) -> tuple[int, int]:
    return BY_PIXEL[min(one, two) & 7], BY_PIXEL[branch & 7]


@rule
def continuations(one: int, two: int, three: int, a: int, b: int, c: int) -> tuple[int, int]:
    """Primary and secondary continuation, as neighbours, of three in a row with their ranks and directions."""
    first = min(one, two, three)
    if first == NO_CANDIDATE:
        return NO_LINK, NO_LINK
    if max(one, two, three) < NO_CANDIDATE:
        if a == b and b != c:
            return _pair_and_branch(one, two, three)
        if b == c and c != a:
            return _pair_and_branch(two, three, one)
        if c == a and a != b:
            return _pair_and_branch(one, three, two)
        return BY_PIXEL[first & 7], BY_PIXEL[max(min(one, two), min(max(one, two), three)) & 7]
    if two == NO_CANDIDATE and max(one, three) < NO_CANDIDATE:
        return BY_PIXEL[first & 7], BY_PIXEL[max(one, three) & 7]
    return BY_PIXEL[first & 7], NO_LINK


@loop
def _ranked(
    elements: Directions, magnitude: Floats, i: int, j: int, direction: int, heading: int, neighbour: int
) -> tuple[int, int]:
    """Rank of a neighbour as continuation of an element, and its direction."""
    r, c = i + ROW_STEP[neighbour], j + COLUMN_STEP[neighbour]
    if r < 0 or c < 0 or r >= elements.shape[0] or c >= elements.shape[1]:
        return NO_CANDIDATE, NO_DIRECTION
    other = int(np.int64(elements[r, c]))
    return rank_of(direction, heading, neighbour, other, magnitude[r, c]), other


@loop
def _continuations(
    elements: Directions, magnitude: Floats, i: int, j: int, direction: int, heading: int, middle: int
) -> tuple[int, int]:
    """Primary and secondary continuation of an element among the three neighbours around ``middle``."""
    one, a = _ranked(elements, magnitude, i, j, direction, heading, (middle - 1) & 7)
    two, b = _ranked(elements, magnitude, i, j, direction, heading, middle)
    three, c = _ranked(elements, magnitude, i, j, direction, heading, (middle + 1) & 7)
    return continuations(one, two, three, a, b, c)


@loop
def _count_elements(elements: Directions, window: Int64) -> int:
    top, left, bottom, right = window
    count = 0
    for i in range(top, bottom):
        for value in elements[i, left:right]:
            count += value != NO_DIRECTION
    return count


@loop
def _link(
    elements: Directions, magnitude: Floats, window: Int64, base: int, width: int,
    pixel: Int64, direction: Directions, strength: Floats, links: Links,
) -> None:  # fmt: skip
    top, left, bottom, right = window
    n = 0
    for i in range(top, bottom):
        for j in range(left, right):
            if elements[i, j] == NO_DIRECTION:
                continue
            d = int(np.int64(elements[i, j]))
            pixel[n], direction[n], strength[n] = base + i * width + j, d, magnitude[i, j]
            middle = int(AHEAD[d])
            links[n, 0], links[n, 1] = _continuations(elements, magnitude, i, j, d, d + 3, middle ^ 4)
            links[n, 2], links[n, 3] = _continuations(elements, magnitude, i, j, d, d - 3, middle)
            n += 1


def link_elements(
    magnitude: Floats,
    elements: Directions,
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    width: int | None = None,
) -> EdgeElements:
    """Table of the edge elements of a tile's core, each with its predecessors and successors.

    An element runs into one of eight neighbours (`AHEAD`); that one and the two beside it are its candidates when
    they hold elements whose directions differ by at most 30°. Behind it lie the candidates for predecessors. The
    primary one is the candidate of the nearest direction, then the nearest pixel (not diagonal), the smallest turn,
    the strongest response, the first in row-major order. There is a secondary one, a fork, when

    - the middle neighbour is no candidate and both outer ones are;
    - all three are.  If two of these have the same direction, the better of the two is primary and the third
      secondary, otherwise the first and the second in the order above.

    Parameters
    ----------
    magnitude, elements
        float32 and uint8, shape (rows, columns): a block as `edge_responses` and `thin_edges` give it.  Arrays of a
        device stay there, and so do the columns of the table.
    core
        Window (first row, end row, first column, end column) of the block; the whole block if None.
    origin
        Global (row, column) of the block's first pixel; negative where the halo leaves the raster.
    width
        Columns of the whole raster; by default the block is taken to reach the raster's right edge.

    Raises
    ------
    ValueError
        If shapes or dtypes are not those of `thin_edges`, or the core is not a window of block and raster.

    Examples
    --------
    The elements of a vertical edge, each with its neighbours before and after it.

    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.elements import thin_edges
    >>> from tilepipe_kernels.nevatia_babu.links import NO_LINK, link_elements
    >>> from tilepipe_kernels.nevatia_babu.masks import edge_responses
    >>> magnitude, direction = edge_responses(np.tile(np.repeat([100, 150], 5), (10, 1)))
    >>> found = link_elements(magnitude, thin_edges(magnitude, direction))
    >>> (found.pixel // found.width).tolist(), (found.links != NO_LINK).sum(axis=1).tolist()
    ([2, 3, 4, 5, 6, 7], [1, 2, 2, 2, 2, 1])
    """
    if elements.ndim != 2 or magnitude.shape != elements.shape:
        raise ValueError(f"magnitude {magnitude.shape} and elements {elements.shape} must be images of equal shape")
    if magnitude.dtype != np.float32 or elements.dtype != np.uint8:
        raise ValueError(f"magnitude must be float32 and elements uint8, not {magnitude.dtype} and {elements.dtype}")
    top, bottom, left, right = (0, elements.shape[0], 0, elements.shape[1]) if core is None else core
    if not (0 <= top <= bottom <= elements.shape[0] and 0 <= left <= right <= elements.shape[1]):
        raise ValueError(f"core {core} is not a window of a block of shape {elements.shape}")
    columns = origin[1] + elements.shape[1] if width is None else width
    if origin[0] + top < 0 or origin[1] + left < 0 or origin[1] + right > columns:
        raise ValueError(f"origin {origin} puts the core outside a raster of {columns} columns")
    xp = namespace(elements, magnitude)
    elements, magnitude = xp.ascontiguousarray(elements), xp.ascontiguousarray(magnitude)
    base = origin[0] * columns + origin[1]
    if on_device(elements):
        link = device_form(__name__).link
        pixel, direction, strength, links = link(elements, magnitude, (top, bottom, left, right), base, columns)
        return EdgeElements(pixel, direction, strength, links, columns)
    window = np.array([top, left, bottom, right], np.int64)
    n = _count_elements(elements, window)
    table = EdgeElements(
        np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n, np.float32), np.empty((n, 4), np.uint8), columns
    )
    _link(elements, magnitude, window, base, columns, table.pixel, table.direction, table.magnitude, table.links)
    return table


def find_elements(
    block: NDArray[Any],
    threshold: float,
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    width: int | None = None,
) -> EdgeElements:
    """Table of the edge elements of a tile's core straight from the image; see `edge_responses`, `link_elements`.

    Parameters
    ----------
    block
        Image (rows, columns) of real numbers with `halo` pixels around the core; NaN = nodata.  An array of a device
        stays there, and so do the columns of the table.
    threshold
        Of the magnitude, for `thin_edges`.
    core, origin, width
        As for `link_elements`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.links import find_elements
    >>> image = np.tile(np.repeat([100, 150], 5), (10, 1))
    >>> elements = find_elements(image, threshold=10_000)
    >>> elements.pixel.tolist(), elements.magnitude[0].item()
    ([24, 34, 44, 54, 64, 74], 50000.0)
    """
    magnitude, direction = edge_responses(block)
    return link_elements(magnitude, thin_edges(magnitude, direction, threshold), core, origin, width)


def join_elements(tables: Iterable[EdgeElements]) -> EdgeElements:
    """Elements of all tiles of a raster in one table on the host, the same for any tiling.

    Raises
    ------
    ValueError
        If there is no table, tables disagree about the raster's width, or a pixel stands in two of them.

    Examples
    --------
    The upper and the lower half of an image give the table of the whole.

    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.links import find_elements, halo, join_elements
    >>> image, reach = np.tile(np.repeat([100, 150], 6), (24, 1)), halo()
    >>> upper = find_elements(image[: 12 + reach], 10_000, core=(0, 12, 0, 12))
    >>> lower = find_elements(image[12 - reach :], 10_000, core=(reach, reach + 12, 0, 12), origin=(12 - reach, 0))
    >>> bool((join_elements([lower, upper]).pixel == find_elements(image, 10_000).pixel).all())
    True
    """
    parts = list(tables)
    if not parts:
        raise ValueError("there are no edge elements to join: give the table of at least one tile")
    if len({part.width for part in parts}) > 1:
        raise ValueError(f"tables of rasters of different width: {sorted({part.width for part in parts})} columns")
    pixel = np.concatenate([part.pixel for part in parts])
    order = np.argsort(pixel, kind="stable")
    pixel = pixel[order]
    if (pixel[1:] == pixel[:-1]).any():
        raise ValueError("an edge element stands in two tables: give the elements of each tile's core alone")
    names = ("direction", "magnitude", "links")
    direction, magnitude, links = (np.concatenate([getattr(part, name) for part in parts])[order] for name in names)
    return EdgeElements(pixel, direction, magnitude, links, parts[0].width)
