"""Arcs between labelled regions: polylines along the cracks between pixels, as far as one tile core can see them.

A *junction* is a corner where three or four cracks meet, and an *arc* a polyline along cracks between two junctions, or
a closed ring without one: it has one region on its left, another on its right. See `polylines.cracks` for the words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.polylines.cracks import (
    DOWN,
    LEFT,
    RIGHT,
    UP,
    Core,
    Corners,
    CrackFragments,
    heading_of,
    trace_cracks,
)

Labels = NDArray[np.int32] | NDArray[np.uint32]


@dataclass(frozen=True)
class ArcFragments(CrackFragments):
    """The fragments of arcs of one tile core.

    Attributes
    ----------
    left, right
        Labels on the two sides, shape (n,), dtype of the labels; 0 = nodata or outside the raster.
    """

    left: Labels
    right: Labels


def halo() -> int:
    """Pixels needed around the core: one, since a tile owns the upper and left sides of its pixels."""
    return 1


@loop
def _cracks_of_row(above: NDArray[Any], below: NDArray[Any], into: Corners) -> None:
    for j in range(into.size):
        down = 1 if below[j] != below[j + 1] else 0
        right = 2 if above[j + 1] != below[j + 1] else 0
        up = 4 if above[j] != above[j + 1] else 0
        left = 8 if above[j] != below[j] else 0
        into[j] = down | right | up | left


@loop
def _cracks_of_labels(labels: NDArray[Any]) -> Corners:
    corners = np.empty((labels.shape[0] - 1, labels.shape[1] - 1), np.uint8)
    for i in range(corners.shape[0]):
        _cracks_of_row(labels[i], labels[i + 1], corners[i])
    return corners


@loop
def _sides(
    labels: NDArray[Any], origin: tuple[int, int], offsets: NDArray[np.int64], vertices: NDArray[np.int32],
    left: NDArray[Any], right: NDArray[Any],
) -> None:  # fmt: skip
    """Write the labels to the left and right of the first crack of each fragment."""
    for fragment in range(left.size):
        first, second = vertices[offsets[fragment]], vertices[offsets[fragment] + 1]
        heading = heading_of(first[0], first[1], second[0], second[1])
        i, j = first[0] - origin[0], first[1] - origin[1]
        left[fragment] = labels[i + (heading in (DOWN, LEFT)), j + (heading in (DOWN, RIGHT))]
        right[fragment] = labels[i + (heading in (DOWN, RIGHT)), j + (heading in (RIGHT, UP))]


def trace_arcs(
    labels: Labels,
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
) -> ArcFragments:
    """Trace the arcs between the regions of a tile core.

    The tile owns the upper and left sides of its core's pixels, and the lower and right sides on the raster's border.
    So the fragments of all tiles hold every crack once.

    Parameters
    ----------
    labels
        int32 or uint32, shape (rows, columns): global labels of a block; 0 = nodata.
    core
        Window (first row, end row, first column, end column) of the core in the block; the whole block if None.
        Where the core reaches the block's border, that is the raster's border; elsewhere the block goes on for
        `halo` pixels at least.
    origin
        Global (row, column) of ``labels[0, 0]``.

    Returns
    -------
    ArcFragments
        Fragments that end somewhere, in row-major order of their first corner, which is the lower of the two; then the
        rings, which start and end at their lowest corner and go down first, with what they surround on their left.

    Raises
    ------
    ValueError
        If the labels are not a two-dimensional int32 or uint32 array, the core is no window of it, or the
        origin is negative.

    Examples
    --------
    Two regions side by side: one arc parts them, two part them from the outside.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> arcs = trace_arcs(np.array([[1, 1, 2], [1, 1, 2]], np.int32))
    >>> [sorted(sides) for sides in zip(arcs.left.tolist(), arcs.right.tolist(), strict=True)]
    [[1, 2], [0, 2], [0, 1]]
    """
    if labels.ndim != 2 or labels.dtype not in (np.int32, np.uint32):
        raise ValueError(f"labels must be a 2-D array of int32 or uint32, got {labels.ndim}-D {labels.dtype}")
    window = Core.of(labels.shape, core, origin)
    around = window.framed(labels)
    first = origin[0] + window.top, origin[1] + window.left
    offsets, vertices, cut = trace_cracks(_cracks_of_labels(around), *window.corners, first)
    left, right = np.empty_like(labels, shape=len(cut)), np.empty_like(labels, shape=len(cut))
    _sides(around, first, offsets, vertices, left, right)
    return ArcFragments(offsets, vertices, cut, left, right)
