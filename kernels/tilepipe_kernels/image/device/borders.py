"""`borders` on the device: every border pixel sums its window."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.image.borders import BORDER, SIDE, STREET, street_level


@grid
def _levels(count: int, kind: Any, packed: Any, rows: int, columns: int, half: int, apart: float, levels: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        if kind[p] != BORDER:
            continue
        i, j = p // columns, p % columns
        street, streets, side, sides = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
        for y in range(max(0, i - half), min(rows, i + half + 1)):
            for x in range(max(0, j - half), min(columns, j + half + 1)):
                q = y * columns + x
                if kind[q] == STREET:
                    street, streets = street + (np.int64(packed[q]) >> 1), streets + 1
                elif kind[q] == SIDE:
                    side, sides = side + (np.int64(packed[q]) >> 1), sides + 1
        levels[p] = street_level(np.int64(packed[p]) >> 1, street, streets, side, sides, apart)


def levels(kind: Any, packed: Any, half: int, apart: float, found: Any) -> None:
    """Levels of the streets beside border pixels, see `borders.with_borders`; the rest of ``found`` stays."""
    xp = namespace(kind, packed)
    flat = (xp.ascontiguousarray(each).reshape(-1) for each in (kind, packed))
    _levels(kind.size, *flat, *kind.shape, half, apart, found.reshape(-1))
