"""Distances from the boundaries of one layer to the nearest of another, integrated over their length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.evaluate.segment_matching import lengths

Float = NDArray[np.float64]

_RUN, _CHUNK = 24, 2048
"""Samples of one run of a boundary, and runs handled at once: they bound the memory."""

_ROUNDING = 1e-9
"""Relative rounding error of a distance."""


@dataclass(frozen=True)
class BoundaryScore:
    """Distances (m) from the boundary of one layer to the nearest boundary of the other; NaN where none is near.

    `near` is the share of the boundary's length within the cutoff; `rms` and `mean` are those of that part.
    """

    rms: float
    mean: float
    near: float
    length: float


def boundary_score(a: Float, b: Float, cutoff: float, step: float) -> BoundaryScore:
    """Distances from the segments `a` to the nearest of `b`, integrated over the length of `a`.

    Examples
    --------
    A wall of 10 m, one metre beside the true one.

    >>> import numpy as np
    >>> from tilepipe.evaluate.boundary_distances import boundary_score
    >>> wall = np.array([[[0.0, 0.0], [10.0, 0.0]]])
    >>> boundary_score(wall + [0.0, 1.0], wall, cutoff=3.0, step=0.5)
    BoundaryScore(rms=1.0, mean=1.0, near=1.0, length=10.0)
    """
    near = total = squares = 0.0
    for distance, weight in _nearest_distances(a, b, cutoff, step):
        close = distance <= cutoff * (1 + _ROUNDING)
        weight = np.broadcast_to(weight[:, None], distance.shape)[close]
        distance = distance[close]
        near += float(weight.sum())
        total += float((weight * distance).sum())
        squares += float((weight * distance * distance).sum())
    length = float(lengths(a).sum())
    rms, mean = (math.sqrt(squares / near), total / near) if near else (math.nan, math.nan)
    return BoundaryScore(rms=rms, mean=mean, near=min(near / length, 1.0) if length else math.nan, length=length)


def _nearest_distances(a: Float, b: Float, cutoff: float, step: float) -> Iterator[tuple[Float, Float]]:
    """Yield distances (n, k) from k samples of n pieces of `a` to `b`, inf beyond reach, and the sample length (n,)."""
    import shapely

    tree = shapely.STRtree(shapely.linestrings(b))
    a = _cut(a, _RUN * step)
    samples = np.maximum(np.ceil(lengths(a) / step), 1).astype(np.int64)
    # The distances are tested on their own, so the bounds may be wider.
    reach = 1.001 * cutoff
    for count in np.unique(samples):
        alike = a[samples == count]
        for low in range(0, len(alike), _CHUNK):
            run = alike[low : low + _CHUNK]
            # The tree asks only for the bounds, and a diagonal has those of its box.
            diagonals = shapely.linestrings(np.stack([run.min(axis=1) - reach, run.max(axis=1) + reach], axis=1))
            i, j = tree.query(diagonals)
            squared = np.full((len(run), count), np.inf)
            if len(i):
                found, first = np.unique(i, return_index=True)
                squared[found] = np.minimum.reduceat(_squared_distances(run[i], b[j], count), first, axis=0)
            yield np.sqrt(squared), lengths(run) / count


def _cut(a: Float, longest: float) -> Float:
    """Cut segments into equal pieces no longer than given."""
    count = np.maximum(np.ceil(lengths(a) / longest), 1).astype(np.int64)
    source = np.repeat(np.arange(len(a)), count)
    place = (np.arange(len(source)) - (np.cumsum(count) - count)[source])[:, None]
    delta = (a[:, 1] - a[:, 0])[source] / count[source, None]
    start = a[source, 0] + place * delta
    pieces: Float = np.stack([start, start + delta], axis=1)
    return pieces


def _squared_distances(a: Float, b: Float, count: int) -> Float:
    """Squared distances (n, count) from the middles of `count` equal parts of each segment to its partner."""
    t = (np.arange(count) + 0.5) / count
    (x, y), (u, v), (along, up) = (a[:, 0] - b[:, 0]).T, (a[:, 1] - a[:, 0]).T, (b[:, 1] - b[:, 0]).T
    squared_length = along * along + up * up
    # Both the sample and its foot on the partner's line move linearly.
    foot = ((x * along + y * up) / squared_length)[:, None] + ((u * along + v * up) / squared_length)[:, None] * t
    np.clip(foot, 0.0, 1.0, out=foot)
    across = x[:, None] + u[:, None] * t - along[:, None] * foot
    upward = y[:, None] + v[:, None] * t - up[:, None] * foot
    squared: Float = across * across + upward * upward
    return squared
