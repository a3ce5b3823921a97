"""Region growing by flood fill, and measures of regions by counting, rectangle by rectangle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))


def rectangle_centers(block: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    height, width = block.shape
    return np.array(
        [
            [block[min(i + rows // 2, height - 1), min(j + columns // 2, width - 1)] for j in range(0, width, columns)]
            for i in range(0, height, rows)
        ]
    )


def grow_regions(values: NDArray[np.float32], tolerance: float, maximum: float = math.inf) -> NDArray[np.int32]:
    labels = np.zeros(values.shape, np.int32)
    can_belong = np.isfinite(values) & (values <= maximum)
    rows, columns = values.shape
    found = 0
    for first in np.ndindex(values.shape):
        if not can_belong[first] or labels[first]:
            continue
        found += 1
        labels[first] = found
        open_ends = [first]
        while open_ends:
            i, j = open_ends.pop()
            for di, dj in SIDES:
                near = (i + di, j + dj)
                inside = 0 <= near[0] < rows and 0 <= near[1] < columns
                if inside and can_belong[near] and not labels[near] and abs(values[near] - values[i, j]) <= tolerance:
                    labels[near] = found
                    open_ends.append(near)
    return labels


def measures(
    labels: NDArray[np.int32], values: NDArray[np.float32], label: int, borders: tuple[bool, bool, bool, bool]
) -> dict[str, int]:
    rows, columns = labels.shape
    places = [place for place in np.ndindex(labels.shape) if labels[place] == label]
    cracks = [0, 0]
    for i, j in places:
        for side, (di, dj) in enumerate(SIDES):
            inside = 0 <= i + di < rows and 0 <= j + dj < columns
            cracks[side // 2] += int(labels[i + di, j + dj] != label) if inside else int(borders[side])
    i_all, j_all = zip(*places, strict=True)
    return {
        "count": len(places),
        "first": places[0][0] * columns + places[0][1],
        "horizontal_cracks": cracks[0],
        "vertical_cracks": cracks[1],
        "grey_sum": sum(round(float(values[place]) * 256) for place in places),
        "top": min(i_all),
        "left": min(j_all),
        "bottom": max(i_all),
        "right": max(j_all),
    }
