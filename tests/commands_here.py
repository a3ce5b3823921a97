"""Commands of tilepipe inside the process of a test: what is compiled and imported there serves them all."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import pytest

from benchmarks.measure.watch import Watched
from tilepipe.cli import app

START = [sys.executable, "-m", "tilepipe"]


def watch_here(command: Sequence[str], interval: float = 0.0) -> Watched:
    """`benchmarks.measure.watch.watch` without a new interpreter, nor the memory that it takes."""
    assert list(command[:3]) == START
    start = time.perf_counter()
    app(list(command[3:]), standalone_mode=False)
    return Watched(time.perf_counter() - start, 0)


def run_commands_here(monkeypatch: pytest.MonkeyPatch, *modules: str) -> None:
    """Let the modules that watch commands run them here."""
    for module in modules:
        monkeypatch.setattr(f"{module}.watch", watch_here)
