"""The workers of a dask.distributed cluster."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from tilepipe.engine.tiles.workers.attempts import Item, Outcome, Result
from tilepipe.errors import InputError


class ClusterExecutor:
    """Runs on the workers of a cluster."""

    def __init__(self, pool: concurrent.futures.Executor, workers: int) -> None:
        self.pool = pool
        self.workers = workers

    def run(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Outcome[Item, Result]]:
        """See `Executor.run`; an abandoned iterator cancels what has not started."""
        waiting = iter(items)
        running: dict[concurrent.futures.Future[Result], Item] = {}
        broken: BaseException | None = None
        try:
            while True:
                while len(running) < 2 * self.workers and (item := next(waiting, None)) is not None:
                    try:
                        if broken is not None:
                            raise broken
                        running[self.pool.submit(function, item)] = item
                    except concurrent.futures.BrokenExecutor as error:
                        broken = error
                        yield item, None, error
                if not running:
                    return
                done, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    item = running.pop(future)
                    # nobody here cancels a future that is waited for: a client does when it has lost its scheduler
                    if future.cancelled():
                        broken = concurrent.futures.BrokenExecutor("the connection to the scheduler is lost")
                        yield item, None, broken
                    else:
                        failure = future.exception()
                        yield item, None if failure else future.result(), failure
        finally:
            for future in running:
                future.cancel()


@contextmanager
def open_cluster(address: str) -> Iterator[ClusterExecutor]:
    """Connect to a cluster."""
    from distributed import Client

    try:
        client = Client(address, timeout="10s")
    except OSError as error:
        raise InputError(f"no dask scheduler answers at {address}: start one or check the address") from error
    with client:
        # equal arguments may stand for files that have changed: nothing is taken from the cluster's memory
        yield ClusterExecutor(client.get_executor(pure=False), max(1, sum(client.nthreads().values())))
