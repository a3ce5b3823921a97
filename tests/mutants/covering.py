"""Which tests run which lines, measured once for each state of the checkout and kept."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

from coverage import CoverageData
from coverage.exceptions import DataError

from tests.mutants import noted
from tests.mutants.checkout import FAILED, ROOT, copied, run_tests

KEPT = ROOT / ".mutants"
"""Folder of what is measured, which git ignores."""

FOLDERS = ("accessor", "cli", "engine", "evaluate", "io", "project", "tiling")
"""Folders of the tests that are measured; those of whole pipelines take longer than all of these together."""

_START = "import coverage\n\ncoverage.process_startup()\n"
_SETTINGS = """[run]
parallel = true
data_file = {folder}/lines
source = {source}
concurrency = thread, multiprocessing
patch = _exit
core = ctrace
context = ${{PYTEST_CURRENT_TEST-}}
"""
_PHASE = re.compile(r" \((setup|call|teardown)\)$")


@dataclass(frozen=True)
class Covering:
    """Tests by line.

    Parameters
    ----------
    seconds
        That each test takes, the fixtures that it shares with others included.
    lines
        Tests that run a line, by file (relative to the checkout) and line.
    """

    seconds: dict[str, float]
    lines: dict[str, dict[int, frozenset[str]]]

    def tests(self, path: str, lines: Iterable[int]) -> set[str]:
        """Tests that run any of these lines of a file."""
        known = self.lines.get(path, {})
        return set[str]().union(*(known.get(line, ()) for line in lines))

    @cached_property
    def breadth(self) -> Counter[str]:
        """How many lines each test runs."""
        return Counter(test for known in self.lines.values() for tests in known.values() for test in tests)

    def fastest(self, tests: Iterable[str], seconds: float) -> list[str]:
        """As many tests as take so many seconds, the fastest of all.

        Those that run few lines, which are those of the very thing, come first; those of one file together, for their
        fixtures.
        """
        chosen: dict[str, list[str]] = {}
        left = seconds
        for test in sorted(tests, key=lambda test: (self.seconds[test], test)):
            left -= self.seconds[test]
            if left < 0:
                break
            chosen.setdefault(test.partition("::")[0], []).append(test)
        files = sorted(chosen.values(), key=lambda tests: (fmean(self.breadth[test] for test in tests), tests))
        return [test for tests in files for test in sorted(tests, key=lambda test: (self.breadth[test], test))]


def measured(jobs: int) -> Covering:
    """Tests by line of this state of the checkout; measured where that was not done before."""
    kept = kept_file("covering.json")
    if not kept.exists():
        with copied() as copy:
            found = measure(copy, "tilepipe", [f"tests/{name}" for name in FOLDERS], jobs)
        aside = kept.with_suffix(f".{os.getpid()}")
        aside.write_text(json.dumps(found))
        aside.replace(kept)
    return from_table(json.loads(kept.read_text()))


def from_table(found: dict[str, Any]) -> Covering:
    """Tests by line from what `measure` gives."""
    names = list(found["seconds"])
    lines = {
        path: {int(line): frozenset(names[number] for number in numbers) for line, numbers in each.items()}
        for path, each in found["lines"].items()
    }
    return Covering(found["seconds"], lines)


def kept_file(name: str) -> Path:
    """A file that holds what is known of this state of the checkout."""
    folder = KEPT / _state()
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


def _state() -> str:
    """Digest of the Python that is measured."""
    digest = hashlib.sha256()
    paths = [*(ROOT / "tests").glob("*.py")]
    for folder in ("kernels", "tilepipe", *(f"tests/{name}" for name in FOLDERS)):
        paths.extend((ROOT / folder).rglob("*.py"))
    for path in sorted(paths):
        digest.update(f"{path.relative_to(ROOT)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def measure(copy: Path, source: str, tests: Sequence[str], jobs: int = 1) -> dict[str, Any]:
    """Run tests in a copy; how long each takes that passes, and their numbers by file and line.

    Parameters
    ----------
    copy
        Folder of the copy.
    source
        Folder in it whose lines count.
    tests
        As pytest takes them.
    jobs
        Processes.
    """
    with TemporaryDirectory() as folder:
        start = Path(folder, "start")
        start.mkdir()
        (start / "sitecustomize.py").write_text(_START)
        shutil.copy(noted.__file__, start / "noted.py")
        settings = Path(folder, "settings.ini")
        settings.write_text(_SETTINGS.format(folder=folder, source=copy / source))
        variables = {
            "PYTHONPATH": os.pathsep.join([str(start), str(copy), str(copy / "kernels")]),
            "COVERAGE_PROCESS_START": str(settings),
            noted.FOLDER: folder,
        }
        shared = ["-p", "xdist", "-n", str(jobs)] if jobs > 1 else []
        said = run_tests(copy, ["-p", "noted", *shared, *tests], variables=variables).said
        for test in FAILED.findall(said):
            print(f"{test} fails, and is left out", flush=True)
        notes: dict[str, dict[str, Any]] = {}
        for path in Path(folder).glob("notes-*.json"):
            notes |= json.loads(path.read_text())
        return _joined(copy, Path(folder), notes)


def _joined(copy: Path, folder: Path, notes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The data of all processes as one table."""
    numbers = {name: number for number, name in enumerate(notes)}
    users: dict[str, set[int]] = {}
    for name, note in notes.items():
        for context in (name, *note["uses"]):
            users.setdefault(context, set()).add(numbers[name])
    lines: dict[str, dict[int, set[int]]] = {}
    for path in folder.glob("lines*"):
        data = CoverageData(str(path))
        try:
            data.read()
        except DataError:
            continue  # of a process that a test killed while it wrote
        for file in data.measured_files():
            known = lines.setdefault(str(Path(file).relative_to(copy)), {})
            for line, contexts in data.contexts_by_lineno(file).items():
                for context in contexts:
                    known.setdefault(line, set()).update(users.get(_PHASE.sub("", context), ()))
    return {
        "seconds": {name: note["seconds"] for name, note in notes.items()},
        "lines": {path: {line: sorted(each) for line, each in known.items()} for path, known in lines.items()},
    }
