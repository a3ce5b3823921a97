"""Crack lines: polylines along the cracks that a line field marks as edges, as far as one tile core can see them.

A crack is a pixel side whose line element is 1.  Corners at which other than two of them meet end a line; what is
left are closed rings.  Fragments are traced, cut at the core's border and joined as those of `polylines.arcs`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.mrf.edge_model import Field, Floats, checked_observed
from tilepipe_kernels.polylines.cracks import Core, Corners, CrackFragments, trace_cracks

TICKS = 1 << 12
"""Ticks per grey level, in which differences of grey are summed: integers have the same sum in any order."""

_LARGEST = np.float64(2**40)


@dataclass(frozen=True)
class CrackLineFragments(CrackFragments):
    """The fragments of crack lines of one tile core.

    Attributes
    ----------
    contrast
        int64, shape (n,): sum over the cracks of the absolute difference of grey across them, in ticks.
    step
        int64, shape (n,): sum of the grey to the left of the cracks less that to their right, in ticks.
    """

    contrast: NDArray[np.int64]
    step: NDArray[np.int64]


def halo() -> int:
    """Pixels needed around the core: one, since a tile owns the upper and left sides of its pixels."""
    return 1


@loop
def _cracks_of_elements(h: Field, v: Field) -> Corners:
    """Bits of the cracks that meet at the corners between framed pixels."""
    corners = np.empty((h.shape[0] - 1, h.shape[1] - 1), np.uint8)
    for i in range(corners.shape[0]):
        row, above, below, across = corners[i], v[i], v[i + 1], h[i]
        for j in range(row.size):
            down, up = np.uint8(below[j] == 1), np.uint8(above[j] == 1)
            right, left = np.uint8(across[j + 1] == 1), np.uint8(across[j] == 1)
            row[j] = down | right << 1 | up << 2 | left << 3
    return corners


@rule
def ticks_between(a: np.float32, b: np.float32) -> np.int64:
    """First grey value less the second in ticks; 0 if one is missing."""
    difference = (np.float64(a) - np.float64(b)) * TICKS
    if np.isnan(difference):
        return np.int64(0)
    ticks = np.int64(min(abs(difference), _LARGEST) + 0.5)
    return ticks if difference > 0 else -ticks


@loop
def _contrasts(
    grey: Floats, origin: tuple[int, int], offsets: NDArray[np.int64], vertices: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sums of the absolute and of the signed differences of grey across the cracks of each fragment."""
    contrast, step = np.zeros(len(offsets) - 1, np.int64), np.zeros(len(offsets) - 1, np.int64)
    for fragment in range(step.size):
        for k in range(offsets[fragment], offsets[fragment + 1] - 1):
            i, j = vertices[k, 0] - origin[0], vertices[k, 1] - origin[1]
            last_i, last_j = vertices[k + 1, 0] - origin[0], vertices[k + 1, 1] - origin[1]
            for row in range(min(i, last_i), max(i, last_i)):
                ticks = ticks_between(grey[row + 1, j + 1], grey[row + 1, j])  # what is right lies left of going down
                contrast[fragment] += abs(ticks)
                step[fragment] += ticks if last_i > i else -ticks
            for column in range(min(j, last_j), max(j, last_j)):
                ticks = ticks_between(grey[i, column + 1], grey[i + 1, column + 1])
                contrast[fragment] += abs(ticks)
                step[fragment] += ticks if last_j > j else -ticks
    return contrast, step


def trace_crack_lines(
    horizontal: Field,
    vertical: Field,
    observed: ArrayLike,
    core: tuple[int, int, int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
) -> CrackLineFragments:
    """Trace the crack lines of a tile core.

    The tile owns the upper and left sides of its core's pixels.  So the fragments of all tiles hold every edge once.

    Parameters
    ----------
    horizontal, vertical
        Elements h and v, uint8, shape (rows, columns), as `line_field` gives them; only 1 is an edge.
    observed
        Grey values of any real dtype, same shape, for the contrast.
    core
        Window (first row, end row, first column, end column) of the core in the block; the whole block if None.
        Where the core reaches the block's border, that is the raster's border; elsewhere the block goes on for
        `halo` pixels at least.
    origin
        Global (row, column) of ``horizontal[0, 0]``.

    Returns
    -------
    CrackLineFragments
        Fragments that end somewhere, in row-major order of their first corner, which is the lower of the two; then the
        rings, which start and end at their lowest corner and go down first.  Vertices are corners: (row, column) is
        the upper left corner of that pixel.

    Raises
    ------
    ValueError
        For arrays of different shapes, elements that are not uint8, a core that is no window of the block, or a
        negative origin.

    Examples
    --------
    An edge of three pixels between grey 100 and grey 150.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.crack_lines import trace_crack_lines
    >>> grey = np.repeat([[100.0, 100.0, 150.0, 150.0]], 3, axis=0)
    >>> vertical = np.repeat(np.array([[0, 1, 0, 0]], np.uint8), 3, axis=0)
    >>> trace_crack_lines(np.zeros_like(vertical), vertical, grey).vertices.tolist()  # corners of pixels
    [[0, 2], [3, 2]]
    """
    grey = checked_observed(observed)
    for name, field in (("horizontal", horizontal), ("vertical", vertical)):
        if field.shape != grey.shape or field.dtype != np.uint8:
            raise ValueError(
                f"{name} must be uint8 of the shape {grey.shape} of the observed block, not {field.dtype} {field.shape}"
            )
    window = Core.of(grey.shape, core, origin)
    first = origin[0] + window.top, origin[1] + window.left
    corners = _cracks_of_elements(window.framed(horizontal), window.framed(vertical))
    offsets, vertices, cut = trace_cracks(corners, *window.corners, first)
    return CrackLineFragments(offsets, vertices, cut, *_contrasts(window.framed(grey), first, offsets, vertices))
