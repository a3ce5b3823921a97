"""Polylines as LineStrings in well-known binary (WKB; Simple Feature Access, OGC 06-103r4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import Int64

HEADER, VERTEX, LINE_STRING = 9, 16, 2
"""Bytes before the vertices of a LineString, and of a vertex; WKB's number of the type."""


@loop
def _write(offsets: Int64, coordinates: NDArray[np.uint8], wkb: NDArray[np.uint8]) -> None:
    """Bytes of LineStrings one after the other: byte order (little-endian), type, number of vertices, coordinates."""
    at = 0
    for line in range(offsets.size - 1):
        count = offsets[line + 1] - offsets[line]
        wkb[at], wkb[at + 1] = 1, LINE_STRING
        wkb[at + 2 : at + 5] = 0
        for byte in range(4):
            wkb[at + 5 + byte] = count >> 8 * byte & 255
        at += HEADER
        wkb[at : at + VERTEX * count] = coordinates[VERTEX * offsets[line] : VERTEX * offsets[line + 1]]
        at += VERTEX * count


def line_strings(polylines: Polylines) -> tuple[Int64, NDArray[np.uint8]]:
    """Polylines as little-endian LineStrings.

    Parameters
    ----------
    polylines
        With vertices (x, y), float64.

    Returns
    -------
    offsets
        int64, shape (n + 1,): LineString i has the bytes ``offsets[i]`` to ``offsets[i + 1]``.
    bytes
        uint8.
    """
    offsets = HEADER * np.arange(len(polylines) + 1) + VERTEX * polylines.offsets
    wkb = np.empty(int(offsets[-1]), np.uint8)
    _write(polylines.offsets, polylines.vertices.astype("<f8", copy=False).reshape(-1).view(np.uint8), wkb)
    return offsets, wkb
