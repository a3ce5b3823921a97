"""Which parts of some straight segments lie within a distance of others, exactly.

The points within a distance of a segment form a convex set, so another segment meets it in one interval of
its parameter t (0 at its start, 1 at its end). The union of these intervals over all close pairs is the
matched part.

Segments are arrays (n, 2, 2) float64: both ends, x and y.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Float = NDArray[np.float64]
Index = NDArray[np.int64]

# Segments and point pairs handled at once: bounds the memory.
_CHUNK = 1 << 20


class Intervals(NamedTuple):
    """Disjoint parts of segments, sorted: number of the segment (k,), start and end (k,) in its parameter."""

    segment: Index
    start: Float
    end: Float


def segments(lines: ArrayLike, area: BaseGeometry | None = None) -> Float:
    """Straight segments of shapely lines, clipped to a polygon; zero-length ones are left out.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.evaluate.segment_matching import lengths, segments
    >>> bend = shapely.linestrings([[[0, 0], [10, 0], [10, 5]]])
    >>> lengths(segments(bend)).tolist(), lengths(segments(bend, area=shapely.box(0, 0, 8, 8))).tolist()
    ([10.0, 5.0], [8.0])
    """
    import shapely

    geometry = np.atleast_1d(np.asarray(lines, dtype=object))
    if area is not None:
        shapely.prepare(area)
        inside = shapely.covers(area, geometry)
        touched = ~inside & shapely.intersects(area, geometry)
        geometry = np.concatenate([geometry[inside], shapely.intersection(geometry[touched], area)])
    # Clipping may leave points (kept out here) and collections (taken apart here).
    parts = shapely.get_parts(shapely.get_parts(geometry[~shapely.is_missing(geometry)]))
    parts = parts[np.isin(shapely.get_type_id(parts), (1, 2))]
    points, line = shapely.get_coordinates(parts, return_index=True)
    joined = line[1:] == line[:-1]
    ends: Float = np.stack([points[:-1][joined], points[1:][joined]], axis=1)
    return ends[lengths(ends) > 0]


def lengths(a: Float) -> Float:
    """Lengths of segments."""
    delta = a[:, 1] - a[:, 0]
    length: Float = np.hypot(delta[:, 0], delta[:, 1])
    return length


def close_pairs(a: Float, b: Float, buffer: float, tolerance: float | None) -> tuple[Index, Index]:
    """Find all pairs of segments no farther apart than `buffer`, sorted by the first index."""
    import shapely

    lines: NDArray[np.object_] = np.asarray(shapely.linestrings(b), dtype=object)
    tree = shapely.STRtree(lines)
    # A hair wider: the exact test comes later, in the same arithmetic for both sets.
    reach = buffer * (1 + 1e-9)
    first: list[Index] = []
    second: list[Index] = []
    for start in range(0, len(a), _CHUNK):
        i, j = tree.query(shapely.linestrings(a[start : start + _CHUNK]), predicate="dwithin", distance=reach)
        i = i + start
        if tolerance is not None:
            keep = _angle_between(a[i], b[j]) <= math.radians(tolerance) + 1e-12
            i, j = i[keep], j[keep]
        order = np.lexsort((j, i))
        first.append(i[order])
        second.append(j[order])
    if not first:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    return np.concatenate(first), np.concatenate(second)


def _angle_between(a: Float, b: Float) -> Float:
    """Undirected angle (radians, 0 to pi/2) between paired segments."""
    u, v = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    angle: Float = np.arctan2(np.abs(_cross(u, v)), np.abs(_dot(u, v)))
    return angle


def matched(a: Float, b: Float, pairs: tuple[Index, Index], buffer: float) -> Intervals:
    """Find the parts of `a` within `buffer` of a segment of `b`, over the given pairs (in any order).

    Examples
    --------
    Of a segment of 10 m, the part within 1 m of another that begins at its middle.

    >>> import numpy as np
    >>> from tilepipe.evaluate.segment_matching import close_pairs, covered_length, matched
    >>> a, b = np.array([[[0.0, 0.0], [10.0, 0.0]]]), np.array([[[5.0, 0.0], [10.0, 0.0]]])
    >>> covered_length(matched(a, b, close_pairs(a, b, 1.0, None), 1.0), a)
    6.0
    """
    starts, ends = [], []
    for part in range(0, len(pairs[0]), _CHUNK):
        i, j = pairs[0][part : part + _CHUNK], pairs[1][part : part + _CHUNK]
        start, end = _interval_within(a[i], b[j], buffer)
        starts.append(start)
        ends.append(end)
    if not starts:
        return Intervals(np.empty(0, np.int64), np.empty(0), np.empty(0))
    start, end = np.concatenate(starts), np.concatenate(ends)
    keep = start < end
    return _union(pairs[0][keep], start[keep], end[keep])


def covered_length(intervals: Intervals, a: Float) -> float:
    """Length of the given parts of `a`."""
    return float((lengths(a)[intervals.segment] * (intervals.end - intervals.start)).sum())


def _interval_within(a: Float, b: Float, buffer: float) -> tuple[Float, Float]:
    """Start and end (n,) of the part of ``a[k]`` within `buffer` of ``b[k]``; start > end where none is.

    The points within the buffer of a segment are two discs and the rectangle between them.
    """
    u, v = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    from_start, from_end = a[:, 0] - b[:, 0], a[:, 0] - b[:, 1]
    b_length = np.hypot(v[:, 0], v[:, 1])
    along = _between(_dot(from_start, v), _dot(u, v), np.zeros(len(a)), b_length * b_length)
    across = _between(_cross(from_start, v), _cross(u, v), -buffer * b_length, buffer * b_length)
    rectangle = np.maximum(along[0], across[0]), np.minimum(along[1], across[1])
    start, end = np.full(len(a), np.inf), np.full(len(a), -np.inf)
    for low, high in (rectangle, _within_disc(from_start, u, buffer), _within_disc(from_end, u, buffer)):
        some = low <= high
        start = np.where(some, np.minimum(start, low), start)
        end = np.where(some, np.maximum(end, high), end)
    return np.maximum(start, 0.0), np.minimum(end, 1.0)


def _between(value: Float, slope: Float, low: Float, high: Float) -> tuple[Float, Float]:
    """Solve for the interval of t where ``low <= value + t * slope <= high``."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - value) / slope, (high - value) / slope
    flat = slope == 0
    inside = (low <= value) & (value <= high)
    start = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(first, second))
    end = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(first, second))
    return start, end


