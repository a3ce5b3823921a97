"""How contestants of one case are timed side by side.

All contestants of a case take turns, round by round, so that a change of the machine's mood meets all of them alike.
"""

from __future__ import annotations

import ctypes
import gc
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

Call = Callable[[int], Any]
"""Does the work once with so many threads; returns the result."""

Build = Callable[[], Call]
"""Imports the library and prepares the input, untimed."""


class Unsuitable(Exception):  # noqa: N818 - it is an answer, not an error
    """A library has nothing for this work; the text says what it lacks."""


@dataclass(frozen=True)
class Contestant:
    """One way to do a case's work.

    Attributes
    ----------
    name
        As in the table.
    build
        Makes the call; an ImportError or `Unsuitable` in it skips the contestant.
    ours
        Whether it is tilepipe's.
    serial
        Whether it can use only one core, so that one measurement serves both columns.
    share
        Share of the case's work that it does, for those too slow to do all of it.
    note
        What else a reader must know.
    small
        Makes the same call for a small input, which compiles whatever the large one needs.
    """

    name: str
    build: Build
    ours: bool = False
    serial: bool = False
    share: float = 1.0
    note: str = ""
    small: Build | None = None

    @property
    def compiled(self) -> bool:
        """Whether nothing is left to compile in the first call of `build`."""
        return self.small is not None or not self.ours


@dataclass(frozen=True)
class Case:
    """The same work for all contestants.

    Attributes
    ----------
    name
        As in the table.
    unit
        Of the rate, such as ``Mpx/s``.
    work
        Millions of units to be done.
    traffic
        Bytes of all arrays that the kernel must read or write, each counted once.
    contestants
        Ours and the peers.
    aim
        Rate that ours should reach on all cores.
    """

    name: str
    unit: str
    work: float
    traffic: int
    contestants: Sequence[Contestant]
    aim: float | None = None


@dataclass(frozen=True)
class Measurement:
    """Times of one contestant in seconds, per number of threads; ``skipped`` says why there are none.

    Where it was too slow to be asked again, there are none of one core.
    """

    contestant: Contestant
    all_cores: list[float] = field(default_factory=list)
    one_core: list[float] = field(default_factory=list)
    peak: int | None = None
    skipped: str = ""

    def rate(self, case: Case, *, one_core: bool = False, best: bool = False) -> float:
        """Millions of units per second, of the median or the shortest time; NaN where it was not timed."""
        times = self.one_core if one_core else self.all_cores
        if not times:
            return math.nan
        seconds = min(times) if best else statistics.median(times)
        return case.work * self.contestant.share / seconds


def measure(
    case: Case, *, workers: int, repetitions: int = 3, peers: bool = True, patience: float = 20.0
) -> list[Measurement]:
    """Time all contestants of a case.

    Parameters
    ----------
    case
        What to measure.
    workers
        Threads of the column "all cores".
    repetitions
        Rounds after the warm-up.
    peers
        Whether the peers run too.
    patience
        Seconds; a contestant whose warm-up takes longer is timed by that very call, one core and memory are not
        measured.  Where it may have compiled too, a second call decides.

    Returns
    -------
    list of Measurement
        In the order of the contestants.
    """
    with _frozen():
        found = [_warmed_up(contestant, workers, peers, patience) for contestant in case.contestants]
    with _frozen():
        return _timed(case, found, workers, repetitions, patience)


@contextmanager
def _frozen() -> Iterator[None]:
    """What is there already is left out of the collections before each call, which would walk it every time."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _timed(
    case: Case,
    found: Sequence[tuple[Measurement, Call | None, float]],
    workers: int,
    repetitions: int,
    patience: float,
) -> list[Measurement]:
    """Time the contestants that are warmed up."""
    swift = []
    for measurement, call, warm in found:
        contestant = measurement.contestant
        if call is None:
            _tell(case, contestant, f"skipped: {measurement.skipped}")
        elif warm <= patience:
            swift.append((measurement, call))
        else:
            measurement.all_cores.append(warm)
            _tell(case, contestant, f"{warm:.3g} s, once")
    for _ in range(repetitions):
        for measurement, call in swift:
            measurement.all_cores.append(_seconds(call, workers))
            if workers > 1 and not measurement.contestant.serial:
                measurement.one_core.append(_seconds(call, 1))
    peaks = {}
    for measurement, call in swift:
        _tell(case, measurement.contestant, f"{statistics.median(measurement.all_cores):.3g} s")
        peaks[measurement.contestant.name] = _peak_memory(call, workers)
    return [
        replace(
            m,
            one_core=m.all_cores if m.contestant.serial or workers == 1 else m.one_core,
            peak=peaks.get(m.contestant.name),
        )
        for m, _, _ in found
    ]


def _tell(case: Case, contestant: Contestant, what: str) -> None:
    """A line of progress."""
    print(f"{case.name}: {contestant.name}, {what}", flush=True)


def _warmed_up(
    contestant: Contestant, workers: int, peers: bool, patience: float
) -> tuple[Measurement, Call | None, float]:
    """Build and call once, so that compilers, caches and lazy imports are not measured; also the seconds it took."""
    if not (contestant.ours or peers):
        return Measurement(contestant, skipped="peers were not asked for"), None, 0.0
    try:
        if contestant.small is not None:
            contestant.small()(workers)
        call = contestant.build()
    except ImportError as error:
        return Measurement(contestant, skipped=f"not installed: {error.name or error}"), None, 0.0
    except Unsuitable as reason:
        return Measurement(contestant, skipped=str(reason)), None, 0.0
    seconds = _seconds(call, workers)
    if seconds > patience and not contestant.compiled:
        seconds = _seconds(call, workers)
    return Measurement(contestant), call, seconds


def _seconds(call: Call, workers: int) -> float:
    gc.collect()
    start = time.perf_counter()
    result = call(workers)
    seconds = time.perf_counter() - start
    del result
    return seconds


def _peak_memory(call: Call, workers: int) -> int | None:
    """Most memory in bytes that a call adds to the process, its result included; None where glibc is not below.

    The input is there already and does not count.
    """
    try:
        gc.collect()
        # What earlier calls have freed goes back to the system, so that this one must take it anew and is seen.
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        before = _status("VmRSS")
        result = call(workers)
        peak = _status("VmHWM") - before
        del result
    except (OSError, AttributeError):
        return None
    return max(peak, 0)


def _status(name: str) -> int:
    """A size of this process from the kernel's books, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    raise OSError(f"no {name}")
