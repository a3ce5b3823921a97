"""Pixel graphs cut into fragments: the part of the line network that one tile core can see.

A pixel graph is a uint8 image ``links``: at a pixel, bit k is set when the pixel is linked to its neighbour
in direction k, counted clockwise from north-west. Links are symmetric. A pixel with two links is passed
through; one with any other number of links is a node. A fragment is a maximal chain of linked core pixels
between two stops: a node, a link that leaves the core, or, for a closed ring, its own beginning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop

NODE, CROSSING, RING = 0, 1, 2

ROW_STEP = np.array([-1, -1, -1, 0, 1, 1, 1, 0], np.int64)
COLUMN_STEP = np.array([-1, 0, 1, 1, 1, 0, -1, -1], np.int64)
DEGREE = np.array([bin(value).count("1") for value in range(256)], np.uint8)
LOWEST_BIT = np.array([(value & -value).bit_length() - 1 for value in range(256)], np.int8)
# Directions in the row-major order of the neighbours that they lead to.
BY_PIXEL = np.array([0, 1, 2, 7, 3, 6, 5, 4], np.int64)


@dataclass(frozen=True)
class Fragments:
    """The chains of one tile core, as flat arrays.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): fragment i owns ``pixels[offsets[i]:offsets[i + 1]]``.
    pixels
        int64, shape (p,): global flat pixel indices (row * width + column) in chain order; a node at the
        end of a fragment is its first or last pixel, so a node pixel stands in each of its fragments.
    end_kind
        uint8, shape (n, 2): ``NODE``, ``CROSSING`` or ``RING`` at the first and at the last pixel.
    end_pixel
        int64, shape (n, 2): the node pixel; for a crossing the pixel beyond the core's edge; for a ring the
        first pixel. A crossing link is thus named by the same two pixels in both of its tiles.
    """

    offsets: NDArray[np.int64]
    pixels: NDArray[np.int64]
    end_kind: NDArray[np.uint8]
    end_pixel: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offsets) - 1


def halo() -> int:
    """Pixels needed around the core: none, since a pixel's links already name its neighbours."""
    return 0


def trace(
    links: NDArray[np.uint8],
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    width: int | None = None,
) -> Fragments:
    """Cut the pixel graph of a tile core into fragments.

    Parameters
    ----------
    links
        uint8, shape (rows, columns): the pixel graph of a block, bit k = linked in direction k, in the
        order (-1,-1), (-1,0), (-1,1), (0,1), (1,1), (1,0), (1,-1), (0,-1).
    core
        Window (first row, first column, end row, end column) of the core in the block; the whole block if
        None.
    origin
        Global (row, column) of ``links[0, 0]``.
    width
        Columns of the whole raster; by default the block is taken to reach the raster's right edge.

    Returns
    -------
    Fragments
        Fragments from nodes first, then those between two crossings, then rings; each group in row-major
        order of its first pixel. Rings start at their lowest pixel toward its lower neighbour. Pixels
        without links are in no fragment.

    Raises
    ------
    ValueError
        If ``links`` is not a two-dimensional uint8 array or not symmetric inside the core, or the core is
        not a window of it.

    Examples
    --------
    A line of four pixels, and a lone one that is in no fragment.

    >>> import numpy as np
    >>> from tilepipe_kernels.network.skeleton import skeleton_links
    >>> from tilepipe_kernels.network.tracing import trace
    >>> fragments = trace(skeleton_links(np.array([[1, 1, 1, 0, 0], [0, 0, 0, 1, 0], [1, 0, 0, 0, 0]])))
    >>> fragments.pixels.tolist(), fragments.end_pixel.tolist()
    ([0, 1, 2, 8], [[0, 8]])
    """
    links = np.ascontiguousarray(links)
    if links.ndim != 2 or links.dtype != np.uint8:
        raise ValueError(f"links must be a 2-D uint8 array, got {links.ndim}-D {links.dtype}")
    top, left, bottom, right = (0, 0, *links.shape) if core is None else core
    if not (0 <= top <= bottom <= links.shape[0] and 0 <= left <= right <= links.shape[1]):
        raise ValueError(f"core {core} is not a window of a block of shape {links.shape}")
    columns = origin[1] + links.shape[1] if width is None else width
    if origin[0] < 0 or origin[1] < 0 or origin[1] + right > columns:
        raise ValueError(f"origin {origin} puts the core outside a raster of {columns} columns")
    window = np.array([top, left, bottom, right], np.int64)
    base = origin[0] * columns + origin[1]
    symmetric, offsets, pixels, end_kind, end_pixel = _trace(links, window, base, columns)
    if not symmetric:
        raise ValueError("links is not symmetric: a pixel is linked to a neighbour that is not linked back")
    return Fragments(offsets, pixels, end_kind, end_pixel)


