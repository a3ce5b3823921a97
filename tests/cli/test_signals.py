"""Signals that ask for the end: one line, the exit code of an interruption, and a run that can be resumed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.scenes import SMALL, band, draw, write_raster
from tilepipe.cli.signals import interruptible
from tilepipe.io.files.record import STATE

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")

SHAPE = (90, 110)
RESUME = "tilepipe: interrupted; run the same command again to resume\n"


def program(out: Path, *arguments: object, before: str = "pass") -> subprocess.Popen[str]:
    """A run that is at work on its tiles, long enough for a signal to find it there."""
    scene = write_raster(out.parent / "scene.tif", draw(SHAPE, band(SHAPE, (-5, 40), (95, 70), 7)))
    settings = [
        part for name, value in (SMALL | {"diffusion_steps": 600}).items() for part in ("--set", f"{name}={value}")
    ]
    command = ["streets", scene, "--out", out, "--tile", 9, "--workers", 2, *settings, "--quiet", *arguments]
    # whoever runs the tests in the background, or under nohup, has told their processes to ignore interruptions
    default = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    default += "; signal.signal(signal.SIGHUP, signal.SIG_DFL)"
    start = f"{default}; {before}; import sys; sys.argv[0] = 'tilepipe'; from tilepipe.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", start, *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while not any(out.glob(f"{STATE}/*/levels")) and process.poll() is None:
        time.sleep(0.02)
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_run_ends_with_one_line_and_can_be_resumed(number, tmp_path):
    process = program(tmp_path / "run")
    process.send_signal(number)
    assert process.communicate(timeout=60) == ("", RESUME)
    assert process.returncode == 130
    assert (tmp_path / "run" / STATE / "identity.toml").exists()


@pytest.mark.slow
def test_a_run_of_processes_ends_with_one_line_though_the_signal_reaches_all(tmp_path):
    process = program(tmp_path / "run", "--executor", "processes", before="import os; os.setsid()")
    while not any((tmp_path / "run" / STATE).glob("*/levels/*.facts")) and process.poll() is None:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=60) == ("", RESUME)
    assert process.returncode == 130


def test_an_ignored_signal_stays_ignored(tmp_path):
    process = program(tmp_path / "run", before="signal.signal(signal.SIGHUP, signal.SIG_IGN)")
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=60) == ("", RESUME)


def test_the_second_signal_ends_at_once():
    stubborn = """if True:
        import time
        from tilepipe.cli.signals import interruptible
        with interruptible():
            try:
                print("ready", flush=True)
                while True:
                    time.sleep(0.1)
            except KeyboardInterrupt:
                print("waiting", flush=True)
                while True:
                    time.sleep(0.1)
    """
    process = subprocess.Popen([sys.executable, "-c", stubborn], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in ("ready\n", "waiting\n"):
        assert process.stdout.readline() == line
        process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=10) == -signal.SIGTERM


def test_handlers_are_given_back_and_those_of_others_left():
    before = signal.signal(signal.SIGHUP, lambda *_: None)
    try:
        theirs = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
        with interruptible():
            assert signal.getsignal(signal.SIGTERM) != theirs[1] and signal.getsignal(signal.SIGHUP) == theirs[2]
        assert theirs == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    finally:
        signal.signal(signal.SIGHUP, before)


def test_other_threads_leave_signals_alone():
    seen: list[object] = []

    def elsewhere() -> None:
        with interruptible():
            seen.append(signal.getsignal(signal.SIGTERM))

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [before]
