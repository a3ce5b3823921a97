"""The folder of a run: its record, its state while unfinished, and the publication of its layers.

``RUN/.state`` exists exactly while a run is unfinished and holds everything needed to resume it.  Layers are written
there and renamed into ``RUN`` at the very end, together; then ``RUN/run.toml``, the record, marks the run as finished.
"""

from __future__ import annotations

import json
import os
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Progress
from tilepipe.engine.tiles.executors import Executor, open_executor
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.errors import InputError
from tilepipe.io.atomic import atomic_write_bytes
from tilepipe.io.record import RECORD, TIMINGS, read_record
from tilepipe_kernels.core.cache import listening

STATE = ".state"
IDENTITY = "identity.toml"
LOCK = "lock"

_GDAL_CACHE = 64
"""GDAL's cache of decoded blocks in MiB; its own choice grows with the machine and would break the memory plan."""

Record = dict[str, Any]
Result = TypeVar("Result")


def absolute_name(name: str) -> str:
    """A path as it can be found from anywhere; the name of an array as it is."""
    path = Path(name)
    return str(path.absolute()) if path.exists() else name


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as TOML; values that are None are left out and mean the default."""
    import tomli_w

    def clean(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: clean(item) for key, item in value.items() if item is not None}
        return value

    atomic_write_bytes(path, tomli_w.dumps(clean(record)).encode())


class Run:
    """An unfinished run: runs passes with resume, keeps timings, publishes layers."""

    def __init__(self, folder: Path, options: RunOptions, executor: Executor, progress: Progress) -> None:
        self.folder = folder
        self.state = folder / STATE
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

    def publish(self, layers: Sequence[Path], record: Record, keep: tuple[str, ...]) -> None:
        """Rename finished layers into the run folder, drop the other layers of an earlier run, mark it as finished.

        Parameters
        ----------
        layers
            Finished files in the state folder; they keep their names.
        record
            What was run.
        keep
            All names that a run of this kind may publish; those not in ``layers`` are removed.
        """
        (self.folder / RECORD).unlink(missing_ok=True)
        for name in set(keep) - {layer.name for layer in layers}:
            (self.folder / name).unlink(missing_ok=True)
        for layer in layers:
            os.replace(layer, self.folder / layer.name)
        timings = {name: round(seconds, 3) for name, seconds in self.timings.items()}
        atomic_write_bytes(self.folder / TIMINGS, json.dumps(timings, indent=1).encode())
        write_record(self.folder / RECORD, record)
        # without its identity a state is nobody's, should this process end before all of it is gone
        (self.state / RECORD).unlink(missing_ok=True)
        (self.state / IDENTITY).unlink(missing_ok=True)
        shutil.rmtree(self.state)


@contextmanager
def open_run(folder: Path, record: Record, identity: Record, options: RunOptions, progress: Progress) -> Iterator[Run]:
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

    Raises
    ------
    InputError
        When the folder holds a finished run, an unfinished run of something else, foreign files, or cannot be
        written; or when another process is at work in it.
    """
    state = folder / STATE
    _check_folder(folder, options.overwrite)
    try:
        state.mkdir(parents=True, exist_ok=True)
        with (state / LOCK).open("w") as lock:
            _lock(lock, folder)
            began = _begin(folder, record, identity, options.overwrite)
            try:
                with (
                    listening(progress.compiling),
                    _small_cache(),
                    open_executor(options.executor, options.workers) as executor,
                ):
                    yield Run(folder, options, executor, progress)
            except InputError:
                if began and _passes_with_facts(state) <= 1:
                    _take_back(folder)
                raise
    except OSError as error:
        raise disk_error(error, folder) from error


def _check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that no run of this kind may touch, before anything is made in it."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder for the run")
    if (folder / STATE / IDENTITY).exists():
        return
    if (folder / RECORD).exists():
        if not overwrite:
            raise InputError(f"{folder}: holds a finished run; use --overwrite to replace it, or another --out")
    elif folder.exists() and any(item.name != STATE for item in folder.iterdir()):
        raise InputError(f"{folder}: is not empty and holds no run; name another folder")


def _passes_with_facts(state: Path) -> int:
    return sum(1 for item in state.iterdir() if item.is_dir() and any(item.glob("*.facts")))


def _take_back(folder: Path) -> None:
    """Remove a state that was begun in vain, so that the folder is what it was before the refusal."""
    shutil.rmtree(folder / STATE)
    if not any(folder.iterdir()):
        folder.rmdir()


def _begin(folder: Path, record: Record, identity: Record, overwrite: bool) -> bool:
    """Resume the state that has this identity, or begin an empty one (True); the caller holds the lock."""
    state = folder / STATE
    known = state / IDENTITY
    if known.exists():
        differences = _differences(_plain(identity), read_record(known))
        if not differences:
            return False
        if not overwrite:
            raise InputError(
                f"{folder}: holds an unfinished run that differs in {', '.join(differences)}; "
                f"finish it with 'tilepipe run {state / RECORD}', or start anew with --overwrite"
            )
        known.unlink()
    for item in state.iterdir():
        if item.is_dir():
            shutil.rmtree(item)
        elif item.name != LOCK:
            item.unlink()
    write_record(state / RECORD, record)
    write_record(known, identity)
    return True


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


def _plain(identity: Record) -> Record:
    """The identity as it reads back from its file."""
    import tomli_w

    def clean(value: Any) -> Any:
        return {k: clean(v) for k, v in value.items() if v is not None} if isinstance(value, Mapping) else value

    return tomllib.loads(tomli_w.dumps(clean(identity)))


def _differences(a: Record, b: Record, prefix: str = "") -> list[str]:
    """Dotted names of the entries in which two records differ."""
    names: list[str] = []
    for key in sorted(set(a) | set(b)):
        left, right = a.get(key), b.get(key)
        if isinstance(left, dict) and isinstance(right, dict):
            names += _differences(left, right, f"{prefix}{key}.")
        elif left != right:
            names.append(prefix + key)
    return names


def _lock(file: IO[str], folder: Path) -> None:
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{folder}: another process is at work in it; wait for it or name another folder") from None


def disk_error(error: OSError, folder: Path) -> InputError:
    """What to tell the user about a failure to write."""
    reason = error.strerror or str(error)
    return InputError(f"{error.filename or folder}: cannot be written ({reason}); free space or name another folder")


def status(folder: Path) -> dict[str, Any]:
    """What a run folder holds: ``state`` is ``finished``, ``unfinished`` or ``empty``, with the tiles done per pass.

    Raises
    ------
    InputError
        When the folder does not exist.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the --out folder of a run")
    state = folder / STATE
    if (state / RECORD).exists():
        record = read_record(state / RECORD)
        passes = {
            item.name: sum(1 for file in item.iterdir() if file.suffix == ".facts" and not file.name.startswith("."))
            for item in sorted(state.iterdir(), key=lambda item: item.stat().st_ctime_ns)
            if item.is_dir() and any(item.glob("*.facts"))
        }
        return {"state": "unfinished", "record": record, "passes": passes}
    if (folder / RECORD).exists():
        return {"state": "finished", "record": read_record(folder / RECORD), "passes": {}}
    return {"state": "empty", "record": {}, "passes": {}}
