"""Quadtree split by recursion over lists of pixels, with Python's integers and fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

MISSING = -(2**31)
Leaf = tuple[int, int, int, int, int]
"""First (flat index), level, count, total, squares."""


def variance(values: list[int]) -> Fraction:
    mean = Fraction(sum(values), len(values))
    return sum((value - mean) ** 2 for value in values) / len(values)


def split(
    ticks: NDArray[np.int32], threshold: Fraction, smallest: int, largest: int
) -> tuple[NDArray[np.int32], list[Leaf]]:
    rows, columns = ticks.shape
    squares: list[tuple[int, int, int]] = [
        (i, j, largest) for i in range(0, rows, largest) for j in range(0, columns, largest)
    ]
    leaves: list[tuple[Leaf, list[int]]] = []
    while squares:
        top, left, side = squares.pop()
        places = [
            i * columns + j
            for i in range(top, min(top + side, rows))
            for j in range(left, min(left + side, columns))
            if ticks[i, j] != MISSING
        ]
        values = [int(ticks.flat[place]) for place in places]
        if not values:
            continue
        if side > smallest and variance(values) > threshold:
            half = side // 2
            squares += [(top + di, left + dj, half) for di in (0, half) for dj in (0, half)]
        else:
            level, total = side.bit_length() - 1, sum(values)
            leaves.append(((places[0], level, len(values), total, sum(value**2 for value in values)), places))
    labels = np.zeros(ticks.shape, np.int32)
    leaves.sort()
    for number, (_, places) in enumerate(leaves, 1):
        labels.flat[places] = number
    return labels, [leaf for leaf, _ in leaves]
