"""What a cluster says of its workers, told by a client that is none, decides which of them can have tiles, and when."""

from __future__ import annotations

import asyncio
import time
import warnings
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from tilepipe.engine.tiles.workers import cluster_view
from tilepipe.engine.tiles.workers.cluster_view import LOOK, ClusterView
from tilepipe.engine.tiles.workers.introduction import code_here

SILENCE, WITHOUT = 20.0, 60.0
LITTLE = 0.5
"""Seconds beside a limit, within which a test surely ends."""


class Cluster:
    """Workers by address, their introductions, and a clock that is set ahead."""

    def __init__(self) -> None:
        self.workers: dict[str, dict[str, Any]] = {}
        self.answers: dict[str, Any] = {}
        self.processing: dict[str, list[str]] = {}
        self.status, self.ahead, self.hangs = "running", 0.0, False
        self.scheduler = self

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead

    def add(self, address: str, answer: Any = None) -> None:
        self.workers[address] = {"status": "running", "nthreads": 2, "last_seen": 1.0}
        self.answers[address] = answer or (code_here(), "")

    def hear(self) -> None:
        for worker in self.workers.values():
            worker["last_seen"] += 1

    async def identity(self) -> dict[str, Any]:
        return {"workers": self.workers}


class View(ClusterView):
    """Asks without a loop of its own."""

    def _begin(self, coroutine: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(asyncio.run(coroutine))
        except BaseException as error:
            if not isinstance(error, asyncio.InvalidStateError):
                future.set_exception(error)
        return future

    async def _ask(self) -> Any:
        if self._client.hangs:
            raise asyncio.InvalidStateError
        return await self._client.identity(), self._client.processing

    async def _introduce(self, address: str) -> dict[str, Any]:
        if self._client.answers[address] == "none yet":
            raise asyncio.InvalidStateError
        return {address: self._client.answers[address]}


@pytest.fixture
def cluster(monkeypatch):
    found = Cluster()
    monkeypatch.setattr(cluster_view, "time", SimpleNamespace(monotonic=found.monotonic))
    return found


def view_of(cluster: Cluster) -> View:
    view = View(cluster, "tcp://here", None, SILENCE, WITHOUT)
    view.look()
    return view


def told(view: View) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        view.look()
    return [str(each.message) for each in found]


def test_workers_that_have_introduced_themselves_can_have_tiles(cluster):
    cluster.add("a")
    cluster.add("b", "none yet")
    cluster.workers["a"]["nthreads"] = 0
    cluster.processing = {"b": ["tile"]}
    view = view_of(cluster)
    assert view.able == {"a": 1}
    assert view.undecided and view.refused == []
    assert view.holder("tile") == "b" and view.holder("other") == ""
    assert view.is_there("b")
    del cluster.workers["b"]
    view.look()
    assert not view.is_there("b") and not view.undecided


def test_a_worker_that_is_silent_for_half_the_time_gets_nothing_until_it_is_heard(cluster):
    cluster.add("a")
    view = view_of(cluster)
    cluster.ahead = SILENCE / 2 - LITTLE
    assert told(view) == [] and view.able
    cluster.ahead = SILENCE / 2 + LITTLE
    assert told(view) == ["worker a has not been heard of for 10 s; its tiles go to others"] and not view.able
    assert told(view) == []
    cluster.hear()
    assert told(view) == [] and view.able


def test_a_worker_has_twice_the_time_to_introduce_itself(cluster):
    cluster.add("a", "none yet")
    view = view_of(cluster)
    for cluster.ahead in (SILENCE, 2 * SILENCE - LITTLE):
        cluster.hear()
        assert told(view) == [] and view.undecided
    cluster.ahead = 2 * SILENCE + LITTLE
    cluster.hear()
    assert told(view) == ["worker a has not said within 40 s which code it has; its tiles go to others"]
    assert not view.undecided and not view.able


@pytest.mark.parametrize(
    ("status", "why"),
    [("paused", "is paused, for its memory is nearly full"), ("init", "is init"), ("closing", ""), ("closed", "")],
)
def test_what_a_worker_is_doing_decides(cluster, status, why):
    cluster.add("a")
    view = view_of(cluster)
    cluster.workers["a"]["status"] = status
    assert told(view) == ([f"worker a {why}; its tiles go to others"] if why else [])
    assert not view.able


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (ImportError("tilepipe"), "has no tilepipe like the one here (tilepipe)"),
        (OSError("no disk"), "cannot introduce itself (OSError: no disk)"),
        ((code_here(), "does not see the folder"), "does not see the folder"),
    ],
)
def test_a_worker_that_may_not_work_is_refused_by_name(cluster, answer, why):
    cluster.add("a", answer)
    view = view_of(cluster)
    assert view.refused == [f"worker a {why}"] and not view.able and not view.undecided


def test_a_run_waits_for_workers_and_says_so_once(cluster):
    view = view_of(cluster)
    none = "the cluster at tcp://here has no workers: start some with 'dask worker tcp://here'"
    cluster.ahead = 2 * LOOK - LITTLE
    with warnings.catch_warnings(action="error"):
        assert view.lost() == ""
    cluster.ahead = 2 * LOOK + LITTLE
    view.look()
    with pytest.warns(UserWarning, match=f"{none}; waiting for 60 s"):
        assert view.lost() == ""
    with warnings.catch_warnings(action="error"):
        for cluster.ahead in range(10, 60, 10):
            view.look()
            assert view.lost() == ""
    cluster.ahead = WITHOUT + LITTLE
    view.look()
    assert view.lost() == none
    cluster.add("a")
    view.look()
    assert view.lost() == ""


def test_no_more_than_three_workers_are_named(cluster):
    for number in range(3):
        cluster.add(str(number), OSError("no disk"))
    assert view_of(cluster).why_none().endswith("worker 2 cannot introduce itself (OSError: no disk)")
    cluster.add("3", OSError("no disk"))
    assert view_of(cluster).why_none().endswith("worker 2 cannot introduce itself (OSError: no disk) and 1 more")


def test_a_scheduler_that_does_not_answer_is_given_up(cluster):
    cluster.add("a")
    view = view_of(cluster)
    cluster.hangs = True
    cluster.ahead = SILENCE - LITTLE
    view.look()
    assert view.lost() == ""
    cluster.ahead = SILENCE + LITTLE
    view.look()
    assert view.lost() == "the scheduler at tcp://here has not answered for 20 s"
    cluster.status = "closed"
    assert view.lost() == "the connection to the scheduler is lost"
