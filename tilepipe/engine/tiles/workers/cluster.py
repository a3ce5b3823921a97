"""Tiles on the workers of a dask.distributed cluster, whatever happens to workers and scheduler.

A tile is computed again elsewhere when its worker is lost, hangs, is paused, or fails, and the first result counts:
tiles may be computed twice, for they write the same bytes, whole.
"""

from __future__ import annotations

import concurrent.futures
import logging
import os
import pickle
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Generic

from tilepipe.engine.tiles.workers.attempts import LIVES, Attempt, Item, Outcome, Result, name_of
from tilepipe.engine.tiles.workers.cluster_view import LOOK, ClusterView
from tilepipe.errors import InputError, WorkerError

_STRAGGLES = 3.0
"""Times the median duration after which an item is given to an idle worker as well: backup tasks of Dean & Ghemawat
2004, "MapReduce", section 3.6; the multiplier is that of Apache Spark 4 (spark.speculation.multiplier)."""

_Answer = tuple[str, float, Any, BaseException | None]
"""Worker, seconds, result and error of an item."""


@dataclass
class _Task(Generic[Item]):
    """An item at a worker."""

    attempt: Attempt[Item]
    key: str
    among: list[str]
    since: float = field(default_factory=time.monotonic)


class ClusterExecutor:
    """Runs on the workers of a cluster that can work."""

    def __init__(self, pool: concurrent.futures.Executor, view: ClusterView) -> None:
        self._pool = pool
        self._view = view

    @property
    def workers(self) -> int:
        """Threads of the workers that can work."""
        return max(1, sum(self._view.able.values()))

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """See `tilepipe.engine.tiles.executors.Executor.run`; an abandoned iterator cancels what has not started."""
        flow: _Flow[Item, Result] = _Flow(partial(_compute, function), items, self._pool, self._view)
        try:
            while flow.unfinished:
                self._view.look()
                if reason := self._view.lost():
                    yield from flow.give_up(reason)
                    return
                flow.hand_out()
                yield from flow.take_in()
        finally:
            flow.cancel()


class _Flow(Generic[Item, Result]):
    """The items of one pass on their way."""

    def __init__(
        self,
        compute: Callable[[Item], _Answer],
        items: Sequence[Item],
        pool: concurrent.futures.Executor,
        view: ClusterView,
    ) -> None:
        self._compute = compute
        self._pool = pool
        self._view = view
        self._waiting = deque(Attempt(item) for item in items)
        self._tasks: dict[concurrent.futures.Future[_Answer], _Task[Item]] = {}
        self._seconds: list[float] = []
        self._failed_at: dict[int, str] = {}
        self._given_up: deque[Attempt[Item]] = deque()

    @property
    def unfinished(self) -> bool:
        return bool(self._waiting or self._tasks or self._given_up)

    def cancel(self) -> None:
        for future in self._tasks:
            future.cancel()

    def give_up(self, reason: str) -> Iterator[Outcome[Item, Result]]:
        """All that is unfinished fails for one reason."""
        under_way = (task.attempt for task in self._tasks.values())
        attempts = {id(attempt): attempt for attempt in (*under_way, *self._waiting, *self._given_up)}
        self.cancel()
        for unfinished in (self._tasks, self._waiting, self._given_up):
            unfinished.clear()
        for attempt in attempts.values():
            yield attempt.item, None, WorkerError(reason)

    def hand_out(self) -> None:
        """Give out items: those that wait, those that are stuck, and at the end those that straggle."""
        able = self._view.able
        if not able:
            return
        room = sum(able.values())
        moving = sum(1 for task in self._tasks.values() if not self._is_stuck(task, able))
        # an item that has cost a worker waits for a free one, so that it takes no other with it
        while self._waiting and moving < (1 if self._waiting[0].lost else 2) * room:
            self._submit(self._waiting.popleft(), able)
            moving += 1
        attempts: dict[int, list[_Task[Item]]] = {}
        for task in self._tasks.values():
            attempts.setdefault(id(task.attempt), []).append(task)
        for tasks in attempts.values():
            if not any(self._view.is_there(address) for task in tasks for address in task.among):
                self._begin_again(tasks)
                continue
            straggles = not self._waiting and moving < room and len(tasks) == 1 and self._straggles(tasks[0])
            if straggles or all(self._is_stuck(task, able) for task in tasks):
                elsewhere = {address: able[address] for address in able if address not in self._holders(tasks)}
                if elsewhere:
                    self._submit(tasks[0].attempt, elsewhere)
                    moving += 1

    def _begin_again(self, tasks: list[_Task[Item]]) -> None:
        """An item all of whose workers are gone waits behind all others, or fails when this has come too often."""
        attempt = tasks[0].attempt
        self._forget(attempt)
        attempt.lost.append(", ".join(tasks[-1].among[:3]))
        (self._waiting if len(attempt.lost) < LIVES else self._given_up).append(attempt)

    def take_in(self) -> Iterator[Outcome[Item, Result]]:
        """Outcomes of what has ended within a look."""
        while self._given_up:
            attempt = self._given_up.popleft()
            reason = f"all workers that could have had it were lost {LIVES} times, the last {attempt.lost[-1]}"
            yield attempt.item, None, WorkerError(f"{reason}; it may need more memory than they have")
        if not self._tasks:
            time.sleep(LOOK / 10)
            return
        done, _ = concurrent.futures.wait(self._tasks, LOOK, concurrent.futures.FIRST_COMPLETED)
        for future in done:
            if future not in self._tasks:
                continue
            # nobody here cancels a future that is waited for: a client does when it has lost its scheduler
            if future.cancelled():
                yield from self.give_up("the connection to the scheduler is lost")
                return
            task = self._tasks.pop(future)
            failure = future.exception()
            if failure is None:
                worker, seconds, result, failure = future.result()
                if failure is not None and self._is_tried_elsewhere(task.attempt, worker, failure):
                    continue
                if failure is None:
                    self._seconds.append(seconds)
            else:
                result = None
            self._forget(task.attempt)
            yield task.attempt.item, result, failure

    def _submit(self, attempt: Attempt[Item], able: dict[str, int]) -> None:
        others = [address for address in able if address != self._failed_at.get(id(attempt))]
        key = f"{name_of(attempt.item).replace(' ', '-')}-{uuid.uuid4().hex}"
        among = others or list(able)
        future = self._pool.submit(self._compute, attempt.item, key=key, workers=among)  # type: ignore[call-arg]
        self._tasks[future] = _Task(attempt, key, among)

    def _is_stuck(self, task: _Task[Item], able: dict[str, int]) -> bool:
        """Whether a task is where it cannot be worked on, and the scheduler will not move it."""
        holder = self._view.holder(task.key)
        return (holder not in able) if holder else not any(address in able for address in task.among)

    def _straggles(self, task: _Task[Item]) -> bool:
        return bool(self._seconds) and time.monotonic() - task.since > LOOK + _STRAGGLES * median(self._seconds)

    def _holders(self, tasks: list[_Task[Item]]) -> set[str]:
        return {self._view.holder(task.key) for task in tasks}

    def _is_tried_elsewhere(self, attempt: Attempt[Item], worker: str, failure: BaseException) -> bool:
        """Whether an item that has failed goes to another worker, for the fault may be the worker's; once."""
        if isinstance(failure, InputError) or id(attempt) in self._failed_at or not set(self._view.able) - {worker}:
            return False
        self._failed_at[id(attempt)] = worker
        self._waiting.append(attempt)
        return True

    def _forget(self, attempt: Attempt[Item]) -> None:
        """Call back what else of an item is under way: the first result counts."""
        for future in [future for future, task in self._tasks.items() if task.attempt is attempt]:
            del self._tasks[future]
            future.cancel()
        with suppress(ValueError):
            self._waiting.remove(attempt)


