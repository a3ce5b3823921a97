"""Crack lines become smooth polylines near them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tests.crack_lines import crack_lines_of
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.smooth import smoothed


def drawn(polylines: Polylines) -> list[shapely.LineString]:
    return [shapely.LineString(vertices) for vertices in polylines]


def ends(line: shapely.LineString) -> shapely.MultiPoint:
    return shapely.MultiPoint([line.coords[0], line.coords[-1]])


def farthest(line: shapely.LineString, other: shapely.LineString) -> float:
    """Largest distance of a line from another."""
    return float(shapely.distance(shapely.points(shapely.get_coordinates(line.segmentize(0.05))), other).max())


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.15, 0.3]))
def test_polylines_stay_near_their_cracks_and_do_not_cross(seed: int, tolerance: float) -> None:
    random = np.random.default_rng(seed)
    labels = random.integers(0, 2, (6, 7)).repeat(3, 0).repeat(2, 1)
    labels ^= random.random(labels.shape) < 0.1
    lines = crack_lines_of(labels)
    found = smoothed(lines, tolerance)
    smooth, cracks = drawn(found), drawn(lines)
    for one, other in zip(smooth, cracks, strict=True):
        assert farthest(one, other) <= max(0.45, 0.37 + tolerance)
        assert one.length <= other.length + 1e-9 and one.is_simple
        if not one.is_closed:
            assert one.boundary.equals(other.boundary)
    for i, one in enumerate(smooth):
        for other in smooth[:i]:
            meeting = one.intersection(other)
            assert meeting.is_empty or meeting.within(ends(one) | ends(other))


def test_rectangles_keep_their_corners_and_slopes_become_straight() -> None:
    labels = np.zeros((30, 40), np.uint8)
    labels[5:20, 8:30] = 1
    (roof,) = drawn(smoothed(crack_lines_of(labels), 0.15))
    assert shapely.Polygon(roof).equals(shapely.box(5, 8, 20, 30))
    row, column = np.mgrid[:40, :40]
    (slope,) = drawn(smoothed(crack_lines_of((3 * row > column).astype(np.uint8)), 0.15))
    assert slope.length == pytest.approx(math.hypot(40, 40 / 3), abs=1.0)
    # the staircase leaves the slope by 0.47 pixels, the line by half of that
    ideal = shapely.LineString([(0.5 - 1 / 6, 0), (40 / 3 + 0.5 - 1 / 6, 40)])
    assert shapely.distance(shapely.points(slope.coords[1:-1]), ideal).max() < 0.25
