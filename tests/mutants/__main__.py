"""Change the code in small ways and count how many of the changes the tests see; writes a page with the score."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.checkout import ROOT
from tests.mutants.covering import Covering, kept_file, measured
from tests.mutants.judged import judgements, outdated
from tests.mutants.making import Mutant, mutants, sample
from tests.mutants.page import page
from tests.mutants.trials import KILLED, SURVIVED, Outcome, Trials, failing, from_line, to_line, trials

PATHS = ["tilepipe/engine", "tilepipe/io", "tilepipe/tiling"]
PAGE = ROOT / "benchmarks" / "results" / "mutants.md"


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/mutants", description=__doc__)
    parser.add_argument("paths", nargs="*", metavar="PATH", default=PATHS, help=f"default: {' '.join(PATHS)}")
    parser.add_argument("--sample", type=int, default=400, help="mutants that are tried (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="which ones are drawn (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=20, help="of tests for one mutant (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="copies in which tests run at once (default: %(default)s)")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the page is written")
    chosen = parser.parse_args()
    if old := outdated(ROOT, judgements()):
        parser.error(f"tests/mutants/judged.toml: {old[0].path} has no line {old[0].before!r} any more")
    folders = {path.rstrip("/"): list(_all_mutants(path)) for path in chosen.paths}
    if empty := [path for path, found in folders.items() if not found]:
        parser.error(f"{empty[0]} holds no Python that can be changed")
    covering = measured(chosen.jobs)
    found = [mutant for each in folders.values() for mutant in each]
    todo = list(sample(ROOT, found, chosen.sample, chosen.seed))
    outcomes = _tried(todo, covering, chosen.seconds, chosen.jobs)
    counts = {path: len(each) for path, each in folders.items()}
    command = shlex.join(["scripts/mutants", *sys.argv[1:]])
    chosen.page.write_text(page(command, ROOT, counts, outcomes, judgements()))
    print(f"see {chosen.page}")
    return 0


def _all_mutants(path: str) -> Iterator[Mutant]:
    place = ROOT / path
    for file in [place] if place.is_file() else sorted(place.rglob("*.py")):
        yield from mutants(ROOT, str(file.relative_to(ROOT)))


def _tried(todo: list[tuple[Mutant, str]], covering: Covering, seconds: float, jobs: int) -> list[Outcome]:
    """Outcomes in the order of the sample; those of earlier calls for this state of the checkout are taken over."""
    notes = kept_file(f"outcomes-{seconds:g}.jsonl")
    lines = notes.read_text().splitlines() if notes.exists() else []
    done = {outcome.mutant: outcome for outcome in map(from_line, lines)}
    with ExitStack() as stack, open(notes, "a") as file:
        free: SimpleQueue[Trials] = SimpleQueue()
        for _ in range(jobs):
            free.put(stack.enter_context(trials(ROOT, covering, seconds)))

        def outcome(mutant: Mutant, mutated: str) -> Outcome:
            here = free.get()
            try:
                return here.outcome(mutant, mutated)
            finally:
                free.put(here)

        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        running = {mutant: pool.submit(outcome, mutant, mutated) for mutant, mutated in todo if mutant not in done}
        for number, (mutant, future) in enumerate(running.items(), 1):
            done[mutant] = future.result()
            print(
                f"{number}/{len(running)} {done[mutant].ended} {mutant.path}:{mutant.line} {mutant.operator}",
                flush=True,
            )
            file.write(to_line(done[mutant]) + "\n")
            file.flush()
        outcomes = [done[mutant] for mutant, _ in todo]
        return list(_believed(outcomes, failing(free.get().copy, (each.by for each in outcomes if each.by))))


def _believed(outcomes: Iterable[Outcome], failing_anyway: set[str]) -> Iterator[Outcome]:
    """Outcomes without those of tests that fail though nothing is changed."""
    for each in outcomes:
        if each.ended == KILLED and each.by in failing_anyway:
            print(f"{each.by} fails by itself: what it says of {each.mutant.path}:{each.mutant.line} does not count")
            each = replace(each, ended=SURVIVED)
        yield each


if __name__ == "__main__":
    sys.exit(main())
