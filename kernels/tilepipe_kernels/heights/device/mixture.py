"""`mixture` on the device: a thread for every item, and one for every lane of a class's moments."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.sums import sum_lanes
from tilepipe_kernels.core.sums import BLOCK, LANES
from tilepipe_kernels.heights.mixture import CLASSES, MOMENTS, Normal, log_ratio, moments_of, weights_of_classes


@grid
def compare(count: int, features: Any, offset: float, one: Normal, other: Normal, found: Any) -> None:
    """Write the evidence of every item for class 0."""
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        found[i] = log_ratio(features[i, 0], features[i, 1], offset, one, other)


@grid
def _add_moments(count: int, features: Any, weight: Any, evidence: Any, lanes: Any) -> None:
    """Sum the moments of a class over a lane: thread p has lane p // CLASSES and class p % CLASSES."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        at, k = p // CLASSES, p % CLASSES
        low = at // LANES * BLOCK
        w, wx, wy, wxx, wxy, wyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(low + at % LANES, min(low + BLOCK, weight.size), LANES):
            first, second = weights_of_classes(weight[i], evidence[i])
            more = moments_of(first if k == 0 else second, features[i, 0], features[i, 1])
            w, wx, wy = w + more[0], wx + more[1], wy + more[2]
            wxx, wxy, wyy = wxx + more[3], wxy + more[4], wyy + more[5]
        to = MOMENTS * k
        lanes[at, to], lanes[at, to + 1], lanes[at, to + 2] = w, wx, wy
        lanes[at, to + 3], lanes[at, to + 4], lanes[at, to + 5] = wxx, wxy, wyy


def moments(features: Any, weight: Any, evidence: Any) -> Any:
    """Moments of both classes in blocks of items, (blocks, CLASSES * MOMENTS), on the device."""
    xp = namespace(features)
    blocks = -(-weight.size // BLOCK)
    lanes, sums = xp.empty((blocks * LANES, CLASSES * MOMENTS)), xp.empty((blocks, CLASSES * MOMENTS))
    _add_moments(blocks * LANES * CLASSES, features, weight, evidence, lanes)
    sum_lanes(lanes, sums)
    return sums
