"""``memory``: the peak of runs on the worst contents beside what was planned for them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measure.commands import scratch_folder
from benchmarks.measure.machine import describe_machine
from benchmarks.measure.tables import RESULTS, Table, save
from benchmarks.measure.watch import watch
from benchmarks.memory.contents import CONTENTS, write_content
from tilepipe.engine.options import RunOptions, format_memory
from tilepipe.engine.planning import Plan
from tilepipe.engine.request import plan_pipeline
from tilepipe.pipelines import registry

SIZE, QUICK_SIZE = 2048, 512
TILE = 1024
EXECUTORS = ("threads", "processes")
_REFUSAL = "error: "


@dataclass(frozen=True)
class Kept:
    """A run that was allowed what its plan says it can need at most.

    Attributes
    ----------
    pipeline, content
        What ran on what.
    side, tile, workers, executor
        How large the raster was, and how it was run.
    plan
        Of the run.
    peak
        Most memory of all its processes together, in bytes; 0 where it was refused.
    refused
        Why it was, if it was.
    """

    pipeline: str
    content: str
    side: int
    tile: int
    workers: int
    executor: str
    plan: Plan
    peak: int
    refused: str = ""

    @property
    def verdict(self) -> str:
        """Whether the run has kept to its plan."""
        if self.refused:
            return self.refused
        if self.peak <= self.plan.memory:
            return "within what is usual"
        return "within the most" if self.peak <= self.plan.most_memory else "**more than planned**"

    @property
    def cells(self) -> list[str]:
        """A row of the table."""
        memory = [format_memory(size) for size in (self.plan.memory, self.plan.most_memory, self.peak)]
        way = f"{self.workers} {self.executor}"
        return [self.pipeline, self.content, str(self.side), str(self.tile), way, *memory, self.verdict]


def run_memory(
    *,
    sizes: Sequence[int] = (SIZE,),
    tile: int = TILE,
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
    tile
        Side of the tiles in pixels.
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
        When a run fails otherwise than by refusing its input.
    """
    runs = []
    with scratch_folder(scratch) as folder:
        for size in sizes:
            for content in contents:
                for name in pipelines:
                    raster = write_content(folder, content, size, heights=name == "objects")
                    for executor in executors:
                        for number in workers:
                            runs.append(_kept(name, content, raster, size, tile, number, executor, folder / "run"))
                            print(" · ".join(runs[-1].cells), flush=True)
    columns = ("pipeline", "content", "side", "tile", "workers", "usual", "at most", "peak", "verdict")
    table = Table("Peak memory of all processes beside the plan", columns, [run.cells for run in runs])
    table.show()
    if results is not None:
        save("memory", describe_machine(), [_LEGEND, "", table.markdown()], results)
    return runs


_LEGEND = (
    "*usual* is what a plan says of the content that a pipeline is made for, *at most* what it says of any content; "
    "each run was allowed the latter by `--memory`. *peak* adds up the high-water marks of all processes of a run."
)


def _kept(name: str, content: str, raster: Path, side: int, tile: int, workers: int, executor: str, out: Path) -> Kept:
    options = RunOptions(tile=tile, workers=workers, executor=executor, memory=1 << 50)
    plan = plan_pipeline(registry.pipeline(name), [raster], options=options)
    how = ["--tile", tile, "--workers", workers, "--executor", executor, "--memory", f"{plan.most_memory >> 10}KiB"]
    command = [sys.executable, "-m", "tilepipe", name, raster, "--out", out, "--overwrite", "--quiet", *how]
    peak, refused = 0, ""
    try:
        peak = watch([str(part) for part in command]).peak
    except RuntimeError as failure:
        _, found, refused = str(failure).rpartition(_REFUSAL)
        if not found:
            raise
    return Kept(name, content, side, tile, workers, executor, plan, peak, " ".join(refused.split()))
