"""`nevatia_babu.masks` on the device: a thread for every pixel, whose neighbours the caches hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.nevatia_babu.masks import MASK_RADIUS, NO_DIRECTION, edge_at

_UNKNOWN = np.float32(np.nan)


@cuda.jit(device=True)
def _five(image: Any, i: int, j: int) -> Any:
    """Five pixels of a row around a column."""
    return image[i, j - 2], image[i, j - 1], image[i, j], image[i, j + 1], image[i, j + 2]


@grid
def _respond(count: int, image: Any, magnitude: Any, direction: Any) -> None:
    rows, columns = image.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        if min(i, rows - 1 - i, j, columns - 1 - j) < MASK_RADIUS:
            magnitude[i, j], direction[i, j] = _UNKNOWN, NO_DIRECTION
            continue
        size, turned = edge_at(
            _five(image, i - 2, j), _five(image, i - 1, j), _five(image, i, j), _five(image, i + 1, j),
            _five(image, i + 2, j),
        )  # fmt: skip
        magnitude[i, j], direction[i, j] = size, np.uint8(turned)


def respond(image: Any) -> tuple[Any, Any]:
    """Magnitude and direction of a float32 device array, as of `nevatia_babu.masks.edge_responses`."""
    xp = namespace(image)
    magnitude, direction = xp.empty(image.shape, xp.float32), xp.empty(image.shape, xp.uint8)
    _respond(image.size, image, magnitude, direction)
    return magnitude, direction
