"""``streets``: the pipeline from end to end on a synthetic city, beside a plain script."""

from __future__ import annotations

import shutil
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.measure.commands import Runs, repeated, repeated_rival, scratch_folder, stage_table
from benchmarks.measure.machine import describe_machine, load_average
from benchmarks.measure.tables import RESULTS, Table, number, save
from benchmarks.measure.watch import time_to_first_file, watch
from tilepipe.evaluate.lines import LineScore, evaluate
from tilepipe.io.files.record import STATE
from tilepipe.synthetic import City, write_city

SIZE, QUICK_SIZE = 4096, 1024
BUFFER = 3.0
"""Buffer of the scores in metres."""
LARGEST_SCORED = 16384
"""Side of the largest city whose lines are scored: scoring holds all lines in memory."""
LARGEST_PLAIN = 8192
"""Side of the largest city that the plain script is given: it holds the raster many times over."""

LEGEND = (
    "The whole command, from the start of the interpreter to the last file; median of the rounds. *peak* is the most "
    "memory that it held, children included. Scores are those of Heipke et al. (1997) within {buffer:g} m of the "
    "true centerlines, also where trees, cars or voids hide a street. *Plain script* is "
    "`benchmarks/streets/plain_script.py`."
)


@dataclass(frozen=True)
class Scene:
    """A city of a number of pixels on each side."""

    size: int

    @property
    def name(self) -> str:
        """Its size, for people."""
        return f"{self.size}² = {self.megapixels:.0f} Mpx"

    @property
    def megapixels(self) -> float:
        """Pixels of its raster in millions."""
        return self.size**2 / 1e6


@dataclass
class Outcome(Runs):
    """What one contestant did on one city."""

    scores: dict[str, LineScore] = field(default_factory=dict)


def run_streets(
    *,
    sizes: Sequence[int],
    steps: int = 50,
    repetitions: int = 3,
    peers: bool = True,
    scratch: Path | None = None,
    results: Path | None = RESULTS,
) -> list[Outcome]:
    """Run the pipeline and the plain script on cities of given sizes, print and write the page.

    Parameters
    ----------
    sizes
        Sides of the cities in pixels of half a metre.
    steps
        Diffusion steps.
    repetitions
        Rounds after the warm-up.
    peers
        Whether the plain script runs too.
    scratch
        Folder for cities and runs; the largest city, 32768 pixels a side, needs some 20 GB.
    results
        Folder of the page; None writes none.

    Returns
    -------
    list of Outcome
        What was measured.
    """
    machine = describe_machine()
    machine.announce()
    outcomes: list[Outcome] = []
    first_tile: list[float] = []
    for size in sizes:
        with scratch_folder(scratch) as folder:
            city = write_city(
                folder / "city", City(rows=size, columns=size), layers=("intensity",), workers=machine.cores
            )
            run = folder / "run"
            command = _command(city["intensity"], run, steps)
            if not outcomes:
                # the first start compiles
                watch(command)
                first_tile = [_first_tile(command, run) for _ in range(max(3, repetitions))]
            outcomes.append(_pipeline(command, run, city["centerlines"], size, repetitions))
            if peers:
                outcomes.append(_plain(city["intensity"], folder, city["centerlines"], size, steps, repetitions))
    tables = [_speed_table(outcomes, steps), stage_table(outcomes)]
    page = [part for table in tables for part in table.shown()]
    start = (
        f"Second start of the command: {statistics.median(first_tile):.2f} s to the first finished tile "
        f"(median of {len(first_tile)}, at {sizes[0]} × {sizes[0]} pixels)."
    )
    print(start)
    if results is not None:
        parts = [LEGEND.format(buffer=BUFFER), "", start, "", *page]
        save("streets", machine, parts, results)
    return outcomes


def _command(raster: Path, out: Path, steps: int) -> list[str]:
    return [
        *(sys.executable, "-m", "tilepipe", "streets", str(raster), "--out", str(out)),
        *("--set", f"diffusion_steps={steps}", "--overwrite", "--quiet"),
    ]


def _first_tile(command: Sequence[str], run: Path) -> float:
    shutil.rmtree(run, ignore_errors=True)
    return time_to_first_file(command, run / STATE, "*/levels/[!.]*.facts")


def _pipeline(command: Sequence[str], run: Path, truth: Path, size: int, repetitions: int) -> Outcome:
    outcome = repeated(Outcome("**tilepipe streets**", Scene(size), load=load_average()), command, run, repetitions)
    if size <= LARGEST_SCORED:
        for way in ("centerlines", "skeleton"):
            outcome.scores[way] = evaluate(run / f"{way}.parquet", truth, BUFFER)
    return outcome


def _plain(raster: Path, folder: Path, truth: Path, size: int, steps: int, repetitions: int) -> Outcome:
    outcome = Outcome("plain script", Scene(size), load=load_average())
    if size > LARGEST_PLAIN:
        outcome.skipped = "holds the raster in memory many times over"
        return outcome
    out = folder / "plain.parquet"
    command = [sys.executable, "-m", "benchmarks.streets.plain_script", str(raster), str(out), str(steps)]
    repeated_rival(outcome, command, out, repetitions)
    if not outcome.skipped:
        outcome.scores["skeleton"] = evaluate(out, truth, BUFFER)
    return outcome


def _speed_table(outcomes: Sequence[Outcome], steps: int) -> Table:
    columns = (
        "contestant", "city", "Mpx/s", "seconds", "best", "peak GiB", "lines", "completeness", "correctness", "quality",
        "RMS m", "load",
    )  # fmt: skip
    table = Table(f"Streets from intensity, {steps} diffusion steps", columns)
    for outcome in outcomes:
        if outcome.skipped:
            table.rows.append([outcome.contestant, outcome.scene.name, f"skipped: {outcome.skipped}", *[""] * 9])
            continue
        speed = [
            number(outcome.rate),
            f"{outcome.seconds:.1f}",
            f"{min(run.seconds for run in outcome.runs):.1f}",
            f"{max(run.peak for run in outcome.runs) / 2**30:.2f}",
        ]
        load = f"{outcome.load:.1f}"
        if not outcome.scores:
            table.rows.append([outcome.contestant, outcome.scene.name, *speed, "not scored", *[""] * 4, load])
        for row, (way, score) in enumerate(outcome.scores.items()):
            head = [outcome.contestant, outcome.scene.name, *speed] if row == 0 else [""] * 6
            table.rows.append([*head, way, *_score_cells(score), load if row == 0 else ""])
    return table


def _score_cells(score: LineScore) -> list[str]:
    shares = (score.completeness, score.correctness, score.quality)
    return [*(f"{100 * share:.1f} %" for share in shares), f"{score.rms_distance:.2f}"]
