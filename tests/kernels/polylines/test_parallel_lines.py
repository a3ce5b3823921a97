"""Borders of a street see each other; what is no street between two borders is not seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import offsets_of
from tilepipe_kernels.polylines.parallel_lines import LEFT, RIGHT, opposite_samples, sample_lines

STEP = 2.0


def lines(*parts):
    """Polylines of vertices (row, column)."""
    return Polylines(offsets_of([*map(len, parts)]), np.concatenate([np.asarray(part, float) for part in parts]))


def seen_shares(parts, darker, **rules):
    samples = sample_lines(lines(*parts), STEP)
    rules = {"step": STEP, "least": 4.0, "most": 25.0, "angle": 10.0} | rules
    found = opposite_samples(samples, np.array(darker, np.int8), **rules)
    return [(found.seen[samples.line == i] >= 0).mean(axis=0).tolist() for i in range(len(parts))], samples, found


UPPER, LOWER = [(0, 0), (0, 100)], [(10, 100), (10, 0)]


def test_samples_stand_in_the_middle_of_even_parts():
    samples = sample_lines(lines([(0, 0), (0, 4), (3, 4)], [(5, 5), (5, 5.5)]), 2.0)
    assert samples.line.tolist() == [0, 0, 0, 0, 1]
    along = [0.875, 2.625, 4.375, 6.125]
    expected = [(max(0, a - 4), min(4, a)) for a in along]
    assert np.allclose(samples.points[:4], expected)
    assert np.allclose(samples.directions, [(0, 1), (0, 1), (1, 0), (1, 0), (0, 1)])


def test_two_borders_of_a_dark_street_see_each_other():
    shares, samples, found = seen_shares([UPPER, LOWER], [RIGHT, RIGHT])
    assert shares == [[0.0, 1.0], [0.0, 1.0]]
    assert np.allclose(found.width[:, RIGHT], 10)
    assert (samples.line[found.seen[samples.line == 0, RIGHT]] == 1).all()


@pytest.mark.parametrize(
    ("parts", "darker", "rules"),
    [
        ([UPPER, LOWER], [RIGHT, LEFT], {}),  # a step down and then another: no street between
        ([UPPER, LOWER], [RIGHT, -1], {}),  # of the one nothing is known
        ([UPPER, LOWER], [RIGHT, RIGHT], {"most": 9.0}),
        ([UPPER, LOWER], [RIGHT, RIGHT], {"least": 11.0}),
        ([UPPER, [(10, 100), (35, 0)]], [RIGHT, RIGHT], {}),  # not parallel
        ([UPPER, [(10, 220), (10, 120)]], [RIGHT, RIGHT], {}),  # not beside it
    ],
)
def test_what_is_no_street(parts, darker, rules):
    shares, _, _ = seen_shares(parts, darker, **rules)
    assert not np.any(shares)


def test_bright_streets_and_lines_that_run_the_same_way():
    assert seen_shares([UPPER, LOWER], [LEFT, LEFT])[0] == [[0.0, 1.0], [0.0, 1.0]]
    assert seen_shares([UPPER, LOWER[::-1]], [RIGHT, LEFT])[0] == [[0.0, 1.0], [1.0, 0.0]]


def test_only_the_nearest_is_seen_and_only_if_it_looks_back():
    far = [(20, 100), (20, 0)]
    shares, _, _ = seen_shares([UPPER, LOWER, far], [RIGHT, RIGHT, RIGHT])
    assert shares == [[0.0, 1.0], [0.0, 1.0], [0.0, 0.0]]


@given(st.integers(0, 2**32), st.floats(0, 2 * math.pi))
def test_against_looking_at_all_samples(seed, turn):
    rng = np.random.default_rng(seed)
    middles, angles = rng.uniform(0, 60, (12, 2)), turn + rng.choice([0, math.pi, 0.1, 1.5], 12)
    halves = np.stack([np.sin(angles), np.cos(angles)], axis=1) * rng.uniform(2, 15, (12, 1))
    parts = [np.stack([m - h, m + h]) for m, h in zip(middles, halves, strict=True)]
    darker = rng.integers(-1, 2, 12).astype(np.int8)
    _, samples, found = seen_shares(parts, darker)
    for workers in (1, 2):
        rules = {"step": STEP, "least": 4.0, "most": 25.0, "angle": 10.0, "workers": workers}
        again = opposite_samples(samples, darker, **rules)
        assert np.array_equal(again.seen, found.seen)
    expected = naive(samples, darker)
    assert np.array_equal(found.seen, expected)


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1]  # np.dot may round otherwise


def naive(samples, darker):
    count = samples.line.size
    nearest, width = np.full((count, 2), -1), np.zeros((count, 2))
    facing = np.zeros((count, 2), int)
    for a in range(count):
        for side in (LEFT, RIGHT):
            normal = np.array([-samples.directions[a, 1], samples.directions[a, 0]]) * (1 if side == LEFT else -1)
            best = (math.inf, -1)
            for b in range(count):
                gap = samples.points[b] - samples.points[a]
                parallel = dot(samples.directions[a], samples.directions[b])
                other = side if parallel < 0 else 1 - side
                alike = (darker[samples.line[a]] == side) == (darker[samples.line[b]] == other)
                known = darker[samples.line[a]] >= 0 and darker[samples.line[b]] >= 0
                beside = 4 <= dot(gap, normal) <= 25 and abs(dot(gap, samples.directions[a])) <= 0.75 * STEP
                if known and beside and alike and abs(parallel) >= math.cos(math.radians(10)):
                    best = min(best, (dot(gap, normal), b))
                    if best[1] == b:
                        facing[a, side] = other
            width[a, side], nearest[a, side] = best
    kept = nearest.copy()
    for a in range(count):
        for side in (LEFT, RIGHT):
            b = nearest[a, side]
            if b >= 0:
                back = nearest[b, facing[a, side]]
                same = back >= 0 and samples.line[back] == samples.line[a]
                near = abs(width[b, facing[a, side]] - width[a, side]) <= 0.2 * width[a, side]
                kept[a, side] = b if same and near else -1
    return kept
