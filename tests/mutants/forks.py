"""Runs pytest in forks of a process that has loaded what tests import of others, which takes longer than most tests.

Nothing of the checkout itself is loaded before the fork, so that each run sees the files as they are then.
"""

from __future__ import annotations

import importlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


class Forks:
    """The side that asks; made by `forks`.

    Parameters
    ----------
    process
        That forks.
    copy
        Folder of the checkout, beside which it leaves what it says.
    """

    def __init__(self, process: subprocess.Popen[bytes], copy: Path) -> None:
        self._process = process
        self._said, self._loaded = copy.parent / "said.txt", copy.parent / "loaded.json"

    def run(self, arguments: Sequence[str], seconds: float) -> tuple[int | None, str]:
        """Exit code of pytest, none where it was stopped after so many seconds, and what it said."""
        request = {"arguments": list(arguments), "said": str(self._said), "loaded": str(self._loaded)}
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(request).encode() + b"\n")
        child = int(self._process.stdout.readline())
        in_time = bool(select.select([self._process.stdout], [], [], seconds)[0])
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        code = int(self._process.stdout.readline())
        return code if in_time else None, self._said.read_text(errors="replace")


@contextmanager
def forks(copy: Path, environment: dict[str, str]) -> Iterator[Forks]:
    """Start a process that forks, in a copy of the checkout."""
    command = [sys.executable, __file__]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
    with subprocess.Popen(command, cwd=copy, env=environment, **pipes) as process:
        try:
            yield Forks(process, copy)
        finally:
            process.kill()


def _serve() -> None:
    sys.path[0] = os.getcwd()
    asked, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w", buffering=1)
    for line in asked:
        request = json.loads(line)
        if (child := os.fork()) == 0:
            sys.exit(_run(request))
        answers.write(f"{child}\n")
        _, status = os.waitpid(child, 0)
        _load(Path(request["loaded"]))
        answers.write(f"{os.waitstatus_to_exitcode(status)}\n")


def _run(request: dict[str, Any]) -> int:
    os.setsid()
    with open(os.devnull) as nothing, open(request["said"], "w") as said:
        os.dup2(nothing.fileno(), 0)
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
    import pytest

    code = int(pytest.main(request["arguments"]))
    variables = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
    modules = [
        name
        for name, module in list(sys.modules.items())
        if "site-packages" in (getattr(module, "__file__", None) or "") and not name.endswith("__main__")
    ]
    Path(request["loaded"]).write_text(json.dumps([variables, modules]))
    return code


def _load(listed: Path) -> None:
    """Load what the last run has loaded of others; numba then looks at variables that the tests have set."""
    with suppress(OSError, ValueError):
        variables, modules = json.loads(listed.read_text())
        os.environ |= variables
        for name in modules:
            if name not in sys.modules:
                with suppress(Exception):
                    importlib.import_module(name)


if __name__ == "__main__":
    _serve()
