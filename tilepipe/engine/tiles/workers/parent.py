"""Child processes that end with this one, whatever it dies of, and hold none of its pipes open."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import resource_tracker
from types import TracebackType
from typing import TypeVar

Result = TypeVar("Result")

_PR_SET_PDEATHSIG = 1
"""Option of prctl(2)."""


class ChildStarter:
    """Starts child processes in a thread that lives as long as the block.

    Linux tells a child that its parent has died when the *thread* that started it ends, so it must be one that stays.
    A Ctrl-C on the terminal, which reaches all processes there, is blocked in that thread and so in the children: it is
    for this process to end them.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="starter")

    def start(self, function: Callable[[], Result]) -> Result:
        """Call a function that starts a process."""
        return self._thread.submit(_without_interrupts, function).result()

    def __enter__(self) -> ChildStarter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)


def _without_interrupts(function: Callable[[], Result]) -> Result:
    if hasattr(signal, "pthread_sigmask"):
        # multiprocessing unblocks interrupts when it starts its tracker, so that has to come first
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    return function()


def end_with_parent(parent: int, lifeline: int) -> None:
    """End this process as soon as its parent has died; called by a child as it begins.

    Parameters
    ----------
    parent
        Process id of the parent.
    lifeline
        Reading end of a pipe whose writing end only the parent has: its end of file is the parent's death, on every
        system.  Where the kernel can, it is asked to kill this process too, for it does so at once, even if this
        process is stopped or deep in a library.
    """
    threading.Thread(target=_await_end, args=(lifeline,), name="lifeline", daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        # the parent may have died before the kernel was asked
        if os.getppid() != parent:
            os._exit(1)


def _await_end(lifeline: int) -> None:
    while os.read(lifeline, 1):
        pass
    os._exit(1)