@loop
def _linked_pixels(links: NDArray[np.uint8], window: NDArray[np.int64]) -> tuple[NDArray[np.int64], int, int]:
    """Block flat indices of linked core pixels, number of pixels of all fragments, bound on their number."""
    top, left, bottom, right = window
    linked = 0
    for row in range(top, bottom):
        for value in links[row, left:right]:
            linked += value != 0
    found = np.empty(linked, np.int64)
    cursor = passed = node_ends = crossings = 0
    for row in range(top, bottom):
        line = links[row]
        for column in range(left, right):
            value = line[column]
            if value == 0:
                continue
            found[cursor] = row * links.shape[1] + column
            cursor += 1
            degree = int(DEGREE[value])
            if degree == 2:
                passed += 1
            else:
                node_ends += degree
            if row == top or row == bottom - 1 or column == left or column == right - 1:
                crossings += degree
    return found, passed + node_ends, (node_ends + crossings + 1) // 2 + passed // 3 + 1


@loop
def _follow(
    links: NDArray[np.uint8],
    window: NDArray[np.int64],
    visited: NDArray[np.uint8],
    base: int,
    width: int,
    row: int,
    column: int,
    direction: int,
    pixels: NDArray[np.int64],
    cursor: int,
) -> tuple[int, int, int]:
    """Append the pixels after (row, column); return cursor (-1 if not symmetric), end kind and end pixel."""
    top, left, bottom, right = window
    while True:
        row += ROW_STEP[direction]
        column += COLUMN_STEP[direction]
        pixel = base + row * width + column
        if row < top or row >= bottom or column < left or column >= right:
            return cursor, CROSSING, pixel
        value = links[row, column]
        back = 1 << (direction ^ 4)
        if not value & back:
            return -1, NODE, pixel
        if visited[row - top, column - left]:
            return cursor, RING, pixel
        pixels[cursor] = pixel
        cursor += 1
        if DEGREE[value] != 2:
            return cursor, NODE, pixel
        visited[row - top, column - left] = 1
        direction = int(LOWEST_BIT[value & ~back])


@loop
def _walked(
    links: NDArray[np.uint8],
    window: NDArray[np.int64],
    visited: NDArray[np.uint8],
    row: int,
    column: int,
    direction: int,
) -> bool:
    """Whether the chain along ``direction`` starts at its other node: of two adjacent nodes at the lower."""
    top, left, bottom, right = window
    r, c = row + ROW_STEP[direction], column + COLUMN_STEP[direction]
    if r < top or r >= bottom or c < left or c >= right:
        return False
    if DEGREE[links[r, c]] != 2:
        return (r, c) < (row, column)
    return visited[r - top, c - left] != 0


@loop
def _trace(
    links: NDArray[np.uint8], window: NDArray[np.int64], base: int, width: int
) -> tuple[bool, NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8], NDArray[np.int64]]:
    top, left, bottom, right = window
    found, total, bound = _linked_pixels(links, window)
    visited = np.zeros((bottom - top, right - left), np.uint8)
    offsets = np.zeros(bound + 1, np.int64)
    pixels = np.empty(total, np.int64)
    end_kind = np.empty((bound, 2), np.uint8)
    end_pixel = np.empty((bound, 2), np.int64)
    count = cursor = 0
    # Chains that touch a node go first, so what is left runs between two crossings or is a ring.
    for stage in (NODE, CROSSING, RING):
        for index in found:
            row, column = index // links.shape[1], index % links.shape[1]
            value = links[row, column]
            if (DEGREE[value] == 2) != (stage != NODE):
                continue
            for direction in BY_PIXEL:
                if not value & (1 << direction):
                    continue
                if visited[row - top, column - left]:
                    break
                heading = direction
                first = base + row * width + column
                if stage == NODE:
                    if _walked(links, window, visited, row, column, direction):
                        continue
                elif stage == CROSSING:
                    r, c = row + ROW_STEP[direction], column + COLUMN_STEP[direction]
                    if top <= r < bottom and left <= c < right:
                        continue
                    first = base + r * width + c
                    heading = LOWEST_BIT[value & ~(1 << direction)]
                visited[row - top, column - left] = stage != NODE
                pixels[cursor] = base + row * width + column
                walk = links, window, visited, base, width, row, column, heading, pixels
                cursor, kind, last = _follow(*walk, cursor + 1)
                if cursor < 0:
                    return False, offsets, pixels, end_kind, end_pixel
                end_kind[count, 0], end_kind[count, 1] = stage, kind
                end_pixel[count, 0], end_pixel[count, 1] = first, last
                count += 1
                offsets[count] = cursor
    # Copies, so that the generous bounds do not stay in memory.
    return (
        True,
        offsets[: count + 1].copy(),
        pixels[:cursor],
        end_kind[:count].copy(),
        end_pixel[:count].copy(),
    )
