"""The tables of the page about Barbosa (1994)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.measure.tables import Table, number
from benchmarks.thesis.results import Results
from benchmarks.thesis.runs import FORMS, OURS, PLAIN, RUNS, Form, Run
from benchmarks.thesis.scores import Score
from benchmarks.thesis.verdicts import CONCLUSIONS, Finding, judge, lower_energies

TABLE_1 = {
    (0, "sequential", 2): (16, "1:46:57", "1:38:15"),
    (1, "sequential", 2): (17, "1:57:46", "1:47:09"),
    (0, "sequential", 4): (18, "2:08:08", "1:58:52"),
    (1, "sequential", 4): (19, "2:07:12", "1:58:20"),
    (0, "integrated", 2): (20, "1:26:51", "1:22:11"),
    (1, "integrated", 2): (21, "1:52:11", "1:45:07"),
    (0, "integrated", 4): (22, "1:37:05", "1:31:01"),
    (1, "integrated", 4): (23, "1:53:14", "1:51:36"),
}
"""By image, way and levels: the figure, and the hours, minutes, seconds of its reciprocal and its quadratic run."""


def thesis_time(image: int, run: Run) -> tuple[str, str, int]:
    """Figure, time as printed, and seconds of a run in the thesis's table 1; images 0 and 1."""
    figure, *times = TABLE_1[image, run.way, run.levels]
    side = run.potential == "quadratic"
    hours, minutes, seconds = map(int, times[side].split(":"))
    return f"{figure} {'ab'[side]}", times[side], 3600 * hours + 60 * minutes + seconds


def verdict_table(results: Sequence[Results], forms: Sequence[Form] = FORMS) -> Table:
    """Whether the conclusions hold, in each form of the optimiser."""
    table = Table("The three conclusions", ["conclusion", *(form.title for form in forms)])
    findings = [judge(results, form) for form in forms]
    for number_, conclusion in enumerate(CONCLUSIONS):
        table.rows.append([conclusion, *(each[number_].line for each in findings)])
    energies = [lower_energies(results, form) for form in forms]
    cells = [f"in {fewer} of {pairs} pairs" for fewer, pairs in energies]
    table.rows.append(["the reason given for 2: sequential ends at the lower energy", *cells])
    return table


def noise_table(findings: Mapping[tuple[float, Form], tuple[Finding, Finding, Finding]]) -> Table:
    """The same under other noise."""
    table = Table("The same with less noise", ["noise and texture times", "form", *CONCLUSIONS])
    for (factor, form), each in findings.items():
        table.rows.append([f"{factor:g}", form.key, *(finding.line for finding in each)])
    return table


def time_table(results: Sequence[Results]) -> Table:
    """Table 1 of the thesis beside the times of the same runs here."""
    columns = ("figure", "image", "run", "thesis", "plain, ms", "times faster", "ours, ms", "times faster")
    table = Table("Table 1 of the thesis, and the same runs here", columns)
    for image, result in enumerate(results):
        for run in RUNS:
            figure, printed, seconds = thesis_time(image, run)
            plain, ours = (result.runs[form, run].seconds for form in (PLAIN, OURS))
            table.rows.append([
                figure, str(image + 1), run.title, f"{printed} = {seconds:,} s",
                number(1e3 * plain), _thousands(seconds / plain), number(1e3 * ours), _thousands(seconds / ours),
            ])  # fmt: skip
    table.rows.sort(key=lambda row: row[0])
    return table


def _thousands(value: float) -> str:
    return f"{round(value, -3):,.0f}"


SCORE_COLUMNS = (
    "U", "precision", "recall", "F1", "false px", "unbroken px", "object precision", "object recall", "object F1",
    "object false px", "mean line px",
)  # fmt: skip


def _score_cells(score: Score) -> list[str]:
    return [
        f"{score.precision:.1%}", f"{score.recall:.1%}", f"{score.f1:.1%}", f"{score.false:,.0f}",
        number(score.stretch), f"{score.object_precision:.1%}", f"{score.object_recall:.1%}",
        f"{score.object_f1:.1%}", f"{score.object_false:,.0f}", number(score.mean_line),
    ]  # fmt: skip


def score_table(results: Sequence[Results], form: Form) -> Table:
    """The sixteen runs in one form: energies and scores."""
    table = Table(f"The sixteen runs, {form.title}", ["image", "run", *SCORE_COLUMNS])
    for image, result in enumerate(results):
        for run in RUNS:
            record = result.runs[form, run]
            table.rows.append([str(image + 1), run.title, f"{record.energy:,.0f}", *_score_cells(record.score)])
    return table


def classical_table(results: Sequence[Results]) -> Table:
    """Nevatia & Babu's lines under several thresholds."""
    table = Table("The classical method", ["image", "threshold", "value", *SCORE_COLUMNS[1:], "ms"])
    for image, result in enumerate(results):
        for (rule, key), record in result.classical.items():
            table.rows.append([
                str(image + 1), f"{rule} ({key})" if key else rule, f"{record.threshold:,.0f}",
                *_score_cells(record.score), number(1e3 * record.seconds),
            ])  # fmt: skip
    return table


def photograph_table(results: Sequence[Results], forms: Sequence[Form] = FORMS) -> Table:
    """Energies, edges and times where the truth is unknown."""
    columns = ("photograph", "run", "form", "U", "edges", "length px", "mean line px", "ms")
    table = Table("Photographs", columns)
    for result in results:
        for run in RUNS:
            for form in forms:
                record = result.runs[form, run]
                count = int(np.sum(record.outcome.horizontal == 1) + np.sum(record.outcome.vertical == 1))
                table.rows.append([
                    result.scene.title, run.title, form.key, f"{record.energy:,.0f}", f"{count:,}",
                    f"{record.score.length:,.0f}", number(record.score.mean_line), number(1e3 * record.seconds),
                ])  # fmt: skip
        for record in result.classical.values():
            table.rows.append([
                result.scene.title, "Nevatia–Babu", "", "", f"{len(record.lines.elements):,}",
                f"{record.score.length:,.0f}", number(record.score.mean_line), number(1e3 * record.seconds),
            ])  # fmt: skip
    return table


def unresolved(results: Sequence[Results]) -> int:
    """Sites of all runs that still wanted to change at the cap on the rounds."""
    return sum(record.unresolved for result in results for record in result.runs.values())