def _compute(function: Callable[[Item], Result], item: Item) -> _Answer:
    """Compute an item; runs on a worker."""
    from distributed import get_worker

    begin = time.monotonic()
    address = str(get_worker().address)
    try:
        result = function(item)
        return address, time.monotonic() - begin, result, None
    except Exception as error:
        failure: Exception = error
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            failure = RuntimeError(f"{type(error).__name__}: {error}")
        return address, time.monotonic() - begin, None, failure


@contextmanager
def open_cluster(address: str, folder: Path | None) -> Iterator[ClusterExecutor]:
    """Connect to a cluster, once workers are there and it is certain that they can work.

    Parameters
    ----------
    address
        Of the scheduler.
    folder
        Folder that the workers must share with this machine; None = none.

    Raises
    ------
    InputError
        When no scheduler answers, no worker comes, or a worker has other code or does not see the folder.
    """
    import dask
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    silence = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.tcp"))
    without = dask.utils.parse_timedelta(dask.config.get("distributed.scheduler.no-workers-timeout") or silence)
    with _quiet():
        try:
            with warnings.catch_warnings():
                # workers are asked below, and told by name
                warnings.simplefilter("ignore", VersionMismatchWarning)
                client = Client(address, timeout="10s")
        except (OSError, ValueError, TypeError, ImportError, RuntimeError) as error:
            raise InputError(f"no dask scheduler answers at {address}: start one or check the address") from error
        view = None
        try:
            view = ClusterView(client, address, folder, silence, without)
            _await_workers(view)
            # equal arguments may stand for files that have changed: nothing is taken from the cluster's memory
            yield ClusterExecutor(client.get_executor(pure=False), view)
        finally:
            if view:
                view.close()
            with suppress(Exception):
                client.close(timeout=LOOK)


def _await_workers(view: ClusterView) -> None:
    """Return when workers can work and all have introduced themselves, or have had the time for it."""
    while view.undecided or not view.able or view.refused:
        view.look()
        if view.refused and not view.undecided:
            raise InputError(f"{'; '.join(view.refused[:3])}: install the same there, and start the worker anew")
        if reason := view.lost():
            raise InputError(reason)
        time.sleep(LOOK / 20)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what distributed logs off the terminal: what concerns the run is told in a line of its own."""
    if os.environ.get("TILEPIPE_DEBUG"):
        yield
        return
    loggers = [
        logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado", "tornado.application")
    ]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
