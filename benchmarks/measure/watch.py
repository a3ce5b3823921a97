"""Run a command and watch it from outside: time, peak memory with its children, time until a first file."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Watched:
    """Seconds from start to end, and peak memory in bytes (0 where the system does not tell)."""

    seconds: float
    peak: int


class CommandError(RuntimeError):
    """A command has failed; holds what it said, and what was seen of it until then."""

    def __init__(self, said: str, seen: Watched) -> None:
        super().__init__(said)
        self.seen = seen


def watch(command: Sequence[str], interval: float = 0.02) -> Watched:
    """Run a command to its end.

    Raises
    ------
    CommandError
        When it fails.
    """
    peaks: dict[int, int] = {}
    with tempfile.TemporaryFile() as said:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT)
        while process.poll() is None:
            for member in _tree(process.pid):
                peaks[member] = max(peaks.get(member, 0), _high_water(member))
            # waiting, not sleeping, so that the end is seen at once
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(interval)
        seen = Watched(time.perf_counter() - start, sum(peaks.values()))
        if process.returncode:
            said.seek(0)
            raise CommandError(f"{' '.join(command)} failed: {said.read().decode(errors='replace')[-2000:]}", seen)
    return seen


def time_to_first_file(command: Sequence[str], folder: Path, pattern: str, interval: float = 0.002) -> float:
    """Seconds from the start of a command until a file appears in a folder; the command is then ended."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not any(folder.glob(pattern)):
            if process.poll() is not None:
                raise RuntimeError(f"{' '.join(command)} ended without {pattern} in {folder}")
            time.sleep(interval)
        return time.perf_counter() - start
    finally:
        process.terminate()
        process.wait()


def _tree(pid: int) -> list[int]:
    """A process and its descendants."""
    found = [pid]
    for listed in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in listed.read_text().split():
                found += _tree(int(child))
    return found


def _high_water(pid: int) -> int:
    """Most memory that a process has held so far, in bytes; 0 when it is gone."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return 0
