"""`surface` on the device: a thread looks at the whole window of its pixel; sums of whole numbers have no order."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.heights.surface_shape import MISSING, NOWHERE, least_bend, plane_deviation_metres

_NOTHING: Any = np.int64(0)


@grid
def _measure(count: int, deviation: Any, bend: Any, ticks: Any, half_width: int) -> None:
    """Deviation from the plane of the window (`NOWHERE` if unknown) and bend; `ticks` has the half width around."""
    columns, r = bend.shape[1], half_width
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        here = ticks[i + r, j + r]
        bend[i, j] = least_bend(
            here, ticks[i + r, j], ticks[i + r, j + 2 * r], ticks[i, j + r], ticks[i + 2 * r, j + r],
            ticks[i, j], ticks[i + 2 * r, j + 2 * r], ticks[i, j + 2 * r], ticks[i + 2 * r, j],
        )  # fmt: skip
        deviation[i, j] = NOWHERE
        if here == MISSING:
            continue
        n = x = y = z = xx = xy = yy = xz = yz = zz = _NOTHING
        for down in range(-r, r + 1):
            for right in range(-r, r + 1):
                tick = ticks[i + r + down, j + r + right]
                if tick != MISSING:
                    height = np.int64(tick)
                    n += 1
                    x, y, z = x + right, y + down, z + height
                    xx, xy, yy = xx + right * right, xy + right * down, yy + down * down
                    xz, yz, zz = xz + right * height, yz + down * height, zz + height * height
        deviation[i, j] = plane_deviation_metres(n, x, y, z, xx, xy, yy, xz, yz, zz)


def measure(padded: Any, shape: tuple[int, int], half_width: int) -> tuple[Any, Any]:
    """Deviations (`NOWHERE` if unknown) and bends of an int32 device array with `half_width` missing pixels around."""
    xp = namespace(padded)
    deviation, bend = xp.empty(shape, xp.float32), xp.empty(shape, xp.float32)
    _measure(deviation.size, deviation, bend, padded, half_width)
    return deviation, bend
