"""Where tiles are computed: threads, processes, or the workers of a dask.distributed cluster.

An executor takes a function and items and yields ``(item, result, error)`` in the order of completion.  At most a few
items per worker are in flight, so that memory does not grow with the number of tiles.
"""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from tilepipe.engine.tiles.workers.attempts import Item, Outcome, Result
from tilepipe.engine.tiles.workers.cluster import open_cluster
from tilepipe.engine.tiles.workers.processes import ProcessExecutor
from tilepipe.errors import InputError


class Executor(Protocol):
    """What a pass needs of an executor."""

    @property
    def workers(self) -> int:
        """Number of items that are worked on at a time."""
        ...

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """Yield ``(item, result, error)`` for every item, in the order of completion."""
        ...


class SerialExecutor:
    """Runs in the caller's thread, one item after the other: for one worker and for debugging.

    Examples
    --------
    A failure is an outcome like any other: the other items are finished.

    >>> from tilepipe.engine.tiles.executors import SerialExecutor
    >>> for item, result, error in SerialExecutor().run(lambda tile: 12 // tile, [3, 0, 4]):
    ...     print(item, result, type(error).__name__)
    3 4 NoneType
    0 None ZeroDivisionError
    4 3 NoneType
    """

    workers = 1

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """See `Executor.run`."""
        for item in items:
            try:
                yield item, function(item), None
            except Exception as error:
                yield item, None, error


class ThreadExecutor:
    """Runs in threads of this process."""

    def __init__(self, pool: concurrent.futures.Executor, workers: int) -> None:
        self.pool = pool
        self.workers = workers

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """See `Executor.run`; an abandoned iterator cancels what has not started."""
        waiting = iter(items)
        running: dict[concurrent.futures.Future[Result], Item] = {}
        try:
            while True:
                while len(running) < 2 * self.workers and (item := next(waiting, None)) is not None:
                    running[self.pool.submit(function, item)] = item
                if not running:
                    return
                done, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    item, failure = running.pop(future), future.exception()
                    yield item, None if failure else future.result(), failure
        finally:
            for future in running:
                future.cancel()


@contextmanager
def open_executor(kind: str, workers: int, folder: Path | None = None) -> Iterator[Executor]:
    """Open the executor named on the command line and close it at the end.

    Parameters
    ----------
    kind
        ``threads``, ``processes``, or the address of a dask.distributed scheduler (``tcp://host:8786``).
    workers
        Number of threads or processes; a cluster brings its own number.
    folder
        Folder that the workers of a cluster must share with this machine; None = none.

    Raises
    ------
    InputError
        When ``kind`` is none of these, the scheduler cannot be reached, or its workers cannot work.

    Examples
    --------
    >>> from tilepipe.engine.tiles.executors import open_executor
    >>> with open_executor("threads", workers=2) as executor:
    ...     sorted(result for _, result, _ in executor.run(abs, [-1, -2, -3]))
    [1, 2, 3]
    """
    if kind == "threads" and workers == 1:
        yield SerialExecutor()
    elif kind == "threads":
        pool = concurrent.futures.ThreadPoolExecutor(workers, thread_name_prefix="tile")
        try:
            yield ThreadExecutor(pool, workers)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    elif kind == "processes":
        with ProcessExecutor[Any](workers) as processes:
            yield processes
    elif "://" in kind:
        with open_cluster(kind, folder) as cluster:
            yield cluster
    else:
        raise InputError(f"executor '{kind}' is unknown: use threads, processes or the address tcp://host:port")