def _within_disc(origin: Float, u: Float, radius: float) -> tuple[Float, Float]:
    """Solve ``|origin + t * u| <= radius`` for t, by the chord and its middle, which loses no digits."""
    squared = _dot(u, u)
    middle = -_dot(origin, u) / squared
    distance = _cross(origin, u)
    half = np.sqrt(np.maximum(radius * radius - distance * distance / squared, 0.0) / squared)
    outside = distance * distance > radius * radius * squared
    return np.where(outside, np.inf, middle - half), np.where(outside, -np.inf, middle + half)


def _union(segment: Index, start: Float, end: Float) -> Intervals:
    """Union of the intervals of each segment: a sweep that counts the intervals open at each point."""
    where = np.concatenate([segment, segment])
    t = np.concatenate([start, end])
    step = np.repeat([1, -1], len(segment))
    order = np.lexsort((-step, t, where))
    where, t, step = where[order], t[order], step[order]
    open_now = np.cumsum(step)
    opens, closes = (open_now == 1) & (step == 1), open_now == 0
    return Intervals(where[opens], t[opens], t[closes])


def rms_distance(a: Float, b: Float, pairs: tuple[Index, Index], intervals: Intervals, buffer: float) -> float:
    """Root mean square distance from the given parts of `a` to the nearest paired segment of `b`.

    `pairs` is sorted by its first index. Each part is cut in pieces no longer than half the buffer, and
    each piece is integrated by the two-point Gauss rule.
    """
    total = length = 0.0
    for segment, t, weight in _gauss_nodes(a, intervals, buffer / 2):
        first = np.searchsorted(pairs[0], segment, side="left")
        count = np.searchsorted(pairs[0], segment, side="right") - first
        begin = np.cumsum(count) - count
        candidate = np.arange(count.sum()) + np.repeat(first - begin, count)
        points = a[segment, 0] + t[:, None] * (a[segment, 1] - a[segment, 0])
        squared = _squared_distance(np.repeat(points, count, axis=0), b[pairs[1][candidate]])
        total += float((weight * np.minimum.reduceat(squared, begin)).sum())
        length += float(weight.sum())
    return math.sqrt(total / length)


def _gauss_nodes(a: Float, intervals: Intervals, longest: float) -> Iterator[tuple[Index, Float, Float]]:
    """Segment, parameter and weight (a length) of the quadrature nodes, a bounded number at a time."""
    length = lengths(a)[intervals.segment] * (intervals.end - intervals.start)
    pieces = np.maximum(np.ceil(length / longest), 1).astype(np.int64)
    total = np.cumsum(pieces)
    offset = 0.5 / math.sqrt(3.0)
    for low in range(0, int(total[-1]), _CHUNK // 8):
        piece = np.arange(low, min(low + _CHUNK // 8, int(total[-1])))
        k = np.searchsorted(total, piece, side="right")
        place = piece - (total[k] - pieces[k])
        width = (intervals.end[k] - intervals.start[k]) / pieces[k]
        for shift in (0.5 - offset, 0.5 + offset):
            t = intervals.start[k] + (place + shift) * width
            yield intervals.segment[k], t, 0.5 * length[k] / pieces[k]


def _squared_distance(points: Float, b: Float) -> Float:
    """Squared distance of each point (n, 2) to its segment."""
    v = b[:, 1] - b[:, 0]
    offset = points - b[:, 0]
    t = np.clip(_dot(offset, v) / _dot(v, v), 0.0, 1.0)
    rest = offset - t[:, None] * v
    return _dot(rest, rest)


def _dot(u: Float, v: Float) -> Float:
    product: Float = u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1]
    return product


def _cross(u: Float, v: Float) -> Float:
    product: Float = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return product
