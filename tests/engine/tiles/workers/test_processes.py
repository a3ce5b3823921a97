"""Worker processes: what a lost one had is computed again, and none outlives the process that it works for."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.engine.tiles.test_executors import note, noted
from tilepipe.engine.tiles.executors import open_executor
from tilepipe.errors import WorkerError

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="signals of POSIX")


def end(folder: Path, item: int) -> int:
    """Worker processes end at item 2 the first time, and at item 3 each time."""
    times = note(folder, item)
    if item == 2 and times == 1:
        os.kill(os.getpid(), signal.SIGTERM)
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


@pytest.mark.slow
def test_the_item_of_a_lost_process_is_computed_again_and_no_other(monkeypatch, tmp_path):
    monkeypatch.setattr("tilepipe.engine.tiles.workers.processes.LIVES", 2)
    with open_executor("processes", 2) as executor:
        with pytest.warns(UserWarning, match="worker process") as told:
            results = list(executor.run(partial(end, tmp_path), range(6)))
        assert list(executor.run(abs, [-3])) == [(-3, 3, None)]
    outcomes = {item: (result, error) for item, result, error in results}
    _, error = outcomes.pop(3)
    assert isinstance(error, WorkerError)
    assert str(error).startswith("2 worker processes were lost at it, the last was ended by SIGKILL")
    assert outcomes == {item: (item, None) for item in (0, 1, 2, 4, 5)}
    assert noted(tmp_path) == {0: 1, 1: 1, 2: 2, 3: 2, 4: 1, 5: 1}
    said = sorted(re.sub(r"\d+", "N", str(warning.message), count=1) for warning in told)
    assert said[1] == "worker process N was ended by SIGTERM at item 2, which is computed again"
    assert len(said) == 2 and "SIGKILL" in said[0] and "item 3" in said[0]


def named_lock(item: int) -> str:
    """Name in the system of a lock that a library might make, which would be left when its process is killed."""
    lock: Any = multiprocessing.Lock()
    return lock._semlock.name or ""


def test_no_lock_outlives_a_worker():
    with open_executor("processes", 1) as executor:
        assert list(executor.run(named_lock, [1])) == [(1, "", None)]


def refuse(item: int) -> object:
    class LocalError(Exception):
        pass

    if item == 1:
        raise LocalError("not known elsewhere")
    return (lambda: item) if item == 2 else item


def test_what_cannot_be_sent_is_an_error_of_its_item():
    with open_executor("processes", 1) as executor:
        outcomes = {item: (result, error) for item, result, error in executor.run(refuse, range(4))}
        unsent = list(executor.run(lambda item: item, [5]))
    assert outcomes[0] == (0, None) and outcomes[3] == (3, None)
    assert "not known elsewhere" in str(outcomes[1][1]) and outcomes[2][1] is not None
    assert [item for item, _, error in unsent if error] == [5]


SCRIPT = """
import os, sys, time
from tilepipe.engine.tiles.executors import open_executor

def work(item):
    print(os.getpid(), flush=True)
    time.sleep(600)

if {guard}:
    with open_executor("processes", 2) as executor:
        for item, result, error in executor.run(work, [1, 2]):
            print(error, flush=True)
"""


def script(folder: Path, guard: str) -> subprocess.Popen[str]:
    path = folder / "driver.py"
    path.write_text(SCRIPT.format(guard=guard))
    return subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("stopped", [pytest.param(False, marks=pytest.mark.slow), True])
def test_processes_end_with_their_driver_and_close_its_pipes(stopped, tmp_path):
    driver = script(tmp_path, "__name__ == '__main__'")
    assert driver.stdout is not None
    workers = [int(driver.stdout.readline()) for _ in range(2)]
    if stopped:
        os.kill(workers[0], signal.SIGSTOP)
    driver.send_signal(signal.SIGKILL)
    driver.communicate(timeout=10)
    deadline = time.monotonic() + 10
    while any(alive(worker) for worker in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [worker for worker in workers if alive(worker)]


@pytest.mark.slow
def test_processes_that_cannot_start_fail_the_items(tmp_path):
    driver = script(tmp_path, "True")
    output, _ = driver.communicate(timeout=60)
    assert output.splitlines() == ["worker processes end as they start: the last ended with exit code 1"] * 2


LIFELINE = """
import os, sys, time
from tilepipe.engine.tiles.workers import parent
if sys.argv[1] == "pipe alone":
    parent.sys = type("System", (), {"platform": "elsewhere"})
if sys.argv[1] == "kernel alone":
    parent._await_end = lambda lifeline: None
parent.end_with_parent(os.getppid(), 0)
print("ready", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("means", ["pipe alone", "kernel alone"])
def test_each_means_alone_ends_a_child(means):
    if means == "kernel alone" and sys.platform != "linux":
        pytest.skip("needs Linux")
    child = [sys.executable, "-c", LIFELINE, means]
    start = f"import subprocess; subprocess.run({child!r}, stdin=subprocess.PIPE)"
    if means == "pipe alone":
        start = f"import subprocess; subprocess.Popen({child!r}, stdin=subprocess.PIPE).wait()"
    parent = subprocess.Popen([sys.executable, "-c", start], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None and parent.stdout.readline() == "ready\n"
    parent.kill()
    assert parent.communicate(timeout=10) == ("", None)
