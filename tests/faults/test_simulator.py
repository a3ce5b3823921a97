"""Whatever fails at whatever point: the run says so, publishes nothing half, and resumes to the same bytes."""

from __future__ import annotations

import pytest

from tests.faults.points import FAULTS, Fault
from tests.faults.scenes import SCENES
from tests.faults.simulator import calm, disturb, draw_fault

SEEDS = {"bright_spots": 100, "streets": 12, "objects": 12, "edges": 12}
"""Faults drawn for each pipeline; `python -m tests.faults` draws thousands."""


@pytest.mark.parametrize("name", SCENES)
def test_a_fault_at_any_point_is_made_good_by_the_same_command(name: str) -> None:
    wrong = {}
    for seed in range(SEEDS[name]):
        outcome = disturb(name, draw_fault(name, seed), seed)
        if outcome.wrong:
            wrong[seed] = outcome
    assert wrong == {}


def test_a_kill_at_every_point_of_a_run() -> None:
    _, count = calm("bright_spots")
    outcomes = {point: disturb("bright_spots", Fault(point, "kill"), point) for point in range(count)}
    assert {point: outcome for point, outcome in outcomes.items() if outcome.wrong} == {}


def test_every_fault_happens() -> None:
    found = {kind: disturb("bright_spots", Fault(5, kind), 0).happened for kind in FAULTS}
    assert all(happened.startswith(kind) for kind, happened in found.items()), found
