"""Brute-force arcs: sets of cracks of one whole raster, followed corner by corner; regions filled by ray casting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Corner = tuple[int, int]
Arc = tuple[tuple[Corner, ...], int, int]
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # down, right, up, left


def label_at(labels: NDArray[np.int32], row: int, column: int) -> int:
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    return int(labels[row, column]) if inside else 0


def sides(labels: NDArray[np.int32], corner: Corner, heading: int) -> tuple[int, int]:
    """Labels on the left and on the right of one crack."""
    pixels = ((0, 0), (-1, 0), (-1, -1), (0, -1))  # on the left of each heading
    left, right = pixels[heading], pixels[heading - 1]
    at = [label_at(labels, corner[0] + r, corner[1] + c) for r, c in (left, right)]
    return at[0], at[1]


def headings(labels: NDArray[np.int32], corner: Corner) -> list[int]:
    return [heading for heading in range(4) if len(set(sides(labels, corner, heading))) == 2]


def walk(labels: NDArray[np.int32], start: Corner, heading: int) -> tuple[list[Corner], int]:
    """All corners from a start to the next junction or back, and the heading of the last crack."""
    chain = [start]
    while True:
        corner = (chain[-1][0] + STEPS[heading][0], chain[-1][1] + STEPS[heading][1])
        chain.append(corner)
        onward = headings(labels, corner)
        if len(onward) > 2 or corner == start:
            return chain, heading
        (heading,) = (other for other in onward if other != (heading + 2) % 4)


def turns(chain: list[Corner]) -> tuple[Corner, ...]:
    """Only the ends and the corners at which the chain turns."""
    kept = [chain[0]]
    for before, corner, after in zip(chain, chain[1:], chain[2:], strict=False):
        if (corner[0] - before[0], corner[1] - before[1]) != (after[0] - corner[0], after[1] - corner[1]):
            kept.append(corner)
    return (*kept, chain[-1])


def arcs(labels: NDArray[np.int32]) -> list[Arc]:
    """Each arc as its turning corners, left and right label; canonical direction, sorted."""
    corners = [(r, c) for r in range(labels.shape[0] + 1) for c in range(labels.shape[1] + 1)]
    found, walked = {}, set()
    for rings in (False, True):
        for corner in corners:
            onward = headings(labels, corner)
            if not onward or (len(onward) == 2) != rings or (rings and corner in walked):
                continue
            for heading in onward[:1] if rings else onward:
                chain, last = walk(labels, corner, heading)
                walked.update(chain)
                if (corner, heading) <= (chain[-1], (last + 2) % 4) or rings:
                    found[corner, heading] = (turns(chain), *sides(labels, corner, heading))
    return [found[key] for key in sorted(found)]
