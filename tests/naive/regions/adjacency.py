"""Contacts of regions by looking at every pair of adjacent pixels."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray


def contacts(labels: NDArray[np.int32]) -> list[tuple[int, int, int]]:
    """Lower label, higher label, number of cracks; sorted."""
    cracks: Counter[tuple[int, int]] = Counter()
    for i, j in np.ndindex(labels.shape):
        for di, dj in ((0, 1), (1, 0)):
            if i + di < labels.shape[0] and j + dj < labels.shape[1]:
                a, b = sorted((int(labels[i, j]), int(labels[i + di, j + dj])))
                if a != b and a != 0:
                    cracks[a, b] += 1
    return [(a, b, length) for (a, b), length in sorted(cracks.items())]
