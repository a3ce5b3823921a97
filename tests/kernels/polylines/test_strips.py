"""Strips between lines: long and even ones are kept, also where a border is cut; short and ragged ones are not."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import offsets_of
from tilepipe_kernels.polylines.parallel_lines import RIGHT, opposite_samples, sample_lines
from tilepipe_kernels.polylines.strips import _along, in_long_strips

STEP = 2.0


def shares(*lines, gap: float = 10.0, least: float = 15.0) -> list[float]:
    """Share of each line that lies along a long strip; all lines are dark on their right."""
    vertices = np.concatenate([np.asarray(line, float) for line in lines])
    samples = sample_lines(Polylines(offsets_of([*map(len, lines)]), vertices), STEP)
    darker = np.full(len(lines), RIGHT, np.int8)
    seen = opposite_samples(samples, darker, step=STEP, least=4.0, most=25.0, angle=10.0)
    kept = in_long_strips(samples, seen, step=STEP, gap=gap, least=least)
    assert np.array_equal(kept.seen >= 0, np.isfinite(kept.width))
    assert set(kept.seen[kept.seen >= 0]) <= set(seen.seen[seen.seen >= 0])
    return [float((kept.seen[samples.line == i, RIGHT] >= 0).mean()) for i in range(len(lines))]


def upper(start: float, stop: float, row: float = 0.0):
    return [(row, start), (row, stop)]


def lower(start: float, stop: float, row: float = 10.0):
    return [(row, stop), (row, start)]


@pytest.mark.parametrize(("length", "expected"), [(30, 1.0), (18, 0.0)])
def test_a_street_is_long_for_its_width(length: float, expected: float) -> None:
    assert shares(upper(0, length), lower(0, length)) == [expected, expected]


def test_a_street_is_long() -> None:
    assert shares(upper(0, 30), lower(0, 30), least=40.0) == [0, 0]


def test_a_street_goes_on_where_its_borders_are_cut() -> None:
    cut = [upper(0, 14), upper(22, 36), lower(0, 14), lower(22, 36)]
    assert shares(*cut) == [1, 1, 1, 1]
    assert shares(*cut, gap=6.0) == [0, 0, 0, 0]
    assert shares(lower(0, 36), upper(0, 14), upper(18, 36), gap=6.0)[1:] == [1, 1]


def test_strips_of_other_widths_are_others() -> None:
    assert shares(upper(0, 16), upper(16, 32, row=-5.0), lower(0, 32)) == [0, 0, 0]
    assert shares(upper(0, 16), upper(16, 32, row=-0.5), lower(0, 32)) == [1, 1, 1]


def test_a_line_borders_no_street_with_itself() -> None:
    ring = [(0, 0), (0, 60), (10, 60), (10, 0), (0, 0)]
    assert shares(ring) == [0]


def test_nothing_opposite() -> None:
    assert shares(upper(0, 50)) == [0]


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_those_of_all_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 400
    points, angle, width = rng.random((count, 2)) * 60, rng.choice([0.0, 0.1, 3.1], count), rng.uniform(4, 7, count)
    inward = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    expected = set()
    for a in range(count):
        for b in range(a):
            offset, uneven = points[a] - points[b], max(1.0, 0.1 * max(width[a], width[b]))
            near = np.hypot(*offset) <= 9.0 and inward[a] @ inward[b] > 0
            if near and abs(offset @ (inward[a] + inward[b])) / 2 <= uneven and abs(width[a] - width[b]) <= uneven:
                expected.add((b, a))
    found = _along(points, inward, width, 9.0)
    assert len(expected) > 50
    assert len(found) == len(expected)
    assert {(min(pair), max(pair)) for pair in found.tolist()} == expected
