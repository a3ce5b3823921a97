"""How a run is carried out: tiles, workers, memory. None of it changes a result."""

from __future__ import annotations

import math
import operator
import os
import re
import sys
from dataclasses import dataclass

from tilepipe.errors import InputError
from tilepipe_kernels.core.arrays import Backend, choose_backend

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def parse_memory(text: str) -> int:
    """Bytes of a size such as ``8GiB``, ``500MB`` or ``2G`` (all powers of 1024).

    Raises
    ------
    InputError
        When the text is no size.

    Examples
    --------
    >>> from tilepipe.engine.options import parse_memory
    >>> parse_memory("8GiB"), parse_memory("500 MB")
    (8589934592, 524288000)
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if not match:
        raise InputError(f"memory '{text}' is not understood; write for example 8GiB or 500MiB")
    try:
        return int(float(match[1]) * _UNITS[match[2].upper()])
    except OverflowError:
        raise InputError(f"memory '{text}' is more than any machine has; write for example 8GiB or 500MiB") from None


def format_memory(size: float, *, up: bool = True) -> str:
    """A number of bytes for people: ``1.4 GiB``.

    What is needed is rounded up and what is allowed (``up=False``) down: so what is said to be needed is enough, and
    never seems to be what is allowed already.

    Examples
    --------
    >>> from tilepipe.engine.options import format_memory
    >>> format_memory(1_500_000_000), format_memory(1_500_000_000, up=False), format_memory(640)
    ('1.4 GiB', '1.3 GiB', '640 B')
    """
    whole = math.ceil if up else math.floor
    for unit in ("B", "KiB", "MiB"):
        if size < 1024:
            return f"{whole(size)} {unit}"
        size /= 1024
    return f"{whole(size * 10) / 10:.1f} GiB"


def default_workers() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class RunOptions:
    """Options common to all pipelines.

    Attributes
    ----------
    tile
        Tile size in pixels.
    workers
        Threads or processes that work on tiles; None = as many as there are cores, fewer where ``memory`` holds
        no more.
    executor
        ``threads``, ``processes``, or the address of a dask.distributed scheduler.
    backend
        ``numpy``, ``cupy`` (NVIDIA GPUs), or ``auto``: a GPU where this machine has one.  Of a cluster, whose
        workers need not be like this machine, nothing is guessed: ``auto`` is ``numpy`` there.
    memory
        Most memory that the run may use, in bytes; checked before work starts.  The same bounds the memory that it
        takes of a GPU.
    seed
        Seed of all random draws.
    format
        Format of the tables: ``parquet``, ``gpkg``, ``fgb`` or ``geojson``.
    overwrite
        Replace a finished run.

    Examples
    --------
    >>> import tilepipe
    >>> options = tilepipe.RunOptions(tile=1024, workers=4, backend="numpy", memory=4 << 30)
    >>> options.resolved_backend(), options.uses_cluster
    ('numpy', False)
    """

    tile: int = 2048
    workers: int | None = None
    executor: str = "threads"
    backend: str = "auto"
    memory: int = 8 << 30
    seed: int = 0
    format: str = "parquet"
    overwrite: bool = False

    def __post_init__(self) -> None:
        for name in ("tile", "workers", "memory", "seed"):
            value = getattr(self, name)
            if name == "workers" and value is None:
                continue
            try:
                object.__setattr__(self, name, operator.index(value))
            except TypeError:
                raise InputError(f"{name} {value!r} is no whole number") from None
        if self.tile < 1:
            raise InputError(f"tile size {self.tile} is too small: use at least 1, better 1024 or more")
        if self.workers is not None and self.workers < 1:
            raise InputError(f"{self.workers} workers cannot work: use at least 1")
        if self.memory > sys.maxsize:
            raise InputError("memory is more than any machine can address; write for example 8GiB or 500MiB")
        if not 0 <= self.seed < 1 << 62:
            raise InputError(f"seed {self.seed} cannot be used: take a number from 0 to 2^62")
        if self.backend not in ("auto", "numpy", "cupy"):
            raise InputError(f"backend '{self.backend}' is unknown: use auto, numpy or cupy")
        if self.format not in ("parquet", "gpkg", "fgb", "geojson"):
            raise InputError(f"format '{self.format}' is unknown: use parquet, gpkg, fgb or geojson")

    @property
    def uses_cluster(self) -> bool:
        """Whether tiles are computed by the workers of a cluster."""
        return "://" in self.executor

    def resolved_backend(self) -> Backend:
        """The backend of the passes.

        Raises
        ------
        InputError
            For ``cupy`` where this machine computes the tiles and cannot; the message says why.
        """
        if self.uses_cluster:
            return "cupy" if self.backend == "cupy" else "numpy"
        try:
            return choose_backend(self.backend)
        except ValueError as error:
            raise InputError(f"backend '{self.backend}' does not work here: {error}; or use --backend numpy") from None

    @property
    def resolved_workers(self) -> int:
        """Number of workers; where none is named and no plan has found how many memory holds, that of the cores."""
        return default_workers() if self.workers is None else self.workers

    @property
    def device_memory(self) -> int:
        """Most memory that a process may take of a GPU, in bytes."""
        return self.memory // (self.resolved_workers if self.executor == "processes" else 1)
