"""Borders of a street are told with its width."""

from __future__ import annotations

import numpy as np
import pytest

from tests.crack_lines import crack_lines_of
from tests.parameters import edge_parameters
from tilepipe.pipelines.edges.street_borders import find_streets
from tilepipe_kernels.polylines.smooth import smoothed


def borders(length: int, width: int):
    """Two borders of a dark street on bright ground, and its step of grey."""
    labels = np.ones((80, length), np.uint8)
    labels[10 : 10 + width] = 0
    lines = crack_lines_of(labels)
    return smoothed(lines, 0.15), 100 * lines.step / np.maximum(lines.contrast, 1)


@pytest.mark.parametrize(("length", "width", "expected"), [(100, 12, True), (150, 60, False), (12, 8, False)])
def test_streets_between_two_borders(length: int, width: int, expected: bool) -> None:
    smooth, step = borders(length, width)
    assert len(smooth) == 2
    streets = find_streets(smooth, step, edge_parameters({}), resolution=0.5)
    assert streets.candidate.tolist() == [expected, expected]
    if expected:
        assert np.allclose(streets.width, width)
        assert streets.partner.tolist() == [1, 0]
    else:
        assert np.isnan(streets.width).all() and (streets.partner == -1).all()


def test_a_line_borders_no_street_with_itself() -> None:
    labels = np.ones((40, 120), np.uint8)
    labels[10:22, 10:110] = 0
    lines = crack_lines_of(labels)
    smooth, step = smoothed(lines, 0.15), 100.0 * lines.step / lines.contrast
    assert len(smooth) == 1
    assert not find_streets(smooth, step, edge_parameters({}), resolution=0.5).candidate.any()


def test_a_step_on_each_side_is_no_street() -> None:
    smooth, step = borders(100, 12)
    assert not find_streets(smooth, step * [1, -1], edge_parameters({}), resolution=0.5).candidate.any()
    assert not find_streets(smooth, step * 0, edge_parameters({}), resolution=0.5).candidate.any()
