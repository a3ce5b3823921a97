"""Worker processes on this machine, of which each has one item at a time: so it is known what a lost one had."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from threading import Lock
from types import TracebackType
from typing import Any, Generic

from tilepipe.engine.tiles.allocator import keep_freed_memory
from tilepipe.engine.tiles.workers.attempts import LIVES, Attempt, Item, Outcome, Result, name_of
from tilepipe.engine.tiles.workers.parent import ChildStarter, end_with_parent
from tilepipe.errors import WorkerError
from tilepipe_kernels.core.cache import listen, tell_compiling

_CONTEXT = multiprocessing.get_context("spawn")

_READY, _COMPILING = b"ready", b"compiling"
"""What a worker says beside its outcomes."""

_LAST_WORDS = 10.0
"""Seconds that a process may take from closing its pipe to its end, to write a core file, say."""


@dataclass
class _Worker(Generic[Item]):
    """A process, the pipe to it, and what it works on."""

    process: Any
    pipe: Connection
    ready: bool = False
    attempt: Attempt[Item] | None = None

    def end(self, patience: float = 0) -> str:
        """End it, unless it does so itself within some seconds; in words, how it ended."""
        self.process.join(patience)
        # what it writes appears whole or not at all
        self.process.kill()
        self.process.join()
        self.pipe.close()
        return _manner(self.process.exitcode)


@dataclass
class ProcessExecutor(Generic[Item]):
    """Runs in processes that are started when they are first needed, and replaced when they are lost.

    An item whose worker is lost is computed again, after all others; when it has cost `LIVES` workers it fails.
    """

    workers: int
    _starter: ChildStarter = field(default_factory=ChildStarter)
    _crew: list[_Worker[Any]] = field(default_factory=list)

    def __enter__(self) -> ProcessExecutor[Item]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._dismiss(self._crew)
        self._starter.__exit__(kind, error, trace)

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """See `tilepipe.engine.tiles.executors.Executor.run`; an abandoned iterator ends the workers at work."""
        waiting = deque(Attempt(item) for item in items)
        failed_starts: list[str] = []
        try:
            while waiting or any(worker.attempt for worker in self._crew):
                yield from self._hand_out(function, waiting)
                talking = {worker.pipe: worker for worker in self._crew if worker.attempt or not worker.ready}
                for pipe in wait(list(talking)) if talking else ():
                    worker = talking[pipe]  # type: ignore[index]
                    try:
                        said = worker.pipe.recv_bytes()
                    except (EOFError, OSError):
                        if worker.attempt is None:
                            failed_starts.append(self._lost(worker))
                        else:
                            yield from self._begin_again(worker, waiting)
                        continue
                    if said == _READY:
                        worker.ready = True
                        failed_starts.clear()
                    elif said == _COMPILING:
                        tell_compiling()
                    elif worker.attempt is not None:
                        item, worker.attempt = worker.attempt.item, None
                        yield (item, *_read(said))
                if len(failed_starts) >= LIVES:
                    reason = f"worker processes end as they start: the last {failed_starts[-1]}"
                    while waiting:
                        yield waiting.popleft().item, None, WorkerError(reason)
        finally:
            self._dismiss([worker for worker in self._crew if worker.attempt])

    def _hand_out(
        self, function: Callable[[Item], Result], waiting: deque[Attempt[Item]]
    ) -> Iterator[Outcome[Item, Result]]:
        """Give items to workers that have none, and start workers for the others."""
        for worker in [worker for worker in self._crew if worker.ready and not worker.attempt]:
            while waiting and not worker.attempt:
                attempt = waiting.popleft()
                try:
                    order = pickle.dumps((function, attempt.item))
                except Exception as error:
                    yield attempt.item, None, error
                    continue
                worker.attempt = attempt
                try:
                    worker.pipe.send_bytes(order)
                except OSError:
                    # it ended while it had nothing to do
                    worker.attempt = None
                    self._lost(worker)
                    waiting.appendleft(attempt)
                    break
        starting = sum(1 for worker in self._crew if not worker.ready)
        for _ in range(min(len(waiting) - starting, self.workers - len(self._crew))):
            self._crew.append(self._starter.start(_start_worker))

    def _begin_again(self, worker: _Worker[Item], waiting: deque[Attempt[Item]]) -> Iterator[Outcome[Item, Result]]:
        """The item of a lost worker goes behind all others, or fails when it has cost too many."""
        attempt = worker.attempt
        assert attempt is not None
        manner = self._lost(worker)
        attempt.lost.append(manner)
        if len(attempt.lost) < LIVES:
            warnings.warn(
                f"worker process {worker.process.pid} {manner} at {name_of(attempt.item)}, which is computed again",
                stacklevel=2,
            )
            waiting.append(attempt)
        else:
            reason = f"{LIVES} worker processes were lost at it, the last {manner}"
            yield attempt.item, None, WorkerError(f"{reason}; fewer workers or smaller tiles need less memory")

    def _lost(self, worker: _Worker[Any]) -> str:
        self._crew.remove(worker)
        return worker.end(_LAST_WORDS)

    def _dismiss(self, workers: Sequence[_Worker[Any]]) -> None:
        for worker in list(workers):
            worker.end()
            self._crew.remove(worker)


def _manner(code: int) -> str:
    """How a process ended, by its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    why = " (as the system does when memory runs out)" if name == "SIGKILL" else ""
    return f"was ended by {name}{why}"


def _read(said: bytes) -> tuple[Any, BaseException | None]:
    """Result and error that a worker has sent."""
    try:
        result, error = pickle.loads(said)
    except Exception as failure:
        # an error whose class cannot be made again from what was pickled
        return None, failure
    return result, error


def _start_worker() -> _Worker[Any]:
    ours, theirs = _CONTEXT.Pipe()
    process = _CONTEXT.Process(target=_serve, args=(theirs,), name="tile worker", daemon=True)
    process.start()
    # open in the worker alone, so that its end is the end of the pipe
    theirs.close()
    return _Worker(process, ours)


def _serve(pipe: Connection) -> None:
    """A worker's life: items in, outcomes out, until the pipe is closed."""
    driver = multiprocessing.parent_process()
    assert driver is not None and driver.pid is not None
    end_with_parent(driver.pid, driver.sentinel)
    # a lock that a library makes here is then none with a name in the system, which would outlive the end by a kill
    if "fork" in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("fork", force=True)
    speaking = Lock()

    def say(what: bytes) -> None:
        with speaking, suppress(OSError):
            pipe.send_bytes(what)

    keep_freed_memory()
    listen(lambda: say(_COMPILING))
    say(_READY)
    with suppress(EOFError, OSError):
        while True:
            say(_outcome(pipe.recv_bytes()))


def _outcome(order: bytes) -> bytes:
    """Carry out an order; the pickled result and error."""
    try:
        function, item = pickle.loads(order)
        return pickle.dumps((function(item), None))
    except BaseException as error:
        error.add_note("".join(traceback.format_exception(error)))
        with suppress(Exception):
            return pickle.dumps((None, error))
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
