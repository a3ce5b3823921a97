"""Groups of polylines that meet."""

from __future__ import annotations

import numpy as np

from tests.crack_lines import crack_lines_of
from tilepipe_kernels.polylines.groups import long_groups, meet_others


def test_short_lines_stay_where_they_meet_others() -> None:
    labels = np.zeros((20, 40), np.uint8)
    labels[10:, :] = 1
    labels[10:13, 20:] = 2  # a junction of three borders, of which one is short
    labels[2, 2] = 3  # alone
    lines = crack_lines_of(labels)
    kept = long_groups(lines, lines.lengths(), 20.0)
    assert len(lines) == 4
    assert kept.tolist() == [False, True, True, True]
    assert not long_groups(lines, lines.lengths(), 64.0).any()


def test_lines_meet_others_at_junctions_and_at_the_border_of_a_core() -> None:
    labels = np.zeros((20, 40), np.uint8)
    labels[10:, :] = 1
    labels[10:13, 20:] = 2
    labels[2, 2] = 3
    lines = crack_lines_of(labels)
    assert meet_others(lines, (0, 20, 0, 40)).tolist() == [False, True, True, True]
    assert meet_others(lines.taken(np.array([0])), (0, 20, 2, 40)).tolist() == [True]
    alone = lines.taken(np.flatnonzero(lines.first[:, 1] == 0))
    assert meet_others(alone, (0, 20, 0, 40)).tolist() == [True]
    assert meet_others(alone, (-9, 20, -9, 40)).tolist() == [False]
