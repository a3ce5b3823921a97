"""``streets``: the pipeline from end to end on a synthetic city, beside a plain script."""

from __future__ import annotations

import json
import shutil
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.kernels.page import warn_if_busy
from benchmarks.measure.machine import describe_machine, load_average
from benchmarks.measure.tables import RESULTS, Table, number, save
from benchmarks.measure.watch import Watched, time_to_first_file, watch
from tilepipe.engine.run import STATE
from tilepipe.evaluate.lines import LineScore, evaluate
from tilepipe.io.record import TIMINGS
from tilepipe.synthetic import City, write_city

SIZE, QUICK_SIZE = 4096, 1024
BUFFER = 3.0
"""Buffer of the scores in metres."""
LARGEST_SCORED = 16384
"""Side of the largest city whose lines are scored: scoring holds all lines in memory."""
LARGEST_PLAIN = 8192
"""Side of the largest city that the plain script is given: it holds the raster many times over."""
LONG = 120.0
"""Seconds; a run that takes longer is not repeated."""

LEGEND = (
    "The whole command, from the start of the interpreter to the last file; median of the rounds. *peak* is the most "
    "memory that it held, children included. Scores are those of Heipke et al. (1997) within {buffer:g} m of the "
    "true centerlines, also where trees, cars or voids hide a street. *Plain script* is "
    "`benchmarks/streets/plain_script.py`."
)


@dataclass
class Outcome:
    """What one contestant did on one city."""

    name: str
    size: int
    runs: list[Watched] = field(default_factory=list)
    scores: dict[str, LineScore] = field(default_factory=dict)
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
        return self.size**2 / 1e6 / self.seconds


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
    warn_if_busy(machine)
    outcomes: list[Outcome] = []
    first_tile: list[float] = []
    for size in sizes:
        with tempfile.TemporaryDirectory(prefix="tilepipe-bench-", dir=scratch) as temporary:
            folder = Path(temporary)
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
    tables = [_speed_table(outcomes, steps), _stage_table([o for o in outcomes if o.stages])]
    for table in tables:
        table.show()
    start = (
        f"Second start of the command: {statistics.median(first_tile):.2f} s to the first finished tile "
        f"(median of {len(first_tile)}, at {sizes[0]} × {sizes[0]} pixels)."
    )
    print(start)
    if results is not None:
        parts = [LEGEND.format(buffer=BUFFER), "", start, "", *(table.markdown() for table in tables)]
        save("streets", machine, parts, results)
    return outcomes


def _command(raster: Path, out: Path, steps: int) -> list[str]:
    return [
        *(sys.executable, "-m", "tilepipe", "streets", str(raster), "--out", str(out)),
        *("--set", f"diffusion_steps={steps}", "--overwrite", "--quiet"),
    ]


def _first_tile(command: Sequence[str], run: Path) -> float:
    shutil.rmtree(run, ignore_errors=True)
    return time_to_first_file(command, run / STATE / "levels", "[!.]*.facts")


def _pipeline(command: Sequence[str], run: Path, truth: Path, size: int, repetitions: int) -> Outcome:
    outcome = Outcome("**tilepipe streets**", size, load=load_average())
    for _ in range(repetitions):
        shutil.rmtree(run, ignore_errors=True)
        outcome.runs.append(watch(command))
        outcome.stages.append(json.loads((run / TIMINGS).read_text()))
        if outcome.runs[-1].seconds > LONG:
            break
    if size <= LARGEST_SCORED:
        for way in ("centerlines", "skeleton"):
            outcome.scores[way] = evaluate(run / f"{way}.parquet", truth, BUFFER)
    return outcome


def _plain(raster: Path, folder: Path, truth: Path, size: int, steps: int, repetitions: int) -> Outcome:
    outcome = Outcome("plain script", size, load=load_average())
    if size > LARGEST_PLAIN:
        outcome.skipped = "holds the raster in memory many times over"
        return outcome
    out = folder / "plain.parquet"
    command = [sys.executable, "-m", "benchmarks.streets.plain_script", str(raster), str(out), str(steps)]
    try:
        watch(command)
    except RuntimeError as error:
        outcome.skipped = str(error).strip().splitlines()[-1]
        return outcome
    for _ in range(repetitions):
        outcome.runs.append(watch(command))
        if outcome.runs[-1].seconds > LONG:
            break
    outcome.scores["skeleton"] = evaluate(out, truth, BUFFER)
    return outcome


def _speed_table(outcomes: Sequence[Outcome], steps: int) -> Table:
    columns = (
        "contestant", "city", "Mpx/s", "seconds", "best", "peak GiB", "lines", "completeness", "correctness", "quality",
        "RMS m", "load",
    )  # fmt: skip
    table = Table(f"Streets from intensity, {steps} diffusion steps", columns)
    for outcome in outcomes:
        city = f"{outcome.size}² = {outcome.size**2 / 1e6:.0f} Mpx"
        if outcome.skipped:
            table.rows.append([outcome.name, city, f"skipped: {outcome.skipped}", *[""] * 9])
            continue
        speed = [
            number(outcome.rate),
            f"{outcome.seconds:.1f}",
            f"{min(run.seconds for run in outcome.runs):.1f}",
            f"{max(run.peak for run in outcome.runs) / 2**30:.2f}",
        ]
        load = f"{outcome.load:.1f}"
        if not outcome.scores:
            table.rows.append([outcome.name, city, *speed, "not scored", *[""] * 4, load])
        for row, (way, score) in enumerate(outcome.scores.items()):
            head = [outcome.name, city, *speed] if row == 0 else [""] * 6
            table.rows.append([*head, way, *_score_cells(score), load if row == 0 else ""])
    return table


def _score_cells(score: LineScore) -> list[str]:
    shares = (score.completeness, score.correctness, score.quality)
    return [*(f"{100 * share:.1f} %" for share in shares), f"{score.rms_distance:.2f}"]


def _stage_table(outcomes: Sequence[Outcome]) -> Table:
    """Seconds and share of the time per stage, medians; what stages at work at one time leave over is the rest."""
    table = Table("Where the time goes (stages may overlap)", ("stage", *(f"{o.size}²" for o in outcomes)))
    names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.stages[0]))
    columns = []
    for outcome in outcomes:
        seconds = [statistics.median(stages.get(name, 0.0) for stages in outcome.stages) for name in names]
        seconds.append(max(0.0, outcome.seconds - sum(seconds)))
        columns.append([f"{value:.1f} s, {value / outcome.seconds:.0%}" for value in seconds])
    table.rows.extend([*row] for row in zip([*names, "start and the rest"], *columns, strict=True))
    return table
