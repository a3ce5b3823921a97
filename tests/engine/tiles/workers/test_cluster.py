"""A cluster whose workers stop, stall, have other code or another disk: named in a line, and no tile is lost."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from tests.engine.tiles.test_executors import note, noted, slow
from tilepipe.engine.tiles.executors import open_executor
from tilepipe.engine.tiles.workers.introduction import code_here, objection
from tilepipe.errors import InputError

pytestmark = pytest.mark.slow

dask = pytest.importorskip("dask")
pytest.importorskip("distributed")

NO_WORKERS = {"distributed.scheduler.no-workers-timeout": "3s"}
SILENCE = {"distributed.comm.timeouts.tcp": "12s", "distributed.scheduler.no-workers-timeout": "60s"}


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@contextmanager
def programs() -> Iterator[list[subprocess.Popen[bytes]]]:
    started: list[subprocess.Popen[bytes]] = []
    try:
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def start(programs: list[subprocess.Popen[bytes]], *arguments: object, path: str = "") -> subprocess.Popen[bytes]:
    environment = os.environ | ({"PYTHONPATH": path} if path else {})
    command = [sys.executable, "-m", "dask", *map(str, arguments)]
    quiet = subprocess.DEVNULL
    programs.append(subprocess.Popen(command, env=environment, cwd=path or None, stdout=quiet, stderr=quiet))
    return programs[-1]


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and its process and those of its workers."""
    with programs() as started:
        port = free_port()
        address = f"tcp://127.0.0.1:{port}"
        scheduler = start(started, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        while scheduler.poll() is None:
            with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                break
            time.sleep(0.1)
        for _ in range(workers):
            add_worker(started, address)
        yield address, started


def add_worker(started: list[subprocess.Popen[bytes]], address: str, path: str = "") -> subprocess.Popen[bytes]:
    alone = ("--no-nanny", "--nthreads", 1, "--no-dashboard", "--local-directory", os.environ.get("TMPDIR", "/tmp"))
    return start(started, "worker", address, *alone, path=path)


def refuse(address: str, message: str, folder: Path | None = None) -> None:
    with pytest.raises(InputError, match=message), open_executor(address, 1, folder):
        pass


def test_a_cluster_without_workers_is_refused():
    with cluster(0) as (address, _), dask.config.set(NO_WORKERS):
        begin = time.monotonic()
        refuse(address, rf"{address} has no workers: start some with 'dask worker {address}'$")
        assert time.monotonic() - begin < 60


def stop_one(folder: Path, item: int) -> int:
    """The first item stops its worker."""
    if item == 0 and note(folder, 0) == 1:
        os.kill(os.getpid(), signal.SIGSTOP)
    return item


def test_the_item_of_a_stopped_worker_is_computed_elsewhere(tmp_path):
    with cluster(2) as (address, _), open_executor(address, 1) as executor:
        while executor.workers < 2:
            list(executor.run(abs, [1]))
        outcomes = sorted(executor.run(partial(stop_one, tmp_path), range(9)))
    assert outcomes == [(item, item, None) for item in range(9)]
    assert noted(tmp_path) == {0: 2}


def test_a_scheduler_that_hangs_is_named(tmp_path):
    with cluster(1) as (address, started), dask.config.set(SILENCE), open_executor(address, 1) as executor:
        outcomes = executor.run(partial(slow, tmp_path), range(100))
        next(outcomes)
        started[0].send_signal(signal.SIGSTOP)
        rest = list(outcomes)
    assert len(rest) == 99
    assert str(rest[-1][2]) == f"the scheduler at {address} has not answered for 12 s"


def copy_with_another_line(folder: Path) -> str:
    """Sources that differ in a comment, as a path."""
    import shutil

    import tilepipe
    import tilepipe_kernels

    for package in (tilepipe, tilepipe_kernels):
        where = Path(str(package.__file__)).parent
        shutil.copytree(where, folder / where.name, ignore=shutil.ignore_patterns("__pycache__"))
    with open(folder / "tilepipe" / "errors.py", "a") as file:
        file.write("# another line\n")
    return str(folder)


def test_a_worker_of_other_sources_is_refused_by_name(tmp_path):
    with cluster(0) as (address, started):
        add_worker(started, address, path=copy_with_another_line(tmp_path))
        refuse(
            address, r"^worker tcp://127\.0\.0\.1:\d+ differs in sources of tilepipe \(.*, here [0-9a-f]+\): install"
        )


def test_a_worker_that_does_not_see_the_folder_is_refused_by_name(tmp_path, monkeypatch):
    (tmp_path / "state").mkdir()
    # the token that is asked for is not the one that the driver has written
    monkeypatch.setattr(Path, "touch", lambda path: None)
    with cluster(1) as (address, _):
        refuse(address, rf"^worker \S+ does not see {re.escape(str(tmp_path / 'state'))} of the", tmp_path / "state")


def test_what_differs_is_named():
    here = code_here()
    assert objection(here, here) == ""
    there = here | {"numpy": "1.0", "GDAL": "2.0"}
    assert objection(here, there) == f"differs in numpy (1.0, here {here['numpy']}), GDAL (2.0, here {here['GDAL']})"
    assert objection(here, {}).startswith(f"differs in tilepipe (missing, here {here['tilepipe']})")
