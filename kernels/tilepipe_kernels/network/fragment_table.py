"""Fragment tables: what joining needs to know of the fragments of a tile, without their points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.network.tracing import CROSSING, RING, Fragments

HIGHEST = int(np.iinfo(np.int64).max)


@dataclass(frozen=True)
class FragmentTable:
    """What joining needs to know of each of n fragments; all int64 of shape (n,) or (n, 2) unless said.

    Attributes
    ----------
    count
        Number of pixels.
    end_kind
        uint8, shape (n, 2): node, crossing or ring.
    end_node
        Shape (n, 2): the node pixel where the end is a node, else -1.
    end_link
        Shape (n, 2): key of the first and of the last link; at a crossing it names the joint.
    second_pixel
        Shape (n, 2): the pixel next to each end's pixel along the line, inside the core or not.
    lowest_link
        Key of the lowest link; the lowest over a whole line is that line's own.
    axial, diagonal
        Number of links along rows or columns and along diagonals; a crossing counts where its lower pixel
        is.
    lowest_pixel, lowest_index
        Lowest pixel, and where in the fragment it stands.
    lowest_neighbour
        Shape (n, 2): the pixels before and after the lowest one.
    strength
        float32, shape (n,): greatest response over the fragment's pixels; 0 where none was given.
    """

    count: Int64
    end_kind: NDArray[np.uint8]
    end_node: Int64
    end_link: Int64
    second_pixel: Int64
    lowest_link: Int64
    axial: Int64
    diagonal: Int64
    lowest_pixel: Int64
    lowest_index: Int64
    lowest_neighbour: Int64
    strength: NDArray[np.float32]


def summarise(fragments: Fragments, width: int, response: NDArray[np.float32] | None = None) -> FragmentTable:
    """Reduce the fragments of a tile to the table from which the network's topology is solved.

    Parameters
    ----------
    fragments
        Fragments of one tile, p pixels.
    width
        Columns of the whole raster.
    response
        float32, shape (p,), response per pixel, for hysteresis; None gives strength 0.

    Returns
    -------
    FragmentTable
        About 120 bytes a fragment.

    Raises
    ------
    ValueError
        If ``response`` does not hold one value per pixel.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.fragment_table import summarise
    >>> from tilepipe_kernels.network.skeleton import skeleton_links
    >>> from tilepipe_kernels.network.tracing import trace
    >>> table = summarise(trace(skeleton_links(np.array([[1, 1, 1, 0], [0, 0, 0, 1]]))), width=4)
    >>> table.count.tolist(), table.axial.tolist(), table.diagonal.tolist()
    ([4], [2], [1])
    """
    if response is not None and response.shape != fragments.pixels.shape:
        raise ValueError(f"response holds {response.shape} values for {len(fragments.pixels)} pixels")
    given = np.zeros(0, np.float32) if response is None else np.ascontiguousarray(response, np.float32)
    columns = _summarise(fragments.offsets, fragments.pixels, fragments.end_kind, fragments.end_pixel, width, given)
    return FragmentTable(np.diff(fragments.offsets), fragments.end_kind, *columns)


@rule
def link_key(first: int, second: int, width: int) -> int:
    """Key of the link between two neighbouring pixels: the same either way, ordered by the lower pixel."""
    step = abs(second - first)
    return min(first, second) * 4 + (0 if step == 1 else 1 if step == width - 1 else 2 if step == width else 3)


@rule
def axial_and_diagonal(first: int, second: int, width: int) -> tuple[int, int]:
    """Axial and diagonal steps of a shortest 8-connected way between two pixels."""
    rows = abs(second // width - first // width)
    columns = abs(second % width - first % width)
    diagonal = min(rows, columns)
    return max(rows, columns) - diagonal, diagonal


@loop
def _summarise(
    offsets: Int64,
    pixels: Int64,
    end_kind: NDArray[np.uint8],
    end_pixel: Int64,
    width: int,
    response: NDArray[np.float32],
) -> tuple[Int64, Int64, Int64, Int64, Int64, Int64, Int64, Int64, Int64, NDArray[np.float32]]:
    n = len(offsets) - 1
    end_node = np.full((n, 2), -1, np.int64)
    end_link = np.empty((n, 2), np.int64)
    second_pixel = np.empty((n, 2), np.int64)
    lowest_link = np.empty(n, np.int64)
    axial = np.zeros(n, np.int64)
    diagonal = np.zeros(n, np.int64)
    lowest_pixel = np.empty(n, np.int64)
    lowest_index = np.empty(n, np.int64)
    lowest_neighbour = np.empty((n, 2), np.int64)
    strength = np.zeros(n, np.float32)
    for i in range(n):
        chain = pixels[offsets[i] : offsets[i + 1]]
        count = len(chain)
        place = 0
        link = HIGHEST
        for j in range(count):
            if chain[j] < chain[place]:
                place = j
            if j > 0:
                link = min(link, link_key(chain[j - 1], chain[j], width))
                straight, slanted = axial_and_diagonal(chain[j - 1], chain[j], width)
                axial[i] += straight
                diagonal[i] += slanted
        beyond = (end_pixel[i, 0], end_pixel[i, 1])
        if end_kind[i, 0] == RING:
            beyond = (chain[count - 1], chain[0])
        for side in range(2):
            own = chain[0] if side == 0 else chain[count - 1]
            inner = chain[min(1, count - 1)] if side == 0 else chain[max(count - 2, 0)]
            if end_kind[i, side] == CROSSING or end_kind[i, side] == RING:
                end_link[i, side] = link_key(own, beyond[side], width)
                link = min(link, end_link[i, side])
                if own < beyond[side]:
                    straight, slanted = axial_and_diagonal(own, beyond[side], width)
                    axial[i] += straight
                    diagonal[i] += slanted
            else:
                end_node[i, side] = own
                if count == 1:
                    inner = beyond[1 - side]
                end_link[i, side] = link_key(own, inner, width)
            second_pixel[i, side] = inner
        lowest_link[i] = link
        lowest_pixel[i], lowest_index[i] = chain[place], place
        lowest_neighbour[i, 0] = chain[place - 1] if place > 0 else beyond[0]
        lowest_neighbour[i, 1] = chain[place + 1] if place < count - 1 else beyond[1]
        if len(response):
            strength[i] = response[offsets[i] : offsets[i + 1]].max()
    return (
        end_node,
        end_link,
        second_pixel,
        lowest_link,
        axial,
        diagonal,
        lowest_pixel,
        lowest_index,
        lowest_neighbour,
        strength,
    )
