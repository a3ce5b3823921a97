"""Chains of cracks become smooth polylines near them; borders of a street are told with its width."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tilepipe.pipelines.edges.parameters import edge_parameters
from tilepipe.pipelines.edges.reconcile_lines import find_streets, smoothed
from tilepipe.pipelines.edges.tables import line_shape, long_groups
from tilepipe_kernels.polylines.crack_lines import trace_lines
from tilepipe_kernels.polylines.join import Chains, join_lines


def lines_of(labels: np.ndarray):
    """Lines along all borders of a label image."""
    h, v = np.zeros((2, *labels.shape), np.uint8)
    h[:-1], v[:, :-1] = labels[1:] != labels[:-1], labels[:, 1:] != labels[:, :-1]
    return join_lines([trace_lines(h, v, labels.astype(np.float32))])


def polylines(chains: Chains, scale: float = 1.0):
    return [shapely.LineString(part * scale) for part in np.split(chains.vertices, chains.offsets[1:-1])]


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
    lines = lines_of(labels)
    found = smoothed(lines, tolerance)
    smooth, cracks = polylines(found), polylines(lines)
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
    (roof,) = polylines(smoothed(lines_of(labels), 0.15))
    assert shapely.Polygon(roof).equals(shapely.box(5, 8, 20, 30))
    row, column = np.mgrid[:40, :40]
    (slope,) = polylines(smoothed(lines_of((3 * row > column).astype(np.uint8)), 0.15))
    assert slope.length == pytest.approx(math.hypot(40, 40 / 3), abs=1.0)
    # the staircase leaves the slope by 0.47 pixels, the line by half of that
    ideal = shapely.LineString([(0.5 - 1 / 6, 0), (40 / 3 + 0.5 - 1 / 6, 40)])
    assert shapely.distance(shapely.points(slope.coords[1:-1]), ideal).max() < 0.25


def test_shapes_of_lines() -> None:
    offsets = np.array([0, 2, 5, 10])
    square = [(0, 0), (0, 2), (2, 2), (2, 0), (0, 0)]
    vertices = np.array([(0, 0), (3, 4), (0, 0), (0, 2), (2, 2), *square], float)
    shape = line_shape(offsets, vertices)
    assert shape.length.tolist() == [5, 4, 8]
    assert np.allclose(shape.straightness, [1, 0, 0])
    assert np.allclose(shape.sinuosity, [1, math.sqrt(2), np.nan], equal_nan=True)
    assert line_shape(np.array([0]), np.empty((0, 2))).length.size == 0


def test_short_lines_stay_where_they_meet_others() -> None:
    labels = np.zeros((20, 40), np.uint8)
    labels[10:, :] = 1
    labels[10:13, 20:] = 2  # a junction of three borders, of which one is short
    labels[2, 2] = 3  # alone
    lines = lines_of(labels)
    kept = long_groups(lines, lines.lengths(), 20.0)
    assert len(lines) == 4
    assert kept.tolist() == [False, True, True, True]
    assert not long_groups(lines, lines.lengths(), 64.0).any()


def borders(length: int, width: int):
    """Two borders of a dark street on bright ground, and its step of grey."""
    labels = np.ones((80, length), np.uint8)
    labels[10 : 10 + width] = 0
    lines = lines_of(labels)
    return smoothed(lines, 0.15), 100 * lines.step / np.maximum(lines.contrast, 1)


@pytest.mark.parametrize(("length", "width", "expected"), [(100, 12, True), (150, 60, False), (12, 8, False)])
def test_streets_between_two_borders(length: int, width: int, expected: bool) -> None:
    chains, step = borders(length, width)
    assert len(chains) == 2
    streets = find_streets(chains, step, edge_parameters({}), resolution=0.5)
    assert streets.candidate.tolist() == [expected, expected]
    if expected:
        assert np.allclose(streets.width, width)
        assert streets.partner.tolist() == [1, 0]
    else:
        assert np.isnan(streets.width).all() and (streets.partner == -1).all()


def test_a_line_borders_no_street_with_itself() -> None:
    labels = np.ones((40, 120), np.uint8)
    labels[10:22, 10:110] = 0
    lines = lines_of(labels)
    chains, step = smoothed(lines, 0.15), 100.0 * lines.step / lines.contrast
    assert len(chains) == 1
    assert not find_streets(chains, step, edge_parameters({}), resolution=0.5).candidate.any()


def test_a_step_on_each_side_is_no_street() -> None:
    chains, step = borders(100, 12)
    assert not find_streets(chains, step * [1, -1], edge_parameters({}), resolution=0.5).candidate.any()
    assert not find_streets(chains, step * 0, edge_parameters({}), resolution=0.5).candidate.any()
