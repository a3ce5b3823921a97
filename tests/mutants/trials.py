"""One mutant at a time in a copy of the checkout: do the tests that run its line see it?"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.checkout import FAILED, QUIET, copied, environment, run_tests
from tests.mutants.covering import Covering
from tests.mutants.forks import Forks, forks
from tests.mutants.making import Mutant
from tests.mutants.places import place

KILLED, LATE, SURVIVED, UNCOVERED = "killed", "timed out", "survived", "not covered"

_SHORTEST, _TIMES = 30.0, 10.0
"""A test is given so many seconds, or so many times what the slowest of the run takes."""

_START = 120.0
"""Seconds that pytest has to find its tests."""

_TOO_LONG = re.compile(r"^Timeout \(", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """What the tests said of a mutant: whether it was killed, by which test, and how many were chosen for it."""

    mutant: Mutant
    ended: str
    by: str = ""
    tests: int = 0


class Trials:
    """Tries mutants in a copy.

    Parameters
    ----------
    copy
        Folder of the copy.
    covering
        Which tests run which lines.
    seconds
        Of tests for one mutant: those of its line, and again as many of its file where it survives them.
    forks
        Run the tests.
    """

    def __init__(self, copy: Path, covering: Covering, seconds: float, forks: Forks) -> None:
        self.copy = copy
        self.covering = covering
        self.seconds = seconds
        self.forks = forks

    def outcome(self, mutant: Mutant, mutated: str) -> Outcome:
        """Try a mutant; the copy is as before afterwards.

        Parameters
        ----------
        mutant
            What is changed.
        mutated
            Text of its file with the change.
        """
        path = self.copy / mutant.path
        text = path.read_text()
        here = place(ast.parse(text), mutant.line)
        tests = self.covering.tests(mutant.path, here.scope or here.lines)
        first = self.covering.fastest(tests, self.seconds)
        # what is kept from an earlier call, was imported already, or ran in a process that was killed, is seen by tests
        # of which it is not known that they run the line
        others = self.covering.tests(mutant.path, self.covering.lines[mutant.path]) - set(first)
        tried = 0
        try:
            path.write_text(mutated)
            for chosen in (first, self.covering.fastest(others, self.seconds)):
                tried += len(chosen)
                if chosen and (ended := self._run(chosen)) is not None:
                    return Outcome(mutant, *ended, tried)
        finally:
            path.write_text(text)
        return Outcome(mutant, SURVIVED if tests else UNCOVERED, "", tried)

    def _run(self, tests: list[str]) -> tuple[str, str] | None:
        """How the mutant came to its end by these tests, and by which; nothing if it did not."""
        longest = max(_SHORTEST, _TIMES * max(self.covering.seconds[test] for test in tests))
        limits = ["-o", f"faulthandler_timeout={longest}", "-o", "faulthandler_exit_on_timeout=true"]
        total = _START + longest + _TIMES * sum(self.covering.seconds[test] for test in tests)
        listed = self.copy.parent / "tests.txt"
        listed.write_text("\n".join(tests))
        code, said = self.forks.run([*QUIET, "-x", *limits, f"@{listed}"], total)
        if code == 0:
            return None
        found = FAILED.search(said)
        late = code is None or _TOO_LONG.search(said)
        return LATE if late else KILLED, found[1] if found else ""


@contextmanager
def trials(root: Path, covering: Covering, seconds: float) -> Iterator[Trials]:
    """Trials in a copy of a checkout, which goes away."""
    with copied(root) as copy, forks(copy, environment(copy)) as forking:
        yield Trials(copy, covering, seconds, forking)


def failing(copy: Path, tests: Iterable[str]) -> set[str]:
    """Which of the tests fail though nothing is changed, or are not found: they say nothing of a mutant."""
    wanted = sorted(set(tests))
    if not wanted:
        return set()
    listed = copy.parent / "tests.txt"
    listed.write_text("\n".join(wanted))
    ended = run_tests(copy, [f"@{listed}"])
    return set(FAILED.findall(ended.said)) if ended.code in (0, 1) else set(wanted)


def to_line(outcome: Outcome) -> str:
    """An outcome as a line of JSON."""
    return json.dumps(vars(outcome) | {"mutant": vars(outcome.mutant)})


def from_line(line: str) -> Outcome:
    """An outcome of a line of JSON."""
    found = json.loads(line)
    return Outcome(**found | {"mutant": Mutant(**found["mutant"])})
