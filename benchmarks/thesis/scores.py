"""How well edges fit the truth: precision, recall, false detections, continuity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.runs import Classical, Field
from benchmarks.thesis.scenes import MARGIN, SPACING, Points, Scene

TOLERANCE = 1.0
"""Pixels within which an edge fits."""

CRACK_LENGTH = np.pi / 4
"""Length of line per crack: a line of length 1 crosses |cos| + |sin| cracks, 4/π over all directions."""

ELEMENT_LENGTH = np.pi / (2 * np.sqrt(2))
"""Length of line per pixel of an 8-connected chain, of which a line of length 1 has max(|cos|, |sin|)."""


@dataclass(frozen=True)
class Detections:
    """Detected edges as points.

    Attributes
    ----------
    points
        (n, 2): middles of cracks, or centres of pixels; (row, column) with pixel corners at whole numbers.
    line
        int (n,): number of the connected line that each belongs to.
    length
        Length of line that a point stands for, pixels.
    """

    points: Points
    line: NDArray[np.int64]
    length: float


@dataclass(frozen=True)
class Score:
    """Comparison with the truth within `TOLERANCE`; NaN where the truth is unknown.

    Attributes
    ----------
    precision, recall, f1
        Shares of the detected length and of the true length that fit, and their harmonic mean, of the roads' borders.
        Nothing detected has the precision 1, and an F1 of 0.
    false
        Detected length that is on no border of a road, pixels.
    stretch
        Length of the unbroken detected stretch of border, in the mean over all points of all borders; 0 where
        nothing is detected.  Within the tolerance a line of which every second crack is missing is unbroken.
    object_precision, object_recall, object_f1, object_false
        As the first four, with the edges of all objects as truth.
    mean_line
        Mean length of the connected detected lines.
    length
        Detected length.
    """

    precision: float
    recall: float
    f1: float
    false: float
    stretch: float
    object_precision: float
    object_recall: float
    object_f1: float
    object_false: float
    mean_line: float
    length: float


# ------------------------------------------------------------------------------------------------- detections


def _connected(count: int, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(first.size, np.int8), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def of_field(horizontal: Field, vertical: Field) -> Detections:
    """Cracks of a line field; those that meet at a corner are connected."""
    rows, columns = horizontal.shape
    h, v = np.argwhere(horizontal == 1), np.argwhere(vertical == 1)
    points = np.concatenate([h + np.array([1, 0.5]), v + np.array([0.5, 1])])
    of_h, of_v = np.array([[1, 0], [1, 1]]), np.array([[0, 1], [1, 1]])
    ends = np.concatenate([h[:, None] + of_h, v[:, None] + of_v])
    corners = ends[..., 0] * (columns + 1) + ends[..., 1]
    group = _connected((rows + 1) * (columns + 1), corners[:, 0], corners[:, 1])
    return Detections(points, group[corners[:, 0]], float(CRACK_LENGTH))


def of_lines(lines: Classical) -> Detections:
    """Elements of traced chains; those of one chain are connected, and chains that share an element."""
    members, offsets = lines.chains.members.astype(np.int64), lines.chains.offsets
    used = np.unique(members)
    inner = np.ones(max(members.size - 1, 0), np.bool_)
    inner[offsets[1:-1] - 1] = False
    group = _connected(len(lines.elements), members[:-1][inner], members[1:][inner])
    pixel = np.stack(np.divmod(lines.elements.pixel[used], lines.elements.width), axis=1)
    return Detections(pixel + 0.5, group[used], float(ELEMENT_LENGTH))


def inside(found: Detections, shape: tuple[int, int]) -> Detections:
    """The detections within the part of the image that is scored."""
    kept = ((found.points >= MARGIN) & (found.points <= np.array(shape) - MARGIN)).all(axis=1)
    return Detections(found.points[kept], found.line[kept], found.length)


def mean_line(found: Detections) -> float:
    """Mean length of the connected lines, pixels; 0 where there is none."""
    lines = np.unique(found.line).size
    return found.points.shape[0] * found.length / lines if lines else 0.0


# ------------------------------------------------------------------------------------------------- scores


def _near(points: Points, others: Points, spacing: float) -> NDArray[np.bool_]:
    """Whether points lie within the tolerance of lines of which there are points so far apart."""
    from scipy.spatial import cKDTree

    if len(points) == 0 or len(others) == 0:
        return np.zeros(len(points), np.bool_)
    distance, _ = cKDTree(others).query(points, distance_upper_bound=2 * TOLERANCE)
    return np.asarray(distance <= np.hypot(TOLERANCE, spacing / 2))


def _fit(found: Points, truth: Sequence[Points]) -> tuple[float, float, float, list[NDArray[np.bool_]]]:
    """Precision, recall, F1, and which points of each true line are found."""
    right = _near(found, np.concatenate(truth), SPACING)
    hits = [_near(line, found, 1.0) for line in truth]
    precision = float(right.mean()) if right.size else 1.0
    recall = float(np.concatenate(hits).mean())
    f1 = 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0
    return precision, recall, f1, hits


def unbroken(hits: Sequence[NDArray[np.bool_]]) -> float:
    """Mean over all points of all lines of the length of the unbroken run of hits around it, 0 at a miss; pixels."""
    total, squares = 0, 0.0
    for line in hits:
        steps = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
        runs = (steps[1::2] - steps[::2]).astype(np.float64)
        squares += float((runs**2).sum())
        total += line.size
    return SPACING * squares / total


def score(found: Detections, scene: Scene) -> Score:
    """Hold detections against the truth of a scene, as far as there is any."""
    found = inside(found, (scene.grey.shape[0], scene.grey.shape[1]))
    length = found.points.shape[0] * found.length
    if not scene.roads:
        return Score(*[np.nan] * 9, mean_line(found), length)
    precision, recall, f1, hits = _fit(found.points, scene.roads)
    object_precision, object_recall, object_f1, _ = _fit(found.points, scene.edges)
    return Score(
        precision, recall, f1, length * (1 - precision), unbroken(hits),
        object_precision, object_recall, object_f1, length * (1 - object_precision), mean_line(found), length,
    )  # fmt: skip


def mean_score(scores: Sequence[Score]) -> Score:
    """Mean of the scores of several draws."""
    return Score(*(float(np.mean([getattr(each, field.name) for each in scores])) for field in fields(Score)))
