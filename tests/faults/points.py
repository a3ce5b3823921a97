"""The points of a run at which something can go wrong, counted; at one of them it does.

A fault is what the outside does to a run: the disk refuses a call, a write stops half way, memory is used up, somebody
presses Ctrl-C, the process is killed, or the power fails.  After a kill the process is as good as dead: nothing that it
still tries, its own tidying up included, reaches the disk.  After a power failure, moreover, what was written since the
last fsync of a file is not on the disk.
"""

from __future__ import annotations

import errno
import os
import random
import threading
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

FAULTS = ("refused", "torn", "memory", "interrupt", "kill", "torn kill", "power")
"""All that can happen at a point."""

_ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES, errno.EMFILE, errno.ESTALE)
"""What a disk that refuses a call may say."""


class Killed(BaseException):
    """Stands for the end of the process."""


@dataclass(frozen=True)
class Fault:
    """What happens at which point, counted from 0; point -1 is none."""

    point: int
    kind: str


class Points:
    """Counts the points of one run and lets its fault happen.

    Parameters
    ----------
    root
        Only what concerns files below this folder counts.
    fault
        What happens, and where.
    seed
        Decides what a fault leaves open, such as how much of a torn write arrives.
    """

    def __init__(self, root: Path, fault: Fault, seed: int = 0) -> None:
        self.root = os.path.realpath(root)
        self.fault = fault
        self.random = random.Random(seed)
        self.count = 0
        self.kinds: Counter[str] = Counter()
        self.happened = ""
        self.dead = False
        self._durable: dict[int, int] = {}
        self._lock = threading.Lock()
        self._late = False
        self._remember_all()

    def reach(self, kind: str) -> None:
        """Pass a point, unless the fault happens there."""
        if self.dead:
            raise Killed
        if self.arrives(kind):
            self.strike(kind)

    def arrives(self, kind: str) -> bool:
        """Count a point; whether the fault happens there."""
        with self._lock:
            here = self.count == self.fault.point or self._late
            # an interruption reaches the main thread only
            self._late = here and self.fault.kind == "interrupt" and not _is_main()
            self.count += 1
            self.kinds[kind] += 1
            return here and not self._late

    def strike(self, kind: str) -> None:
        """Let the fault happen now."""
        self.happened = f"{self.fault.kind} at point {self.fault.point} ({kind})"
        if self.fault.kind in ("kill", "torn kill", "power"):
            self.dead = True
            raise Killed
        if self.fault.kind == "interrupt":
            raise KeyboardInterrupt
        if self.fault.kind == "memory" or kind == "allocation":
            raise MemoryError
        if kind == "task":
            raise RuntimeError("the worker is lost")
        code = self.random.choice(_ERRORS)
        raise OSError(code, os.strerror(code))

    def synced(self, descriptor: int) -> None:
        """Note that what a file holds now is on the disk."""
        status = os.fstat(descriptor)
        self._durable[status.st_ino] = status.st_size

    def end(self) -> None:
        """Leave on the disk what the fault leaves there; call when nothing of the run is at work any more."""
        if self.happened.startswith("power"):
            for path in _files(self.root):
                size, known = path.stat().st_size, self._durable.get(path.stat().st_ino, 0)
                if size > known:
                    os.truncate(path, known + self.random.choice((0, (size - known) // 2)))

    def _remember_all(self) -> None:
        """What was there before the run is on the disk."""
        for path in _files(self.root):
            self._durable[path.stat().st_ino] = path.stat().st_size


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


def _files(root: str) -> list[Path]:
    return [path for path in Path(root).rglob("*") if path.is_file() and not path.is_symlink()]
