"""Run one pass: a function of one tile and its halo over all tiles, anywhere, in any order, resumable.

A pass reads a raster and earlier state, writes the cores of its state arrays and returns the tile's *facts*, small
named arrays that a reconciliation needs.  When both are on disk the tile is done.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.device import on_device
from tilepipe.engine.executors import Executor
from tilepipe.engine.ledger import Ledger, checksum
from tilepipe.errors import TileError
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid, Window
from tilepipe_kernels.core.arrays import Backend, to_host

_CHUNK = 1024
"""Largest chunk of a state array, in pixels: small enough that halos cost little to read."""


class Progress(Protocol):
    """What a run tells about its progress."""

    def start(self, name: str, total: int, done: int) -> None:
        """A stage of ``total`` tiles begins, of which ``done`` were finished by an earlier run."""
        ...

    def advance(self, name: str) -> None:
        """One more tile is finished."""
        ...

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Work that counts by itself has finished ``done`` of ``total``."""
        ...


class Silent:
    """Progress that tells nothing."""

    def start(self, name: str, total: int, done: int) -> None:
        """See `Progress.start`."""

    def advance(self, name: str) -> None:
        """See `Progress.advance`."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """See `Progress.__call__`."""


@dataclass(frozen=True)
class StateArray:
    """A raster of intermediate results in a Zarr array on ``grid``; each tile writes its core and no other chunk."""

    path: Path
    grid: TileGrid
    dtype: str
    fill: int = 0

    def create(self) -> None:
        """Create the array unless it is there."""
        import zarr
        from zarr.codecs import BloscCodec

        if (self.path / "zarr.json").exists():
            return
        chunks = tuple(_chunk(size) for size in self.grid.tile_shape)
        compressor = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")
        zarr.create_array(
            self.path,
            shape=self.grid.shape,
            chunks=chunks,
            dtype=self.dtype,
            fill_value=self.fill,
            compressors=compressor,
            overwrite=True,
        )

    def read(self, window: Window) -> NDArray[Any]:
        """Values of a window."""
        return np.asarray(_open_array(self.path)[window.slices])

    def write(self, tile: Tile, values: NDArray[Any]) -> int:
        """Write the core of a tile of this array's grid; returns the checksum of what was written."""
        values = np.ascontiguousarray(to_host(values), dtype=self.dtype)
        if values.shape != tile.core.shape:
            raise ValueError(f"tile {tile.name} writes {values.shape} into a core of {tile.core.shape}")
        _open_array(self.path)[tile.core.slices] = values
        return checksum(values)

    def checksum(self, tile: Tile) -> int:
        """Checksum of a tile's core as it lies on disk."""
        return checksum(self.read(tile.core))


