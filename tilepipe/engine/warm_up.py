"""Kernels compiled by two processes the first time: within one process numba compiles one function after the other."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

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

    def begin() -> None:
        with lock:
            if not begun:
                command = [sys.executable, "-P", "-c", f"from {module} import {function}; {function}()"]
                quiet = subprocess.DEVNULL
                begun.append(subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet))

    try:
        with listening(begin):
            yield
    finally:
        for process in begun:
            # what it has finished lies on disk
            process.terminate()
            process.wait()
