"""Executors hand back every item once, with its result or its error, whatever happens to the workers."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

import pytest

from tilepipe.engine.tiles.executors import open_executor


def note(folder: Path, item: int) -> int:
    """Number of times that this item has been worked on, this time included."""
    with open(folder / str(item), "a") as file:
        file.write("x")
    return (folder / str(item)).stat().st_size


def noted(folder: Path) -> dict[int, int]:
    return {int(path.name): path.stat().st_size for path in folder.iterdir()}


def square(folder: Path, item: int) -> int:
    note(folder, item)
    if item == 3:
        raise RuntimeError("no luck here")
    return item * item


def slow(folder: Path, item: int) -> int:
    note(folder, item)
    time.sleep(0.3)
    return item


def kill_once(folder: Path, item: int) -> int:
    if note(folder, item) == 1 and item == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def kill(folder: Path, item: int) -> int:
    note(folder, item)
    if item == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


@contextmanager
def local_cluster(**settings):
    """Two worker processes under a scheduler with these settings."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    settings = {"distributed.deploy.lost-worker-timeout": "120s", **settings}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=":0", host="tcp://127.0.0.1") as cluster,
    ):
        yield cluster


@pytest.fixture(scope="module")
def cluster():
    with local_cluster() as cluster:
        yield cluster


@pytest.fixture(params=["serial", "threads", "processes", "cluster"])
def executor(request):
    kind, workers = {"serial": ("threads", 1)}.get(request.param, (request.param, 2))
    with open_executor(
        request.getfixturevalue("cluster").scheduler_address if kind == "cluster" else kind, workers
    ) as executor:
        yield executor


def test_an_item_that_fails_is_given_back_with_its_error(executor, tmp_path):
    outcomes = sorted(executor.run(partial(square, tmp_path), range(7)), key=lambda outcome: outcome[0])
    assert [result for _, result, _ in outcomes] == [0, 1, 4, None, 16, 25, 36]
    assert [str(error) for _, _, error in outcomes if error] == ["no luck here"]


def test_equal_items_are_computed_each_time(executor, tmp_path):
    for _ in range(2):
        assert [result for _, result, _ in executor.run(partial(square, tmp_path), [5, 5])] == [25, 25]
    assert noted(tmp_path) == {5: 4}


def test_an_abandoned_run_cancels_what_has_not_started(executor, tmp_path):
    outcomes = executor.run(partial(slow, tmp_path), range(40))
    next(outcomes)
    outcomes.close()
    time.sleep(2)
    assert len(noted(tmp_path)) <= 1 + 2 * executor.workers
    assert [result for _, result, _ in executor.run(partial(square, tmp_path), [1])] == [1]


@pytest.mark.parametrize("kind", ["threads", "processes", "cluster"])
def test_few_items_a_worker_are_handed_out_at_a_time(kind, request):
    """So memory does not grow with the number of tiles."""
    address = request.getfixturevalue("cluster").scheduler_address if kind == "cluster" else kind
    with open_executor(address, 2) as executor, handed_out(executor) as items:
        for taken, (item, result, error) in enumerate(executor.run(abs, range(-30, 0))):
            assert (result, error) == (-item, None)
            assert len(items) - taken <= 2 * executor.workers
    assert len(items) == 30


@contextmanager
def handed_out(executor):
    """Note what an executor gives to its pool, or to the pipes of its processes."""
    noted = []

    def noting(call):
        def noted_call(*arguments, **named):
            noted.append(arguments)
            return call(*arguments, **named)

        return noted_call

    pool = getattr(executor, "pool", None) or getattr(executor, "_pool", None)
    if pool is None:
        with patch.object(Connection, "send_bytes", noting(Connection.send_bytes)):
            yield noted
    else:
        with patch.object(pool, "submit", noting(pool.submit)):
            yield noted


def test_the_item_of_a_worker_that_died_is_computed_elsewhere(cluster, tmp_path):
    with open_executor(cluster.scheduler_address, 2) as executor:
        outcomes = sorted(executor.run(partial(kill_once, tmp_path), range(5)))
    assert outcomes == [(item, item, None) for item in range(5)]
    assert noted(tmp_path)[2] == 2


def end_early(cluster, folder, end):
    """Outcomes of twenty items, something being done to the cluster after the first."""
    with open_executor(cluster.scheduler_address, 2) as executor:
        outcomes = executor.run(partial(slow, folder), range(20))
        first = next(outcomes)
        end()
        return [first, *outcomes]


@pytest.mark.slow
def test_when_all_workers_are_lost_new_ones_go_on(cluster, tmp_path):
    def exchange():
        cluster.scale(0)
        while cluster.scheduler.workers:
            time.sleep(0.05)
        cluster.scale(2)

    assert sorted(end_early(cluster, tmp_path, exchange)) == [(item, item, None) for item in range(20)]


@pytest.mark.slow
def test_items_that_no_worker_survives_or_takes_fail(tmp_path):
    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.scheduler.no-workers-timeout": "1s"}
    with local_cluster(**settings) as cluster:
        with open_executor(cluster.scheduler_address, 2) as executor:
            errors = {item: error for item, _, error in executor.run(partial(kill, tmp_path), range(5))}
        others = end_early(cluster, tmp_path, lambda: cluster.scale(0))
    assert sorted(errors) == list(range(5)) and type(errors[2]).__name__ == "KilledWorker"
    assert sorted(item for item, _, _ in others) == list(range(20))
    assert "worker" in str(others[-1][2]).lower()


@pytest.mark.slow
def test_when_the_scheduler_is_lost_the_items_fail(tmp_path):
    with local_cluster() as cluster:
        outcomes = end_early(cluster, tmp_path, cluster.close)
    assert sorted(item for item, _, _ in outcomes) == list(range(20))
    assert str(outcomes[-1][2]) == "the connection to the scheduler is lost"
