"""Kernels compiled by two processes the first time: within one process numba compiles one function after the other."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from tilepipe.engine.tiles.workers.parent import ChildStarter, end_with_parent
from tilepipe_kernels.core.cache import listening


@contextmanager
def compiled_beside(warm_up: str) -> Iterator[None]:
    """Compile beside a block what it will want last, if it turns out to compile anything at all.

    Parameters
    ----------
    warm_up
        ``module:function`` that calls the kernels which the block calls last; empty = nothing is done.
    """
    if not warm_up or (os.cpu_count() or 1) < 2:
        yield
        return
    begun: list[subprocess.Popen[bytes]] = []
    lock = threading.Lock()
    module, _, function = warm_up.partition(":")
    call = f"from {module} import {function}; {function}()"
    with ChildStarter() as children, _lifeline() as lifeline:

        def begin() -> None:
            with lock:
                if not begun:
                    begun.append(children.start(partial(_start, call, lifeline)))

        try:
            with listening(begin):
                yield
        finally:
            for process in begun:
                # what it has finished lies on disk
                process.terminate()
                process.wait()


@contextmanager
def _lifeline() -> Iterator[int]:
    """Reading end of a pipe that ends with this process."""
    reading, writing = os.pipe()
    try:
        yield reading
    finally:
        os.close(writing)
        os.close(reading)


def _start(call: str, lifeline: int) -> subprocess.Popen[bytes]:
    first = f"from {end_with_parent.__module__} import end_with_parent; end_with_parent({os.getpid()}, 0)"
    quiet = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-P", "-c", f"{first}; {call}"], stdin=lifeline, stdout=quiet, stderr=quiet
    )
