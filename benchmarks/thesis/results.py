"""All runs of a scene, in the mean over draws of its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.thesis.runs import FORMS, RUNS, Classical, Form, Outcome, Run, classical, execute, thresholds
from benchmarks.thesis.scenes import Drawing, Scene, render
from benchmarks.thesis.scores import Score, mean_score, of_field, of_lines, score

CORNER = "corner of the histogram"
MATCHED = "of equal recall"
BEST = "of the best F1"

COMPARED = Run("sequential", 2, "reciprocal")
"""The run that the thesis sets beside the classical method, in its figures 24 and 25."""


@dataclass(frozen=True)
class Record:
    """A run in the mean over the draws; ``outcome`` is that of the first one."""

    outcome: Outcome
    score: Score
    energy: float
    seconds: float
    unresolved: int


@dataclass(frozen=True)
class ClassicalRecord:
    """The classical method with one rule for its threshold, in the mean over the draws; ``lines`` of the first one."""

    lines: Classical
    score: Score
    threshold: float
    seconds: float


@dataclass(frozen=True)
class Results:
    """What came out for a scene.

    Attributes
    ----------
    scene
        The first draw.
    runs
        By form and run.
    classical
        By the rule for the threshold: `CORNER`; where the truth is known also `BEST`, and `MATCHED` with the key of
        the form whose recall on the borders of roads is matched, in the run `COMPARED`.
    """

    scene: Scene
    runs: dict[tuple[Form, Run], Record]
    classical: dict[tuple[str, str], ClassicalRecord]


def _record(form: Form, run: Run, scenes: Sequence[Scene], repetitions: int) -> Record:
    outcomes = [execute(run, form, scene.grey, repetitions) for scene in scenes]
    scores = [
        score(of_field(outcome.horizontal, outcome.vertical), scene)
        for outcome, scene in zip(outcomes, scenes, strict=True)
    ]
    return Record(
        outcomes[0],
        mean_score(scores),
        float(np.mean([outcome.energy for outcome in outcomes])),
        float(np.mean([outcome.seconds for outcome in outcomes])),
        sum(outcome.unresolved for outcome in outcomes),
    )


def _classical_record(found: Sequence[tuple[Classical, Score]]) -> ClassicalRecord:
    return ClassicalRecord(
        found[0][0],
        mean_score([each for _, each in found]),
        float(np.mean([lines.threshold for lines, _ in found])),
        float(np.mean([lines.seconds for lines, _ in found])),
    )


def matching(found: Sequence[tuple[Classical, Score]], recall: float) -> tuple[Classical, Score]:
    """Of results by rising threshold the last whose recall is no less than another's; the first if none reaches it."""
    reaching = [each for each in found if each[1].recall >= recall]
    return reaching[-1] if reaching else found[0]


def gather(scenes: Sequence[Scene], forms: Sequence[Form] = FORMS, repetitions: int = 3) -> Results:
    """Make all runs of a scene.

    Parameters
    ----------
    scenes
        Draws of one scene.
    forms
        Forms of the optimiser.
    repetitions
        Of each run, for its time.
    """
    runs = {(form, run): _record(form, run, scenes, repetitions) for form in forms for run in RUNS}
    chosen: dict[tuple[str, str], list[tuple[Classical, Score]]] = {}
    for scene in scenes:
        corner = classical(scene.grey, repetitions=repetitions)
        chosen.setdefault((CORNER, ""), []).append((corner, score(of_lines(corner), scene)))
        if not scene.roads:
            continue
        swept = [(lines, score(of_lines(lines), scene)) for lines in map_thresholds(scene)]
        chosen.setdefault((BEST, ""), []).append(max(swept, key=lambda each: each[1].f1))
        for form in forms:
            match = matching(swept, runs[form, COMPARED].score.recall)
            chosen.setdefault((MATCHED, form.key), []).append(match)
    return Results(scenes[0], runs, {rule: _classical_record(found) for rule, found in chosen.items()})


def map_thresholds(scene: Scene) -> list[Classical]:
    """The classical lines of a scene by rising threshold."""
    return [classical(scene.grey, threshold) for threshold in thresholds(scene.grey)]


def draw(drawing: Drawing, draws: int, noise: float = 1.0) -> list[Scene]:
    """Draws of a scene, its noise and texture times a factor."""
    louder = replace(drawing, noise=noise * drawing.noise, texture=noise * drawing.texture)
    return [render(louder, seed) for seed in range(draws)]
