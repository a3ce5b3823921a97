"""Slow, literal versions of the distance transform, the skeleton and the morphology."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

EIGHT = np.ones((3, 3), bool)
NEIGHBOURS = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]


def nearest_background(mask: NDArray[Any], cap: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Squared distance and offsets by comparing every pixel with every background pixel."""
    squared = np.zeros(mask.shape, int)
    rows, columns = np.zeros(mask.shape, int), np.zeros(mask.shape, int)
    background = np.argwhere(~mask)
    for i, j in np.argwhere(mask):
        found = min(((r - i) ** 2 + (c - j) ** 2, r - i, c - j) for r, c in background) if len(background) else None
        if found is None or found[0] > cap * cap:
            squared[i, j] = cap * cap + 1
        else:
            squared[i, j], rows[i, j], columns[i, j] = found
    return squared, rows, columns


def components(mask: NDArray[Any]) -> tuple[int, int]:
    """Number of 8-connected parts of a mask, and of 4-connected parts of its complement in the plane."""
    return ndimage.label(mask, EIGHT)[1], ndimage.label(~np.pad(mask, 1))[1]


@functools.cache
def is_simple(neighbours: tuple[int, ...]) -> bool:
    """Whether deleting the centre of a 3×3 window keeps the 8-parts and the 4-holes of the image.

    So it is when the foreground neighbours are one 8-connected part, and one 4-connected part of the
    background neighbours shares a side with the centre.
    """
    window = np.zeros((3, 3), bool)
    for value, (r, c) in zip(neighbours, NEIGHBOURS, strict=True):
        window[1 + r, 1 + c] = value
    foreground = ndimage.label(window, EIGHT)[1]
    background = ~window
    background[1, 1] = False
    labels = ndimage.label(background)[0]
    touching = {labels[1 + r, 1 + c] for r, c in NEIGHBOURS if r * c == 0} - {0}
    return foreground == 1 and len(touching) == 1


def window_of(mask: NDArray[Any], i: int, j: int) -> tuple[int, ...]:
    rows, columns = mask.shape
    return tuple(int(0 <= i + r < rows and 0 <= j + c < columns and mask[i + r, j + c]) for r, c in NEIGHBOURS)


def anchors(
    squared: NDArray[Any], features: NDArray[Any], cap: int, separation: float, angle: float
) -> NDArray[np.bool_]:
    """Integer medial axis; `features` (rows, columns, 2) are positions of nearest background pixels."""
    rows, columns = squared.shape
    found = np.zeros(squared.shape, bool)
    for i in range(rows):
        for j in range(columns):
            for r, c in ((0, 1), (1, 0)):
                p, q = (i, j), (i + r, j + c)
                if q[0] == rows or q[1] == columns or max(squared[p], squared[q]) > cap * cap:
                    continue
                least = separation
                if min(squared[p], squared[q]) > 0:
                    chord = 2 * math.sin(math.radians(angle) / 2) * math.sqrt(min(squared[p], squared[q]))
                    least = max(separation, chord + 1)
                if math.dist(features[p], features[q]) <= least:
                    continue
                middle = (i + r / 2, j + c / 2)
                p_nearer = math.dist(middle, features[q]) <= math.dist(middle, features[p])
                chosen = p if p_nearer else q
                found[chosen] |= squared[chosen] > 0
    return found


def medial_axis(
    mask: NDArray[Any], cap: int, separation: float, angle: float, origin: tuple[int, int], sweeps: int
) -> NDArray[np.bool_]:
    """The skeleton by sweeps over the whole array, one pixel after the other."""
    squared, row_offset, column_offset = nearest_background(mask, cap)
    features = np.stack(np.indices(mask.shape), -1) + np.stack([row_offset, column_offset], -1)
    fixed = anchors(squared, features, cap, separation, angle)
    present = mask.copy()
    row, column = np.indices(mask.shape)
    subfield = (row + origin[0]) % 2 * 2 + (column + origin[1]) % 2
    layer = np.ceil(np.sqrt(squared))
    shallow = squared <= cap * cap

    def step(candidates: NDArray[Any], spare_ends: NDArray[Any]) -> None:
        for i, j in np.argwhere(candidates & present):
            window = window_of(present, i, j)
            if is_simple(window) and not (spare_ends[i, j] and sum(window) == 1):
                present[i, j] = False

    for k in range(1, cap + 1):
        for field in range(4):
            step((layer <= k) & shallow & ~fixed & (subfield == field), layer < k)
    for _ in range(sweeps):
        for field in range(4):
            step(shallow & (subfield == field), np.ones(mask.shape, bool))
    return present & shallow


def links(skeleton: NDArray[Any]) -> NDArray[np.uint8]:
    """Mixed adjacency by its definition on pairs of pixels."""
    padded = np.pad(skeleton, 1)
    found = np.zeros(padded.shape, np.uint8)
    for i, j in np.argwhere(padded):
        for k, (r, c) in enumerate(NEIGHBOURS):
            bridged = r * c != 0 and (padded[i + r, j] or padded[i, j + c])
            if padded[i + r, j + c] and not bridged:
                found[i, j] |= 1 << k
    return found[1:-1, 1:-1]


def fill_specks(mask: NDArray[Any], size: int) -> NDArray[np.bool_]:
    filled = mask.copy()
    labels, count = ndimage.label(~mask)
    for k in range(1, count + 1):
        position = np.argwhere(labels == k)
        low, high = position.min(0), position.max(0)
        if low.min() > 0 and (high < np.array(mask.shape) - 1).all() and (high - low).max() < size:
            filled[labels == k] = True
    return filled


def disc(radius: float) -> NDArray[np.bool_]:
    reach = math.ceil(radius)
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return row**2 + column**2 <= radius**2
