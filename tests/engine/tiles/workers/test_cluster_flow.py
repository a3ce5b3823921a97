"""Items on their way through a cluster that is none: who gets them, who gets them again, and how often."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from tilepipe.engine.tiles.workers import cluster
from tilepipe.engine.tiles.workers.attempts import LIVES
from tilepipe.engine.tiles.workers.cluster import ClusterExecutor
from tilepipe.errors import InputError


class View:
    """Workers and what is known of the tasks they hold; `turn` happens at each look."""

    def __init__(self, **threads: int) -> None:
        self.able = dict(threads)
        self.holders: dict[str, str] = {}
        self.gone: set[str] = set()
        self.reason = ""
        self.looks = 0
        self.turn: Callable[[int], None] = lambda looks: None

    def look(self) -> None:
        self.looks += 1
        assert self.looks < 100, "the run does not end"
        self.turn(self.looks)

    def lost(self) -> str:
        return self.reason

    def holder(self, key: str) -> str:
        return self.holders.get(key, "")

    def is_there(self, address: str) -> bool:
        return address not in self.gone


class Pool:
    """Gives each item the answer of a function, or none yet; the first of the workers that may have it holds it."""

    def __init__(self, view: View, answer: Callable[[int, str], Any]) -> None:
        self.view, self.answer = view, answer
        self.given: list[tuple[int, list[str]]] = []
        self.futures: list[Future[Any]] = []

    def submit(self, compute: object, item: int, *, key: str, workers: list[str]) -> Future[Any]:
        self.given.append((item, list(workers)))
        self.view.holders[key] = workers[0]
        future: Future[Any] = Future()
        answer = self.answer(item, workers[0])
        if isinstance(answer, BaseException):
            future.set_result((workers[0], 1.0, None, answer))
        elif answer is not None:
            future.set_result((workers[0], 1.0, answer, None))
        self.futures.append(future)
        return future


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(cluster, "LOOK", 0.001)


def run(pool: Pool, count: int) -> list[tuple[int, Any, str]]:
    executor = ClusterExecutor(pool, pool.view)  # type: ignore[arg-type]
    return sorted((item, result, str(error or "")) for item, result, error in executor.run(abs, range(count)))


def test_each_thread_has_an_item_and_one_that_waits():
    view = View(a=1, b=2)
    pool = Pool(view, lambda item, worker: None)
    under_way: list[int] = []

    def turn(looks: int) -> None:
        under_way.append(sum(not future.done() for future in pool.futures))
        for item, future in enumerate(pool.futures):
            if looks > 2 and not future.done():
                future.set_result(("a", 1.0, item, None))

    view.turn = turn
    assert run(pool, 13) == [(item, item, "") for item in range(13)]
    assert max(under_way) == 2 * 3
    assert len(pool.given) == 13


@pytest.mark.parametrize(("workers", "times"), [(("a",), 1), (("a", "b"), 2)])
def test_an_item_that_fails_is_tried_elsewhere_once(workers, times):
    pool = Pool(View(**dict.fromkeys(workers, 1)), lambda item, worker: ValueError(f"at {worker}"))
    [(_, result, error)] = run(pool, 1)
    assert result is None and error == f"at {workers[-1]}"
    assert len(pool.given) == times
    if times == 2:
        assert pool.given[1] == (0, ["b"])


def test_wrong_input_is_wrong_everywhere():
    pool = Pool(View(a=1, b=1), lambda item, worker: InputError("no raster"))
    assert run(pool, 1) == [(0, None, "no raster")]
    assert len(pool.given) == 1


def test_the_fault_of_a_worker_costs_no_item():
    pool = Pool(View(a=1, b=1), lambda item, worker: OSError("no disk") if worker == "a" else item)
    assert run(pool, 6) == [(item, item, "") for item in range(6)]


def test_an_item_that_costs_worker_after_worker_fails_in_the_end():
    view = View(a=1)
    pool = Pool(view, lambda item, worker: None)

    def turn(looks: int) -> None:
        view.gone |= set(view.able)
        view.able = {f"w{looks}": 1}

    view.turn = turn
    [(_, _, error)] = run(pool, 1)
    assert error.startswith(f"all workers that could have had it were lost {LIVES} times, the last w")
    assert error.endswith("; it may need more memory than they have")
    assert len(pool.given) == LIVES


def test_an_item_that_is_stuck_goes_to_another_worker():
    view = View(a=1)
    pool = Pool(view, lambda item, worker: item if worker == "b" else None)

    def turn(looks: int) -> None:
        # a is paused, then b comes
        view.able = {} if looks == 2 else {"b": 1} if looks > 2 else {"a": 1}

    view.turn = turn
    assert run(pool, 1) == [(0, 0, "")]
    assert [workers for _, workers in pool.given] == [["a"], ["b"]]
    assert pool.futures[0].cancelled()


@pytest.mark.parametrize(("ahead", "again"), [(0, False), (2.9, False), (3.1, True)])
def test_what_takes_three_times_the_usual_is_begun_elsewhere_as_well(monkeypatch, ahead, again):
    view = View(a=1, b=1)
    pool = Pool(view, lambda item, worker: item if item == 0 or len(pool.given) > 2 else None)
    begin = time.monotonic()
    moments = [begin]
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: moments[-1], sleep=time.sleep))

    def turn(looks: int) -> None:
        if looks == 4:
            moments.append(time.monotonic() + ahead)
        if looks == 8 and not pool.futures[1].done():
            pool.futures[1].set_result(("b", 1.0, 1, None))

    view.turn = turn
    assert run(pool, 2) == [(0, 0, ""), (1, 1, "")]
    assert (len(pool.given) == 3) == again


def test_when_the_cluster_is_given_up_every_item_fails_for_that_reason():
    view = View(a=1)
    pool = Pool(view, lambda item, worker: item if item < 2 else None)

    def turn(looks: int) -> None:
        view.reason = "the connection is lost" if looks > 2 else ""

    view.turn = turn
    found = run(pool, 5)
    assert found[:2] == [(0, 0, ""), (1, 1, "")]
    assert found[2:] == [(item, None, "the connection is lost") for item in (2, 3, 4)]
    assert all(future.done() for future in pool.futures)


def test_what_a_client_cancels_has_lost_its_scheduler():
    view = View(a=1)
    pool = Pool(view, lambda item, worker: None)

    def turn(looks: int) -> None:
        for future in pool.futures:
            future.cancel()
            future.set_running_or_notify_cancel()

    view.turn = turn
    found = run(pool, 3)
    assert found == [(item, None, "the connection to the scheduler is lost") for item in range(3)]


def test_an_abandoned_run_cancels_what_has_not_ended():
    view = View(a=2)
    pool = Pool(view, lambda item, worker: item if item == 0 else None)
    executor = ClusterExecutor(pool, view)  # type: ignore[arg-type]
    assert executor.workers == 2
    running = executor.run(abs, range(4))
    assert next(running) == (0, 0, None)
    running.close()
    assert [future.cancelled() for future in pool.futures] == [False, True, True, True]
