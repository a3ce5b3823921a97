"""What code asks of the disk, in order: the fsyncs, renames and removals on which it relies after a loss of power."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

Call = tuple[str, str]
"""``fsync``, ``put`` (a rename) or ``gone`` (a removal or a rename away), and the path below the folder watched."""


@contextmanager
def disk_calls(folder: Path) -> Iterator[list[Call]]:
    """Note the calls that concern paths below a folder, ``.`` being itself."""
    calls: list[Call] = []
    originals: dict[str, Callable[..., Any]] = {
        name: getattr(os, name) for name in ("fsync", "replace", "rename", "unlink", "remove", "rmdir")
    }

    def note(kind: str, path: Any, directory: int | None = None) -> None:
        base = os.path.realpath(f"/proc/self/fd/{directory}") if directory is not None else ""
        full = os.path.abspath(os.path.join(base, os.fspath(path)))
        if full == str(folder) or full.startswith(f"{folder}{os.sep}"):
            calls.append((kind, os.path.relpath(full, folder)))

    def fsync(descriptor: int) -> None:
        note("fsync", os.path.realpath(f"/proc/self/fd/{descriptor}"))

    def moved(name: str) -> Callable[..., None]:
        def call(source: Any, target: Any) -> None:
            originals[name](source, target)
            note("gone", source)
            note("put", target)

        return call

    def removed(name: str) -> Callable[..., None]:
        def call(path: Any, *, dir_fd: int | None = None) -> None:
            originals[name](path, dir_fd=dir_fd)
            note("gone", path, dir_fd)

        return call

    with ExitStack() as patches:
        patches.enter_context(patch.object(os, "fsync", fsync))
        for name in ("replace", "rename"):
            patches.enter_context(patch.object(os, name, moved(name)))
        for name in ("unlink", "remove", "rmdir"):
            patches.enter_context(patch.object(os, name, removed(name)))
        yield calls
