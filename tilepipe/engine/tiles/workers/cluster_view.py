"""What is known of a cluster while a run is on it: which workers can have tiles, and what is wrong with the others.

Scheduler and workers are asked again and again, and never waited for: any of them may hang.
"""

from __future__ import annotations

import asyncio
import time
import uuid
import warnings
from collections.abc import Coroutine
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tilepipe.engine.tiles.workers.introduction import code_here, introduce, objection

LOOK = 1.0
"""Seconds between two looks at a cluster; a worker sends a sign of life twice as often."""


@dataclass
class _Worker:
    """What is known of one worker."""

    introduction: Future[dict[str, Any]] | None = None
    refused: str = ""
    admitted: bool = False
    status: str = ""
    threads: int = 1
    seen: float = 0.0
    heard: float = field(default_factory=time.monotonic)
    met: float = field(default_factory=time.monotonic)
    trouble: str = ""


class ClusterView:
    """A cluster as the driver sees it.

    Parameters
    ----------
    client
        Connected `distributed.Client`.
    address
        Of the scheduler.
    folder
        Folder that workers must share with this machine; None = none.
    silence
        Seconds without an answer after which the scheduler is given up; a worker gets no tiles after half of it.
    without
        Seconds that a run waits while no worker can work.
    """

    def __init__(self, client: Any, address: str, folder: Path | None, silence: float, without: float) -> None:
        self.address = address
        self._silence = silence
        self._without = without
        self._client = client
        self._folder = folder
        self._token = f".{uuid.uuid4().hex}.token"
        self._workers: dict[str, _Worker] = {}
        self._holders: dict[str, str] = {}
        self._asked: Future[Any] | None = None
        self._answered = self._last_able = time.monotonic()
        self._told_of_none = self._looked = False
        if folder is not None:
            (folder / self._token).touch()

    def close(self) -> None:
        """Leave nothing in the folder."""
        if self._folder is not None:
            (self._folder / self._token).unlink(missing_ok=True)

    @property
    def able(self) -> dict[str, int]:
        """Threads of each worker that can have tiles."""
        return {
            address: worker.threads
            for address, worker in self._workers.items()
            if worker.admitted and not worker.trouble
        }

    @property
    def undecided(self) -> bool:
        """Whether some worker that can be waited for has not introduced itself yet."""
        return not self._looked or any(worker.introduction and not worker.trouble for worker in self._workers.values())

    @property
    def refused(self) -> list[str]:
        """What is wrong with workers that may not work."""
        return [f"worker {address} {worker.refused}" for address, worker in self._workers.items() if worker.refused]

    def holder(self, key: str) -> str:
        """Worker that a task has been sent to, by the last look; empty when none has it."""
        return self._holders.get(key, "")

    def is_there(self, address: str) -> bool:
        """Whether a worker is still one of the cluster's."""
        return address in self._workers

    def look(self) -> None:
        """Take in what has been answered, and ask anew; at most once in `LOOK` seconds."""
        if self._client.status != "running":
            return
        if self._asked is None:
            self._asked = self._begin(self._ask())
        if not self._asked.done():
            return
        if self._asked.exception() is None:
            identity, processing = self._asked.result()
            self._answered, self._looked = time.monotonic(), True
            self._take_in(identity["workers"])
            self._holders = {key: address for address, keys in processing.items() for key in keys}
        self._asked = None

    def lost(self) -> str:
        """Why the cluster is given up; empty while there is hope."""
        now = time.monotonic()
        if self._client.status not in ("running", "connecting"):
            return "the connection to the scheduler is lost"
        if now - self._answered > self._silence:
            return f"the scheduler at {self.address} has not answered for {self._silence:.0f} s"
        if self.able or self.undecided:
            self._last_able = now
            self._told_of_none = False
        elif now - self._last_able > self._without:
            return self.why_none()
        elif now - self._last_able > 2 * LOOK and not self._told_of_none:
            self._told_of_none = True
            warnings.warn(f"{self.why_none()}; waiting for {self._without:.0f} s", stacklevel=2)
        return ""

    def why_none(self) -> str:
        """Why no worker can have tiles."""
        if not self._workers:
            return f"the cluster at {self.address} has no workers: start some with 'dask worker {self.address}'"
        told = [
            f"worker {address} {worker.refused or worker.trouble or 'has just come'}"
            for address, worker in self._workers.items()
        ]
        more = f" and {len(told) - 3} more" if len(told) > 3 else ""
        return f"no worker of the cluster at {self.address} can work: {', '.join(told[:3])}{more}"

    async def _ask(self) -> tuple[Any, Any]:
        if self._looked:
            await asyncio.sleep(LOOK)
        return await self._client.scheduler.identity(), await self._client.scheduler.processing()

    def _begin(self, coroutine: Coroutine[Any, Any, Any]) -> Future[Any]:
        return asyncio.run_coroutine_threadsafe(coroutine, self._client.loop.asyncio_loop)

    def _take_in(self, workers: dict[str, Any]) -> None:
        now = time.monotonic()
        for address in set(self._workers) - set(workers):
            del self._workers[address]
        for address, told in workers.items():
            worker = self._workers.get(address)
            if worker is None:
                worker = self._workers[address] = _Worker(self._begin(self._introduce(address)))
            worker.status, worker.threads = told["status"], max(1, told["nthreads"])
            # clocks of other machines may be wrong, so only the change counts
            if told["last_seen"] != worker.seen:
                worker.seen, worker.heard = told["last_seen"], now
            self._admit(address, worker)
            self._tell(address, worker, now)

    async def _introduce(self, address: str) -> dict[str, Any]:
        folder = str(self._folder) if self._folder else ""
        told = self._client.run(introduce, folder, self._token, workers=[address], on_error="return")
        return dict(await told)

    def _admit(self, address: str, worker: _Worker) -> None:
        """Read the introduction of a worker, once it is there."""
        if worker.introduction is None or not worker.introduction.done():
            return
        failure = worker.introduction.exception()
        answer = failure or worker.introduction.result().get(address)
        worker.introduction = None
        if isinstance(answer, ImportError):
            worker.refused = f"has no tilepipe like the one here ({answer})"
        elif isinstance(answer, BaseException) or answer is None:
            worker.refused = f"cannot introduce itself ({type(answer).__name__}: {answer})"
        else:
            code, wrong = answer
            worker.refused = objection(code_here(), code) or wrong
        worker.admitted = not worker.refused

    def _tell(self, address: str, worker: _Worker, now: float) -> None:
        """Note what keeps a worker from working, and tell it when it is new."""
        before, worker.trouble = worker.trouble, ""
        if now - worker.heard > self._silence / 2:
            worker.trouble = f"has not been heard of for {self._silence / 2:.0f} s"
        elif worker.introduction and now - worker.met > 2 * self._silence:
            worker.trouble = f"has not said within {2 * self._silence:.0f} s which code it has"
        elif worker.status == "paused":
            worker.trouble = "is paused, for its memory is nearly full"
        elif worker.status != "running":
            worker.trouble = f"is {worker.status}"
        # of those that leave in an orderly way the scheduler tells soon
        if worker.trouble and worker.trouble != before and not worker.trouble.startswith("is clos"):
            warnings.warn(f"worker {address} {worker.trouble}; its tiles go to others", stacklevel=2)
