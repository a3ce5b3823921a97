"""``memory``: the peak of runs on the worst contents beside what was planned for them, and what they were allowed."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from benchmarks.measure.commands import scratch_folder
from benchmarks.measure.machine import describe_machine
from benchmarks.measure.tables import RESULTS, Table, save
from benchmarks.measure.watch import CommandError, watch
from benchmarks.memory.contents import CONTENTS, write_content
from tilepipe.engine.options import RunOptions, format_memory, parse_memory
from tilepipe.engine.planning import Plan
from tilepipe.engine.request import plan_pipeline
from tilepipe.pipelines import registry

SIZE, QUICK_SIZE = 2048, 512
TILE = 1024
EXECUTORS = ("threads", "processes")
_REFUSAL = "error: "


@dataclass(frozen=True)
class Kept:
    """A run beside its plan and what it was allowed.

    Attributes
    ----------
    pipeline, content
        What ran on what.
    side, tile, workers, executor
        How large the raster was, and how it was run.
    plan
        Of the run.
    allowed
        Its ``--memory``, in bytes.
    peak
        Most memory of all its processes together, in bytes.
    stopped
        Why it was refused or stopped, if it was.
    """

    pipeline: str
    content: str
    side: int
    tile: int
    workers: int
    executor: str
    plan: Plan
    allowed: int
    peak: int
    stopped: str = ""

    @property
    def verdict(self) -> str:
        """Whether the run has kept to what it was allowed."""
        kept = "kept" if self.peak <= self.allowed else "**more than allowed**"
        return f"{kept}; {self.stopped or 'done'}"

    @property
    def wanted(self) -> int:
        """What a run that was stopped says that it needs, in bytes; 0 where it was done, or cannot be done at all."""
        named = re.search(r"such as --memory (\S+)", self.stopped)
        return parse_memory(named[1]) if named else 0

    @property
    def cells(self) -> list[str]:
        """A row of the table."""
        memory = [format_memory(size) for size in (self.plan.memory, self.plan.most_memory, self.allowed, self.peak)]
        way = f"{self.workers} {self.executor}"
        return [self.pipeline, self.content, str(self.side), str(self.tile), way, *memory, self.verdict]


def run_memory(
    *,
    sizes: Sequence[int] = (SIZE,),
    tiles: Sequence[int] = (TILE,),
    workers: Sequence[int] = (2,),
    executors: Sequence[str] = EXECUTORS,
    contents: Sequence[str] = tuple(CONTENTS),
    pipelines: Sequence[str] = registry.OWN,
    scratch: Path | None = None,
    results: Path | None = RESULTS,
) -> list[Kept]:
    """Measure, print the table and write the page.

    Parameters
    ----------
    sizes
        Sides of the rasters in pixels.
    tiles
        Sides of the tiles in pixels.
    workers, executors
        How to run.
    contents, pipelines
        What on what.
    scratch
        Folder for temporary files.
    results
        Folder of the page; None writes none.

    Raises
    ------
    RuntimeError
        When a run fails otherwise than by refusing its input, or for a lack of memory.
    """
    runs: list[Kept] = []
    with scratch_folder(scratch) as folder:
        for size, content, name in product(sizes, contents, pipelines):
            raster = write_content(folder, content, size, heights=name == "objects")
            for how in product(tiles, workers, executors):
                allowed: int | None = None
                # first what is usual, then, from the start, what the run has said that it needs
                while allowed is None or allowed:
                    runs.append(_kept(name, content, raster, size, *how, allowed, folder / "run"))
                    print(" · ".join(runs[-1].cells), flush=True)
                    allowed = runs[-1].wanted
    columns = ("pipeline", "content", "side", "tile", "workers", "usual", "at most", "allowed", "peak", "verdict")
    table = Table("Peak memory of all processes beside the plan", columns, [run.cells for run in runs])
    table.show()
    if results is not None:
        save("memory", describe_machine(), [_LEGEND, "", table.markdown()], results)
    return runs


_LEGEND = (
    "*usual* is what a plan says of the content that a pipeline is made for, *at most* what it says of any content. "
    "Each run was allowed the usual by `--memory`; one that stopped ran again from its start with what it asked for. "
    "*peak* adds up the high-water marks of all processes of a run, so that what they share counts several times."
)


def _kept(
    name: str,
    content: str,
    raster: Path,
    side: int,
    tile: int,
    workers: int,
    executor: str,
    allowed: int | None,
    out: Path,
) -> Kept:
    options = RunOptions(tile=tile, workers=workers, executor=executor, memory=1 << 50)
    plan = plan_pipeline(registry.pipeline(name), [raster], options=options)
    allowed = allowed or plan.memory
    how = ["--tile", tile, "--workers", workers, "--executor", executor, "--memory", str(allowed)]
    command = [sys.executable, "-m", "tilepipe", name, raster, "--out", out, "--quiet", *how]
    shutil.rmtree(out, ignore_errors=True)
    stopped = ""
    try:
        peak = watch([str(part) for part in command]).peak
    except CommandError as failure:
        peak = failure.seen.peak
        _, found, stopped = str(failure).rpartition(_REFUSAL)
        if not found:
            raise
    return Kept(name, content, side, tile, workers, executor, plan, allowed, peak, " ".join(stopped.split()))
