"""The experiments of the thesis made again: its scenes, scores and verdicts, and the page of one draw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.measure.machine import Machine
from benchmarks.thesis import page as thesis
from benchmarks.thesis.results import CORNER, MATCHED, Results, draw, gather, matching
from benchmarks.thesis.runs import OURS, RUNS, Run, classical, execute
from benchmarks.thesis.scenes import COLUMNS, ROWS, SPACING, Scene, fork, junction
from benchmarks.thesis.scores import Score, of_field, of_lines, score, unbroken
from benchmarks.thesis.tables import TABLE_1, classical_table, photograph_table, score_table, thesis_time, time_table
from benchmarks.thesis.verdicts import F1, FALSE, STRETCH, Finding, compare, judge

MACHINE = Machine("a processor", 2, 8 << 30, "3.11", {"numpy": "2"}, "2026-01-01", 0.0, 1e9)
GOOD = Score(0.9, 0.9, 0.9, 10.0, 50.0, 0.9, 0.9, 0.9, 10.0, 20.0, 500.0)


@pytest.fixture(scope="module")
def results() -> Results:
    return gather(draw(fork(), 1), [OURS], repetitions=1)


def step(shape: tuple[int, int] = (40, 60), row: int = 20) -> Scene:
    """Two flat halves, whose border is a road's."""
    grey = np.full(shape, 80, np.float32)
    grey[row:] = 160
    line = np.stack([np.full(208, float(row)), 4 + SPACING * (np.arange(208) + 0.5)], axis=1)
    return Scene("step", "a step", grey, [line], [line])


@pytest.mark.parametrize("make", [fork, junction])
def test_scenes_show_their_truth(make: object) -> None:
    first, second = draw(make(), 2)  # type: ignore[operator]
    assert first.grey.shape == (ROWS, COLUMNS) and not np.array_equal(first.grey, second.grey)
    assert np.array_equal(first.grey, draw(make(), 1)[0].grey)  # type: ignore[operator]
    # the borders of roads are among all edges, and the image changes most there
    edges, roads = np.concatenate(first.edges), np.concatenate(first.roads)
    assert len(roads) < len(edges)
    assert np.linalg.norm(roads[::50, None] - edges[None], axis=2).min(axis=1).max() < 0.5
    steps = np.hypot(*np.gradient(draw(make(), 1, noise=0.0)[0].grey))  # type: ignore[operator]
    on = steps[tuple(np.floor(roads).astype(int).T)]
    assert np.median(on) > 5 * np.median(steps) + 5


def test_scores_of_a_perfect_a_shifted_and_an_empty_field() -> None:
    scene = step()
    perfect, v = np.zeros((2, *scene.grey.shape), np.uint8)
    perfect[19] = 1
    whole = score(of_field(perfect, v), scene)
    assert whole.precision == whole.recall == whole.f1 == whole.object_f1 == 1 and whole.false == 0
    assert whole.stretch == pytest.approx(52) and whole.mean_line == pytest.approx(52 * np.pi / 4)
    assert score(of_field(np.roll(perfect, 1, axis=0), v), scene).f1 == 1
    far = score(of_field(np.roll(perfect, 2, axis=0), v), scene)
    assert far.f1 == far.recall == far.stretch == 0 and far.false == pytest.approx(52 * np.pi / 4)
    nothing = score(of_field(v, v), scene)
    assert (nothing.precision, nothing.recall, nothing.f1, nothing.false, nothing.mean_line) == (1, 0, 0, 0, 0)
    # a gap halves the stretch around a point
    perfect[19, 28:32] = 0
    broken = score(of_field(perfect, v), scene)
    assert broken.precision == 1 and 22 < broken.stretch < 24


def test_unbroken_stretch() -> None:
    line = np.array([1, 1, 1, 0, 1, 0, 0, 0], bool)
    assert unbroken([line]) == pytest.approx(SPACING * (9 + 1) / 8)
    assert unbroken([line, ~line]) == pytest.approx(SPACING * (9 + 1 + 1 + 9) / 16)


def test_both_methods_find_a_step() -> None:
    scene = step()
    for run in RUNS[::4]:
        outcome = execute(run, OURS, scene.grey)
        found = score(of_field(outcome.horizontal, outcome.vertical), scene)
        assert found.f1 == 1 and outcome.unresolved == 0
    lines = classical(scene.grey, 1000.0)
    assert score(of_lines(lines), scene).f1 == 1
    assert len(lines.polylines) == 1 and lines.polylines.vertices[:, 0].tolist() in ([19, 19], [20, 20])


