"""A run at work: it holds its folder, runs passes with resume, keeps timings and publishes its layers.

``RUN/.state`` exists exactly while a run is unfinished and holds everything needed to resume it.  Layers are written
there and renamed into ``RUN`` at the very end, together; then ``RUN/run.toml``, the record, marks the run as finished.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Progress
from tilepipe.engine.publication import publish
from tilepipe.engine.run_folder import Record, Uses, begin, check_folder, read_identity, remove_state, sweep_finished
from tilepipe.engine.run_lock import RunLock, held
from tilepipe.engine.tiles.executors import Executor, open_executor
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.errors import InputError, MemoryLimitError, OutputError, TileError
from tilepipe.io.files.identity import ChangedInputError
from tilepipe.io.files.record import STATE
from tilepipe.io.rasters.sources.source import Source
from tilepipe_kernels.core.cache import listening

_GDAL_CACHE = 64
"""GDAL's cache of decoded blocks in MiB; its own choice grows with the machine and would break the memory plan."""

Result = TypeVar("Result")


class Run:
    """An unfinished run: runs passes with resume, keeps timings, publishes layers."""

    def __init__(
        self, folder: Path, state: Path, lock: RunLock, options: RunOptions, executor: Executor, progress: Progress
    ) -> None:
        self.folder = folder
        self.state = state
        self._lock = lock
        self.options = options
        self.executor = executor
        self.progress = progress
        self.timings: dict[str, float] = {}

    def run_pass(self, bound: BoundPass) -> Ledger:
        """Run a pass on all tiles; returns its ledger."""
        with self.timed(bound.name):
            return run_pass(bound, self.state, self.executor, self.progress)

    @contextmanager
    def beside(self, function: Callable[..., Result], *arguments: Any) -> Iterator[Future[Result]]:
        """Run a function in a thread of its own beside the block; the block ends when it has ended."""
        with ThreadPoolExecutor(1, thread_name_prefix="beside") as pool:
            yield pool.submit(function, *arguments)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Add the wall time of a block to the timings of stage ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - start

    def publish(self, layers: Sequence[Path], record: Record) -> None:
        """Rename finished layers of the state into the run folder and mark the run as finished.

        Raises
        ------
        OutputError
            Another process has taken the folder over, or a file that is in the way is none of tilepipe.
        """
        publish(self.folder, self.state, layers, record, self.timings, self._lock)


@contextmanager
def open_run(
    folder: Path,
    record: Record,
    identity: Record,
    options: RunOptions,
    progress: Progress,
    uses: Uses | None = None,
    sources: Sequence[Source] = (),
) -> Iterator[Run]:
    """Begin a run in a folder, or resume it.

    Parameters
    ----------
    folder
        The run's folder; made when missing.
    record
        Everything as resolved, for ``run.toml``.
    identity
        The part of it that decides the state on disk: an unfinished run is resumed only when it is the same.
    options
        How to run.
    progress
        Told about progress.
    uses
        What the run reads and publishes.
    sources
        Inputs; finished tiles are used only if these are still what they have read.

    Raises
    ------
    InputError
        When the folder holds a finished run, an unfinished run of something else, foreign files, or cannot be
        written; when an input would be replaced; or when another process is at work in it.
    """
    uses = uses or Uses()
    try:
        sweep_finished(folder)
        check_folder(folder, uses, overwrite=options.overwrite)
        made = [item for item in (folder, *folder.parents) if not item.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with held(folder, folder / STATE) as lock:
                yield from _held_run(folder, record, identity, options, progress, uses, sources, lock)
        except InputError:
            # all is as it was before the refusal; what holds something stays
            with suppress(OSError):
                for item in made:
                    item.rmdir()
            raise
    except OSError as error:
        raise disk_error(error, folder) from error


def _held_run(
    folder: Path,
    record: Record,
    identity: Record,
    options: RunOptions,
    progress: Progress,
    uses: Uses,
    sources: Sequence[Source],
    lock: RunLock,
) -> Iterator[Run]:
    try:
        # another process may have finished in between
        check_folder(folder, uses, overwrite=options.overwrite)
        state, began = begin(folder, record, identity, sources, overwrite=options.overwrite)
    except InputError:
        if read_identity(folder / STATE) is None:
            remove_state(folder, lock)
        raise
    try:
        with (
            _explained(lock),
            listening(progress.compiling),
            _small_cache(),
            open_executor(options.executor, options.resolved_workers, state) as executor,
        ):
            yield Run(folder, state, lock, options, executor, progress)
    except (ChangedInputError, MemoryLimitError, OutputError):
        # finished tiles are good: if the input turns out to be the same, with more memory, or where there is room
        raise
    except InputError:
        if began and _passes_with_facts(state) <= 1:
            remove_state(folder, lock)
        raise


@contextmanager
def _explained(lock: RunLock) -> Iterator[None]:
    """What fails on disk after another process has taken the folder over fails because of that."""
    try:
        yield
    except (OSError, OutputError, TileError) as error:
        try:
            lock.require()
        except OutputError as reason:
            raise reason from error
        raise


def _passes_with_facts(state: Path) -> int:
    if not state.is_dir():
        return 0
    return sum(1 for item in state.iterdir() if item.is_dir() and any(item.glob("*.facts")))


@contextmanager
def _small_cache() -> Iterator[None]:
    """Bound GDAL's cache in this process and in those started within, unless the user has chosen its size."""
    import rasterio

    if "GDAL_CACHEMAX" in os.environ:
        yield
        return
    os.environ["GDAL_CACHEMAX"] = str(_GDAL_CACHE)
    try:
        with rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE << 20):
            yield
    finally:
        del os.environ["GDAL_CACHEMAX"]


def disk_error(error: OSError, folder: Path) -> InputError:
    """What to tell the user about a failure to write."""
    reason = error.strerror or str(error)
    # of a rename the name that lasts
    named = error.filename2 or error.filename or folder
    return InputError(f"{named}: cannot be written ({reason}); free space or name another folder")
