"""Every kernel and every pipeline on cupy arrays against numpy: do they agree, and how fast are they.

``scripts/gpu-check`` prints one table and writes it to ``benchmarks/gpu-<device>.md``.  Kernels need numpy, scipy,
numba, numba-cuda and cupy; the pipelines what tilepipe needs, and are skipped where that is not installed.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gpu.cases import GpuCase, cases
from tilepipe_kernels.core import arrays
from tilepipe_kernels.core.simulated import simulating

SIZE, CHECKED_SIZE, HOST_SIZE = 8192, 1024, 2048
"""Sides in pixels: of what the GPU is timed on, of what is compared, and of a CPU core's share."""

HEADER = ("kernel", "agreement", "Gpx/s", "of copy bandwidth", "over all CPU cores", "note")
LEGEND = (
    "*agreement*: with the CPU's result on the same input; *the same* is bit for bit. *Gpx/s*: pixels (or node "
    "updates) of each step or round. *of copy bandwidth*: what must be read and written, each array counted once, "
    "against a device-to-device copy measured here. *over all CPU cores*: rate against all cores of this machine, each "
    "at work on a square of its own; disk and transfers are in neither, save for whole pipelines."
)


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    agreement: str = ""
    rate: str = ""
    share: str = ""
    gain: str = ""
    note: str = ""
    passed: bool = True

    def cells(self) -> tuple[str, ...]:
        """As in `HEADER`."""
        return self.name, self.agreement, self.rate, self.share, self.gain, self.note


# ------------------------------------------------------------------------------------------------- comparing


def flat(result: Any) -> Iterator[NDArray[Any]]:
    """All arrays and numbers of a result on the host, in order."""
    if dataclasses.is_dataclass(result):
        for entry in dataclasses.fields(result):
            yield from flat(getattr(result, entry.name))
    elif isinstance(result, (tuple, list)):
        for each in result:
            yield from flat(each)
    elif result is not None:
        yield np.asarray(arrays.to_host(result))


def agreement(expected: Any, found: Any, tolerance: float) -> tuple[bool, str]:
    """Whether two results agree, and how well, in words."""
    pairs = list(zip(flat(expected), flat(found), strict=True))
    if any(a.shape != b.shape for a, b in pairs):
        return False, "differs in shape"
    if any(a.dtype != b.dtype for a, b in pairs if a.ndim):
        return False, "differs in dtype"
    if all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs):
        return True, "the same"
    worst = 0.0
    for a, b in pairs:
        if a.dtype.kind == "f":
            with np.errstate(invalid="ignore"):  # infinities that are equal
                gap = np.abs(np.asarray(a, np.float64) - b)
            if not np.array_equal(np.isnan(a), np.isnan(b)):
                return False, "differs in missing values"
            worst = max(worst, float(np.nanmax(gap, initial=0.0)))
        elif not np.array_equal(a, b):
            return False, f"{np.count_nonzero(a != b)} of {a.size} differ"
    return worst <= tolerance, f"within {worst:.1e}"


def timed(call: Callable[[], Any], repetitions: int, wait: Callable[[], None] = lambda: None) -> float:
    """Median seconds of a call after one that compiles."""
    call()
    wait()
    seconds = []
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        wait()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


# ------------------------------------------------------------------------------------------------- the device


def synchronize() -> None:
    """Wait for the device."""
    if not simulating():
        arrays.device_namespace().cuda.Device().synchronize()


def device_name() -> str:
    """Name of the device."""
    if simulating():
        return "simulator"
    return str(arrays.device_namespace().cuda.runtime.getDeviceProperties(0)["name"].decode())


def copy_bandwidth(size: int) -> float:
    """Bytes read and written per second by a copy on the device."""
    xp = arrays.device_namespace()
    source, target = xp.ones(size, xp.float32), xp.empty(size, xp.float32)
    seconds = timed(lambda: xp.copyto(target, source), 10, synchronize)
    return 8 * size / seconds


def measure(case: GpuCase, sizes: tuple[int, int, int], bandwidth: float, repetitions: int) -> Row:
    """Compare and time a kernel."""
    size, checked, host = sizes
    try:
        inputs = case.make(checked)
        found = case.run(*map(on_device, inputs))
        passed, words = agreement(case.run(*inputs), found, case.tolerance)
        large = tuple(map(on_device, case.make(size)))
        seconds = timed(lambda: case.run(*large), repetitions, synchronize)
        cpu = _rate_of_all_cores(case, host, repetitions)
    except Exception as error:  # a kernel that fails is a line of the table, and the others go on
        return Row(case.name, "FAILED", note=in_one_line(error), passed=False)
    work = size**2 * case.steps
    rate = work / seconds
    return Row(
        case.name,
        words if passed else f"FAILED: {words}",
        f"{rate / 1e9:.3g}",
        f"{rate * case.traffic / bandwidth:.0%}",
        f"{rate / cpu:.1f} x",
        "" if case.unit == "px" else case.unit,
        passed,
    )


