"""The file layer of the simulator: each call by which Python changes the disk is a point of the run."""

from __future__ import annotations

import builtins
import io
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from tests.faults.points import Points

_CALLS = ("mkdir", "rmdir", "unlink", "remove", "rename", "replace", "link", "symlink", "truncate")
"""Functions of `os` that change a folder."""


class _Written:
    """A file open for writing, of which each write is a point."""

    def __init__(self, file: Any, points: Points) -> None:
        self._file = file
        self._points = points

    def write(self, data: Any) -> Any:
        if self._points.dead:
            return len(data)
        if self._points.arrives("write"):
            if self._points.fault.kind.startswith("torn"):
                self._file.write(data[: len(data) // 2])
                self._file.flush()
            self._points.strike("write")
        return self._file.write(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _Written:
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._file)


@contextmanager
def watched_files(points: Points) -> Iterator[None]:
    """Let all changes of files below the root of the points pass through them."""
    open_file, sync = io.open, os.fsync

    def opened(file: Any, mode: str = "r", *arguments: Any, **named: Any) -> Any:
        if not (set(mode) & set("wax+") and _is_below(points.root, file, None)):
            return open_file(file, mode, *arguments, **named)
        points.reach("open")
        return _Written(open_file(file, mode, *arguments, **named), points)

    def synced(file: Any) -> None:
        descriptor = file if isinstance(file, int) else file.fileno()
        if not _is_below(points.root, f"/proc/self/fd/{descriptor}", None):
            sync(descriptor)
            return
        points.reach("fsync")
        # the disk that is simulated needs no real one
        points.synced(descriptor)

    with ExitStack() as patches:
        for module in (io, builtins):
            patches.enter_context(patch.object(module, "open", opened))
        patches.enter_context(patch.object(os, "fsync", synced))
        for name in _CALLS:
            patches.enter_context(patch.object(os, name, _call(getattr(os, name), name, points)))
        yield


def _call(function: Callable[..., Any], name: str, points: Points) -> Callable[..., Any]:
    """A function of `os`, as a point where it concerns the run."""

    def called(path: Any, *arguments: Any, **named: Any) -> Any:
        target = arguments[0] if name in ("rename", "replace", "link", "symlink") else path
        folder = named.get("dst_dir_fd", named.get("dir_fd"))
        if _is_below(points.root, target, folder):
            points.reach(name)
        return function(path, *arguments, **named)

    return called


def _is_below(root: str, path: Any, folder: int | None) -> bool:
    """Whether a path, perhaps relative to an open folder, lies below the root."""
    if isinstance(path, int):
        path = f"/proc/self/fd/{path}"
    path = os.fspath(path)
    if not isinstance(path, str):
        return False
    if folder is not None:
        path = os.path.join(os.path.realpath(f"/proc/self/fd/{folder}"), path)
    return os.path.realpath(path).startswith(root + os.sep)
