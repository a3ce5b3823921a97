"""The buffer method by dense sampling: slow and plain, for comparison."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray


def sampled_match(
    lines: list[shapely.LineString], others: list[shapely.LineString], buffer: float, step: float
) -> tuple[float, float, NDArray[np.float64]]:
    """Length, matched length, and distance of each matched sample of `lines` to `others`."""
    union = shapely.union_all(others)
    total = matched = 0.0
    distances: list[float] = []
    for line in lines:
        count = int(np.ceil(line.length / step))
        points = shapely.line_interpolate_point(line, (np.arange(count) + 0.5) * line.length / count)
        distance = shapely.distance(points, union)
        total += line.length
        matched += float((distance <= buffer).mean()) * line.length
        distances.extend(distance[distance <= buffer])
    return total, matched, np.array(distances)
