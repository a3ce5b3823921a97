"""What the figures were measured on: processor, versions, load, memory bandwidth."""

from __future__ import annotations

import os
import platform
import re
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from tilepipe.engine.options import default_workers

BUSY = 1.5
"""Load average above which timings mislead."""

PEERS = (
    "opencv-contrib-python-headless", "connected-components-3d", "scikit-image", "scipy", "skan", "medpy",
    "ridge-detector", "dask", "zarr", "higra", "rasterio", "shapely", "PyMaxflow", "gco-wrapper",
)  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """Where and when; ``bandwidth`` counts bytes read and bytes written, in bytes per second."""

    processor: str
    cores: int
    memory: int
    python: str
    versions: dict[str, str]
    date: str
    load: float
    bandwidth: float

    def lines(self) -> list[str]:
        """The description for people."""
        listed = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        return [
            f"{self.processor}, {self.cores} cores, {self.memory / 2**30:.0f} GiB; Python {self.python}; {listed}.",
            f"{self.date}, load average at the start {self.load:.1f}; "
            f"copying a large array moves {self.bandwidth / 1e9:.1f} GB/s with {self.cores} threads.",
        ]

    def announce(self) -> None:
        """Print the description, and a warning where others are at work."""
        for line in self.lines():
            print(line)
        if self.load > BUSY:
            print(f"warning: the load average is {self.load:.1f}; timings under load mislead, run again when idle")


def describe_machine() -> Machine:
    """The machine as it is now; measures its bandwidth."""
    packages = ("numpy", "numba", *PEERS)
    return Machine(
        processor=_processor(),
        cores=default_workers(),
        memory=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        python=platform.python_version(),
        versions={name: found for name in packages if (found := _version(name))},
        date=datetime.now(UTC).date().isoformat(),
        load=load_average(),
        bandwidth=copy_bandwidth(default_workers()),
    )


def load_average() -> float:
    """Processes that wanted a core in the last minute; NaN where the system does not say."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*:\s*(.+)$", path.read_text(), re.MULTILINE) if path.exists() else None
    return found[1].strip() if found else platform.processor() or platform.machine()


def copy_bandwidth(workers: int, size: int = 1 << 29, repetitions: int = 5) -> float:
    """Bytes read and written per second while ``workers`` threads copy an array of ``size`` bytes, the best of some.

    The array must not fit in a cache: what counts is the memory behind it.
    """
    source = np.ones(size // 8, np.float64)
    target = np.zeros_like(source)
    parts = list(zip(np.array_split(source, workers), np.array_split(target, workers), strict=True))
    times = []
    with ThreadPoolExecutor(workers) as pool:
        for _ in range(repetitions):
            start = time.perf_counter()
            list(pool.map(lambda part: np.copyto(part[1], part[0]), parts))
            times.append(time.perf_counter() - start)
    return 2 * source.nbytes / min(times)
