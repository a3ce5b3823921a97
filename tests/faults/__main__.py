"""Disturb thousands of small runs: ``python -m tests.faults --seeds 10000``; writes a page with what happened."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.commit import commit
from tests.faults.points import FAULTS
from tests.faults.scenes import SCENES
from tests.faults.simulator import calm, disturb_seed

PAGE = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "faults.md"

SHARES = {"bright_spots": 70, "streets": 10, "objects": 10, "edges": 10}
"""Per cent of the seeds; the pipeline of the documentation is the fastest, and has all parts of a run."""


def main() -> int:
    """Run the seeds, print those that went wrong, write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--seeds", type=int, default=400, help="disturbed runs of all pipelines together")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the page is written")
    chosen = parser.parse_args()
    start, ended, wrong = time.monotonic(), Counter[tuple[str, str, str]](), []
    todo = [(name, chosen.first + seed) for name in SCENES for seed in range(chosen.seeds * SHARES[name] // 100)]
    with ProcessPoolExecutor(chosen.jobs, multiprocessing.get_context("spawn")) as pool:
        for name, seed, kind, outcome in pool.map(disturb_seed, *zip(*todo, strict=True), chunksize=8):
            ended[name, kind, outcome.ended] += 1
            if outcome.wrong:
                wrong.append(f"- {name}, seed {seed}, {outcome.happened}: {outcome.wrong}")
                print(wrong[-1], flush=True)
    chosen.page.write_text(_page(ended, wrong, len(todo), time.monotonic() - start))
    return 1 if wrong else 0


def _page(ended: Counter[tuple[str, str, str]], wrong: list[str], runs: int, seconds: float) -> str:
    ways = sorted({way for _, _, way in ended})
    lines = [
        "# Disturbed runs",
        "",
        f"`python -m tests.faults --seeds {runs}` at {commit()}: {runs:,} small runs, each with one fault at one point "
        "(a write, rename, fsync, removal, allocation or tile), then resumed by the same command; "
        f"{seconds / 60:.0f} minutes.",
        f"Runs after which something was wrong: **{len(wrong)}**.",
        "",
        "| pipeline | points in a run | fault | " + " | ".join(ways) + " |",
        "|---|---:|---|" + "---:|" * len(ways),
    ]
    for name in SCENES:
        for kind in FAULTS:
            counts = " | ".join(str(ended[name, kind, way]) for way in ways)
            lines.append(f"| {name} | {calm(name)[1]} | {kind} | {counts} |")
    return "\n".join(
        [*lines, "", "How the disturbed runs ended is above; 'well' is a fault that was made good.", *wrong, ""]
    )


if __name__ == "__main__":
    sys.exit(main())
