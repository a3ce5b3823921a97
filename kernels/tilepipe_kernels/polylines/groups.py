"""Polylines that meet at their ends, and the groups that they form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Polylines, Vertices
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.core.union_find import flatten, unite


def place_numbers(points: Vertices) -> Int64:
    """One number for the (row, column) of each point, both whole numbers from 0 to 2³¹, in that order."""
    whole = points.astype(np.int64)
    numbers: Int64 = whole[:, 0] << 32 | whole[:, 1]
    return numbers


@loop
def _group_lengths(places: Int64, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Length of the group of each polyline; `places` holds the numbers of its two ends, 0 to 2 n - 1."""
    parent = np.arange(places.size)
    for i in range(lengths.size):
        unite(parent, places[2 * i], places[2 * i + 1])
    flatten(parent)
    totals, sums = np.zeros(parent.size), np.empty(lengths.size)
    for i in range(lengths.size):
        totals[parent[places[2 * i]]] += lengths[i]
    for i in range(lengths.size):
        sums[i] = totals[parent[places[2 * i]]]
    return sums


def long_groups(polylines: Polylines, lengths: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Polylines of groups that are long enough together.

    Parameters
    ----------
    polylines
        Those that meet at an end, a whole corner (row, column), are of one group.
    lengths
        Their lengths, shape (n,).
    least
        Length of a group, in their unit.

    Returns
    -------
    ndarray of bool, shape (n,)

    Examples
    --------
    The first two meet at (0, 5).

    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.groups import long_groups
    >>> vertices = np.array([[0, 0], [0, 5], [0, 5], [4, 5], [9, 0], [9, 6]])
    >>> lines = Polylines(np.array([0, 2, 4, 6]), vertices)
    >>> long_groups(lines, lines.lengths(), least=8.0).tolist()
    [True, True, False]
    """
    places = np.unique(place_numbers(polylines.ends), return_inverse=True)[1]
    return _group_lengths(places, np.asarray(lengths, np.float64)) >= least


def meet_others(
    polylines: Polylines, window: tuple[int, int, int, int], origin: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Polylines of a tile core that share an end with another one, or end where another tile's may end.

    Parameters
    ----------
    polylines
        Of one core, with whole vertices (row, column).
    window
        First row, end row, first column, end column of the core in its block.
    origin
        Global (row, column) of the block.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    top, bottom, left, right = window
    corner = origin[0] + top, origin[1] + left
    ends = _ends_at_corners(polylines.offsets, polylines.vertices, corner, (bottom - top + 1, right - left + 1))
    return _meeting(polylines.offsets, polylines.vertices, corner, ends)


@loop
def _ends_at_corners(
    offsets: Int64, vertices: Vertices, corner: tuple[int, int], shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """How many ends of polylines lie at each corner of the core, the upper left one at ``corner``."""
    ends = np.zeros(shape, np.uint8)
    for i in range(len(offsets) - 1):
        for k in (offsets[i], offsets[i + 1] - 1):
            ends[vertices[k, 0] - corner[0], vertices[k, 1] - corner[1]] += 1
    return ends


@loop
def _meeting(offsets: Int64, vertices: Vertices, corner: tuple[int, int], ends: NDArray[np.uint8]) -> NDArray[np.bool_]:
    meet = np.zeros(len(offsets) - 1, np.bool_)
    for i in range(meet.size):
        first, last = vertices[offsets[i]], vertices[offsets[i + 1] - 1]
        # both ends of a ring are one place
        own = 2 if first[0] == last[0] and first[1] == last[1] else 1
        for end in (first, last):
            row, column = end[0] - corner[0], end[1] - corner[1]
            inside = 0 < row < ends.shape[0] - 1 and 0 < column < ends.shape[1] - 1
            meet[i] |= not inside or ends[row, column] != own
    return meet
