"""Copies of the checkout, in which mutants live and tests run: the user's own files are never touched."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]

QUIET = ("-p", "no:cacheprovider", "--no-header", "-q", "--tb=no", "-rfE")
"""Arguments of pytest by which it leaves nothing behind and says only what fails."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", re.MULTILINE)
"""Tests that fail, in what pytest says."""


@dataclass(frozen=True)
class Ended:
    """How a run of pytest ended: its exit code, or none where it was stopped, and what it said."""

    code: int | None
    said: str


@contextmanager
def copied(root: Path = ROOT) -> Iterator[Path]:
    """Copy the files of a checkout that git knows, or would know, into a folder that goes away."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        check=True,
    )
    with TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder) / root.name
        for name in listed.stdout.decode().split("\0"):
            if name and (root / name).is_file():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, copy / name)
        _compile(copy)
        yield copy


def _compile(copy: Path) -> None:
    """Compile all modules, to be found by their text: a mutant may have the size and the time of its original."""
    command = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", str(copy)]
    subprocess.run(command, check=True, env=environment(copy))


def run_tests(
    copy: Path, arguments: Sequence[str], *, seconds: float | None = None, variables: Mapping[str, str] | None = None
) -> Ended:
    """Run pytest in a copy; the process and all its children end with it.

    Parameters
    ----------
    copy
        Folder of the copy.
    arguments
        Of pytest.
    seconds
        After which the run is stopped.
    variables
        Of the environment, besides those of this process.
    """
    command = [sys.executable, "-m", "pytest", *QUIET, *arguments]
    process = subprocess.Popen(
        command,
        cwd=copy,
        env=environment(copy) | (variables or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=seconds)
        return Ended(process.returncode, said)
    except subprocess.TimeoutExpired:
        return Ended(None, "")
    finally:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def environment(copy: Path) -> dict[str, str]:
    """Variables with which the tests of a copy run."""
    # with CI set, Hypothesis draws the same examples in each run; plugins take longer to load than most tests to run
    own = {
        "PYTHONPATH": os.pathsep.join([str(copy), str(copy / "kernels")]),
        "CI": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }
    # the test that runs here, should one do so, is none of the copy's
    without = ("PYTHONDONTWRITEBYTECODE", "PYTEST_CURRENT_TEST")
    return {name: value for name, value in os.environ.items() if name not in without} | own