def test_sixteen_runs(results: Results) -> None:
    assert len(RUNS) == 8 and len({thesis_time(image, run)[0] for image in (0, 1) for run in RUNS}) == 16
    assert len(TABLE_1) == 8
    assert thesis_time(0, Run("sequential", 4, "quadratic")) == ("18 b", "1:58:52", 7132)
    table = score_table([results, results], OURS)
    assert len(table.rows) == 16 and all(len(row) == len(table.columns) for row in table.rows)
    both = replace(results, runs={(form, run): results.runs[OURS, run] for form in thesis.FORMS for run in RUNS})
    times = time_table([both, both])
    assert len(times.rows) == 16 and times.rows[0][0] == "16 a" and times.rows[-1][0] == "23 b"
    assert set(results.classical) >= {(CORNER, ""), (MATCHED, "ours")}
    for made in (classical_table([results]), photograph_table([results], [OURS])):
        assert all(len(row) == len(made.columns) for row in made.rows)


def test_a_threshold_of_equal_recall() -> None:
    lines = classical(step().grey, 1000.0)
    found = [(lines, replace(GOOD, recall=recall)) for recall in (0.9, 0.8, 0.5)]
    assert [matching(found, recall)[1].recall for recall in (0.95, 0.9, 0.6, 0.1)] == [0.9, 0.9, 0.8, 0.5]


def test_pairs_are_won_lost_and_open() -> None:
    worse, longer = replace(GOOD, f1=0.5), replace(GOOD, stretch=90.0)
    assert compare(GOOD, worse, (F1, STRETCH)) == "won" and compare(worse, GOOD, (F1, STRETCH)) == "lost"
    assert compare(GOOD, GOOD, (F1, STRETCH)) == compare(worse, longer, (F1,)[:0]) == "open"
    assert compare(GOOD, replace(worse, stretch=90.0), (F1, STRETCH)) == "open"
    assert compare(GOOD, replace(GOOD, f1=0.895), (F1, STRETCH)) == "open"
    assert compare(GOOD, replace(GOOD, false=20.0), (FALSE, F1)) == "won"
    assert compare(GOOD, replace(GOOD, false=5.0), (FALSE, F1)) == "lost"


def test_verdicts_can_go_either_way(results: Results) -> None:
    assert Finding(("won", "won", "won", "lost")).verdict == "holds"
    assert Finding(("won", "won", "open", "lost")).verdict == "mixed"
    assert Finding(("won", "open", "open", "open")).verdict == "does not hold"

    def made(reciprocal: float, integrated: float, classic: float) -> Results:
        runs = {
            (OURS, run): replace(
                results.runs[OURS, run],
                score=replace(
                    GOOD,
                    f1=(reciprocal if run.potential == "reciprocal" else 0.5)
                    * (integrated if run.way == "integrated" else 1),
                ),
            )
            for run in RUNS
        }
        others = {
            rule: replace(record, score=replace(GOOD, false=classic)) for rule, record in results.classical.items()
        }
        return replace(results, runs=runs, classical=others)

    assert [each.verdict for each in judge([made(0.9, 0.5, 100.0)] * 2, OURS)] == ["holds"] * 3
    assert [each.verdict for each in judge([made(0.3, 1.5, 1.0)] * 2, OURS)] == ["does not hold"] * 3
    mixed = judge([made(0.9, 0.5, 100.0), made(0.3, 1.5, 1.0)], OURS)
    assert [each.verdict for each in mixed] == ["mixed"] * 3 and [each.won for each in mixed] == [4, 4, 2]


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thesis, "DRAWINGS", (fork,))
    made = thesis.reproduce(
        draws=1, repetitions=1, less_noise=(), data=tmp_path / "none", results=tmp_path, machine=MACHINE
    )
    page = (tmp_path / "edges-thesis.md").read_text()
    assert all(table.title in page for table in made)
    assert page.count("skipped: ") == 2 and page.count("1. reciprocal beats quadratic") == 1
    pictures = sorted(tmp_path.glob("*.png"))
    assert len(pictures) == 2 and all(f"({each.name})" in page for each in pictures)
    assert all(each.stat().st_size < 300_000 for each in pictures)