def in_one_line(error: Exception) -> str:
    """Kind and first line of an error, fit for a cell of the table."""
    lines = str(error).splitlines() or ["no message"]
    return f"{type(error).__name__}: {lines[0][:120]}".replace("|", "/")


def on_device(value: Any) -> Any:
    """Arrays on the device; numbers as they are."""
    return arrays.to_device(value) if isinstance(value, np.ndarray) else value


def _rate_of_all_cores(case: GpuCase, size: int, repetitions: int) -> float:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    inputs = case.make(size)
    with ThreadPoolExecutor(cores) as pool:
        seconds = timed(lambda: list(pool.map(lambda _: case.run(*inputs), range(cores))), repetitions)
    return cores * size**2 * case.steps / seconds


# ------------------------------------------------------------------------------------------------- the table


def markdown(rows: list[Row], device: str, bandwidth: float) -> str:
    """The page."""
    head = [
        f"# GPU check: {device}",
        "",
        f"{datetime.now(UTC).date()}; {versions()}; a copy moves {bandwidth / 1e9:,.0f} GB/s.",
    ]
    table = [" | ".join(HEADER), " | ".join("---" for _ in HEADER), *(" | ".join(row.cells()) for row in rows)]
    return "\n".join([*head, "", *(f"| {line} |" for line in table), "", LEGEND, ""])


def versions() -> str:
    """Of what the result depends on."""
    import numba

    xp = "simulated" if simulating() else f"cupy {arrays.device_namespace().__version__}"
    return f"numpy {np.__version__}, numba {numba.__version__}, {xp}, Python {sys.version.split()[0]}"


def run_check(
    sizes: tuple[int, int, int], *, only: str = "", repetitions: int = 5, pipelines: bool = True
) -> list[Row]:
    """All rows, printed as they are ready."""
    bandwidth = copy_bandwidth(sizes[0] ** 2)
    rows = []
    for case in cases():
        if only.lower() in case.name.lower():
            rows.append(measure(case, sizes, bandwidth, repetitions))
            print(" | ".join(rows[-1].cells()), flush=True)
    if pipelines and not only:
        from benchmarks.gpu.pipelines import pipeline_rows

        for cells in pipeline_rows(sizes[0], in_one_line):
            rows.append(Row(**cells))
            print(" | ".join(rows[-1].cells()), flush=True)
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Command line; 1 if a kernel disagrees or anything fails, 2 if there is nothing to check or to check it on."""
    parser = argparse.ArgumentParser(prog="scripts/gpu-check", description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=SIZE, help="side of what the GPU is timed on, in pixels")
    parser.add_argument("--checked-size", type=int, default=CHECKED_SIZE, help="side of what is compared")
    parser.add_argument("--host-size", type=int, default=HOST_SIZE, help="side of the square of each CPU core")
    parser.add_argument("--rounds", type=int, default=5, help="repetitions of each timing")
    parser.add_argument("--only", default="", help="kernels whose name holds this")
    parser.add_argument("--no-pipelines", action="store_true", help="kernels only")
    parser.add_argument("--out", type=Path, help="folder of the page; benchmarks/ unless given, none with --only")
    options = parser.parse_args(arguments)
    if min(options.size, options.checked_size, options.host_size, options.rounds) < 1:
        parser.error("sizes and rounds must be 1 or more")
    try:
        arrays.device_namespace()
    except ValueError as error:
        print(f"scripts/gpu-check: {error}", file=sys.stderr)
        return 2
    device = device_name()
    sizes = options.size, options.checked_size, options.host_size
    rows = run_check(sizes, only=options.only, repetitions=options.rounds, pipelines=not options.no_pipelines)
    if not rows:
        print(f"scripts/gpu-check: no kernel has {options.only!r} in its name", file=sys.stderr)
        return 2
    page = markdown(rows, device, copy_bandwidth(sizes[0] ** 2))
    print(page)
    if options.out or not options.only:
        path = (options.out or Path(__file__).resolve().parents[1]) / f"gpu-{device.lower().replace(' ', '-')}.md"
        path.write_text(page)
        print(f"written to {path}")
    return 0 if all(row.passed for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