def _chunk(size: int) -> int:
    """Largest divisor of a tile's size that is at most `_CHUNK`; the size itself when its divisors are tiny."""
    divisor = next(d for d in range(min(size, _CHUNK), 0, -1) if size % d == 0)
    return divisor if divisor >= min(size, _CHUNK // 4) else size


def _open_array(path: Path) -> Any:
    # a later run may make another array of the same name, so the handle is kept per version of its metadata
    return _opened_array(path, (path / "zarr.json").stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _opened_array(path: Path, _version: int) -> Any:
    import zarr

    return zarr.open_array(path, mode="r+")


TileFunction = Callable[[Any, Tile], Facts]


@dataclass(frozen=True)
class Pass:
    """A computation that runs on every tile.

    Attributes
    ----------
    name
        Name in messages, progress and the state folder.
    function
        Module-level function ``function(context, tile) -> facts``; it writes state arrays through `write_state`.
    context
        Everything the function needs, picklable.
    grid
        Tiling.
    halo
        Width in pixels that the function reads around a core.
    writes
        State arrays that the function fills, by name.
    bytes_per_pixel
        Peak working memory of the function per pixel of the padded window, for planning.
    backend
        Whose arrays the function works on.
    device_memory
        Most memory of the device that a process may use, in bytes; of no account for numpy.
    """

    name: str
    function: TileFunction
    context: Any
    grid: TileGrid
    halo: int
    writes: Mapping[str, StateArray] = field(default_factory=dict)
    bytes_per_pixel: int = 16
    backend: Backend = "numpy"
    device_memory: int = 8 << 30

    def memory(self) -> int:
        """Peak working memory of one tile in bytes, halo included."""
        rows, columns = (min(t + 2 * self.halo, s) for t, s in zip(self.grid.tile_shape, self.grid.shape, strict=True))
        return rows * columns * self.bytes_per_pixel


_CHECK = "checksum:"


def _run_tile(job: Pass, folder: Path, tile: Tile) -> int:
    """Compute one tile and record it; runs on a worker."""
    compute = partial(_facts_on_host, job, tile)
    facts = compute() if job.backend == "numpy" else on_device(compute, tile, job.device_memory)
    Ledger(folder).record(tile.name, facts)
    return tile.number


def _facts_on_host(job: Pass, tile: Tile) -> Facts:
    return {name: to_host(value) for name, value in job.function(job.context, tile).items()}


def write_state(arrays: Mapping[str, StateArray], tile: Tile, values: Mapping[str, NDArray[Any]]) -> Facts:
    """Write the cores of state arrays; returns the checksums as facts, to be returned by the tile function."""
    facts: Facts = {}
    for name, array in arrays.items():
        own = array.grid.tile(tile.number)
        facts[_CHECK + name] = np.array([array.write(own, values[name])], dtype=np.uint32)
    return facts


def run_pass(
    job: Pass,
    state: Path,
    executor: Executor,
    progress: Progress,
    *,
    verify: bool = True,
) -> Ledger:
    """Run a pass on all tiles that are not done yet.

    Parameters
    ----------
    job
        The pass.
    state
        Folder of the run's state; the pass keeps its ledger in ``state/<name>``.
    executor
        Where tiles are computed.
    progress
        Told about each finished tile.
    verify
        Compare the checksums of tiles finished by an earlier run with what lies on disk.

    Returns
    -------
    Ledger
        The pass's ledger; every tile is done.

    Raises
    ------
    TileError
        When tiles failed; all others are finished before it is raised, and it names them.
    """
    ledger = Ledger(state / job.name)
    for array in job.writes.values():
        array.create()
    tiles = list(job.grid.tiles(job.halo))
    marked = ledger.done()
    finished = {t.number for t in tiles if t.name in marked and (not verify or _verified(job, ledger, t))}
    todo = [tile for tile in tiles if tile.number not in finished]
    progress.start(job.name, len(tiles), len(finished))
    failures: list[tuple[Tile, BaseException]] = []
    for tile, _, error in executor.run(partial(_run_tile, job, ledger.folder), todo):
        if error is None:
            progress.advance(job.name)
        else:
            failures.append((tile, error))
    if failures:
        raise _tile_error(job.name, failures, len(tiles))
    return ledger


def _tile_error(name: str, failures: Sequence[tuple[Tile, BaseException]], total: int) -> TileError:
    failures = sorted(failures, key=lambda failure: failure[0].number)
    tile, error = failures[0]
    window = tile.core
    reason = (str(error).splitlines() or [""])[0] or type(error).__name__
    more = f" and {len(failures) - 1} more tiles" if len(failures) > 1 else ""
    place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
    failed = TileError(
        f"pass {name}: tile {tile.name} ({place}){more} of {total} failed: {reason}; "
        "nothing is published, the other tiles are kept: mend the cause and run the same command again"
    )
    failed.__cause__ = error
    return failed


def _verified(job: Pass, ledger: Ledger, tile: Tile) -> bool:
    """Whether a tile marked as done is whole on disk; if not it is forgotten."""
    try:
        facts = ledger.facts(tile.name)
        for name, array in job.writes.items():
            if int(facts[_CHECK + name][0]) != array.checksum(array.grid.tile(tile.number)):
                raise ValueError(f"state {name} differs")
    except Exception:
        ledger.forget(tile.name)
        return False
    return True


def default_workers() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
