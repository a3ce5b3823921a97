"""Commands that are run from end to end and watched from outside, and where their time goes."""

from __future__ import annotations

import json
import shutil
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.measure.tables import Table
from benchmarks.measure.watch import Watched, watch
from tilepipe.io.files.record import TIMINGS

LONG = 120.0
"""Seconds; a run that takes longer is not repeated."""


@contextmanager
def scratch_folder(parent: Path | None) -> Iterator[Path]:
    """A folder for scenes and runs in ``parent``, or where the system keeps temporary files; removed at the end."""
    with tempfile.TemporaryDirectory(prefix="tilepipe-bench-", dir=parent) as folder:
        yield Path(folder)


@dataclass
class Runs:
    """The runs of one contestant on one scene.

    Attributes
    ----------
    contestant, scene
        Who, and on what; a scene has a ``name`` and a number of ``megapixels``.
    runs, single
        The command on all cores, and on one where it can use more.
    stages
        Seconds of the stages of each run.
    load
        Load average before them.
    skipped
        Why there are none.
    """

    contestant: str
    scene: Any
    runs: list[Watched] = field(default_factory=list)
    single: Watched | None = None
    stages: list[dict[str, float]] = field(default_factory=list)
    load: float = 0.0
    skipped: str = ""

    @property
    def seconds(self) -> float:
        """Median time of a run."""
        return statistics.median(run.seconds for run in self.runs)

    @property
    def rate(self) -> float:
        """Megapixels per second."""
        return float(self.scene.megapixels / self.seconds)


Some = TypeVar("Some", bound=Runs)


def pipeline(name: str, raster: Path, out: Path) -> list[str]:
    """The command of a pipeline with its defaults."""
    return [sys.executable, "-m", "tilepipe", name, str(raster), "--out", str(out), "--overwrite", "--quiet"]


def repeated(outcome: Some, command: Sequence[str], out: Path, repetitions: int) -> Some:
    """Run a command some times; the last result stays, and with it come the seconds of its stages if it tells them."""
    for _ in range(repetitions):
        shutil.rmtree(out, ignore_errors=True)
        outcome.runs.append(watch(command))
        if (out / TIMINGS).exists():
            outcome.stages.append(json.loads((out / TIMINGS).read_text()))
        if outcome.runs[-1].seconds > LONG:
            break
    return outcome


def repeated_and_single(outcome: Some, command: Sequence[str], out: Path, repetitions: int) -> Some:
    """The same for a pipeline, and once on one core; the result on all cores stays."""
    repeated(outcome, command, out, repetitions)
    kept = out.with_name("kept")
    out.rename(kept)
    outcome.single = watch([*command, "--workers", "1"])
    shutil.rmtree(out)
    kept.rename(out)
    return outcome


def repeated_rival(outcome: Some, command: Sequence[str], out: Path, repetitions: int) -> Some:
    """The same for a rival, which is skipped where it fails; the first run, which may compile, does not count."""
    try:
        watch(command)
    except RuntimeError as error:
        outcome.skipped = str(error).strip().splitlines()[-1]
        return outcome
    return repeated(outcome, command, out, repetitions)


def stage_table(outcomes: Sequence[Runs]) -> Table:
    """Seconds and share of the time per stage, medians; what stages at work at one time leave over is the rest."""
    table = Table("Where the time goes (stages may overlap)", ("scene", "contestant", "stages"))
    for outcome in outcomes:
        if not outcome.stages:
            continue
        names = list(outcome.stages[0])
        seconds = [statistics.median(stages.get(name, 0.0) for stages in outcome.stages) for name in names]
        names.append("start and the rest")
        seconds.append(max(0.0, outcome.seconds - sum(seconds)))
        parts = [
            f"{name} {value:.1f} s ({value / outcome.seconds:.0%})" for name, value in zip(names, seconds, strict=True)
        ]
        table.rows.append([outcome.scene.name, outcome.contestant, ", ".join(parts)])
    return table
