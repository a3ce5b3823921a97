"""Compiled code on disk, found again by the sources that it was compiled from.

numba keeps compiled code by the text of the one file that a function stands in, and would not notice a change of the
rules that it calls in other files.  Here its place is named by a fingerprint of all sources that it depends on
(`tilepipe_kernels.core.sources`), and by the versions and settings of what compiled it::

    ~/.cache/tilepipe/compiled/tilepipe_kernels.image.fill-5c1f0d8e6b2a4937/fill._spread-31.py311.0b9d….nbc

So a change recompiles what depends on it and nothing else, and checkouts or installations of the same sources share
what one of them has compiled.  The folder is that of ``NUMBA_CACHE_DIR``, else ``tilepipe/compiled`` in
``XDG_CACHE_HOME`` or ``~/.cache``; where it cannot be written, one for temporary files; where none can, all is compiled
anew by each process.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import stat
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numba
from numba.core.caching import FunctionCache, _Cache, _CacheLocator

from tilepipe_kernels.core.sources import fingerprint, has_rules

UNUSED_DAYS = 30
"""Days after which compiled code that no process has loaded is deleted."""

_NOWHERE = os.path.join(os.devnull, "no folder")
"""A folder in which nothing can be read or written."""

_DAY = 86400.0

_DIGEST = 32
"""Bytes of the checksum at the start of a file."""

_SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "USING_SVML")
"""Settings of numba that change what is compiled."""

_listeners: list[Callable[[], None]] = []


def listen(listener: Callable[[], None]) -> None:
    """Call `listener`, from now on, whenever something is to be compiled that is not on disk."""
    _listeners.append(listener)


@contextmanager
def listening(listener: Callable[[], None]) -> Iterator[None]:
    """`listen` for the length of a block."""
    listen(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def tell_compiling() -> None:
    """Tell all who listen that something is compiled: here, or in a process that works for this one."""
    for listener in tuple(_listeners):
        listener()


def keep_loop(loop: Any) -> None:
    """Keep on disk what numba compiles of a loop or rule, and look there before it is compiled.

    Nothing is read before it is first called, so that imports stay quick.
    """
    has_rules(loop.__module__)
    # numba hands a function back as it is where it is told to compile nothing
    if hasattr(loop, "py_func"):
        loop._cache = _OnFirstUse(loop.py_func)


def keep_grid(kernel: Any) -> None:
    """Keep on disk what numba-cuda compiles of a grid, and look there before it is compiled."""
    from numba.cuda.dispatcher import CUDACache

    has_rules(kernel.__module__)
    kernel._cache = _kept_by_sources(CUDACache)(kernel.py_func)


def is_kept() -> bool:
    """Whether there is a folder in which compiled code can be kept for other processes."""
    return _root() != _NOWHERE


class _OnFirstUse(_Cache):
    """The cache of a CPU loop, opened when it is first asked for something."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    @cached_property
    def opened(self) -> Any:
        return _kept_by_sources(FunctionCache)(self.function)

    @property
    def cache_path(self) -> str:
        return str(self.opened.cache_path)

    def load_overload(self, signature: Any, target: Any) -> Any:
        return self.opened.load_overload(signature, target)

    def save_overload(self, signature: Any, data: Any) -> None:
        self.opened.save_overload(signature, data)

    def enable(self) -> None:
        self.opened.enable()

    def disable(self) -> None:
        self.opened.disable()

    def flush(self) -> None:
        self.opened.flush()


@cache
def _kept_by_sources(kind: Any) -> Any:
    """A cache class of numba, with its place and its files exchanged for those of this module."""

    class Place(kind._impl_class):  # type: ignore[misc]
        _locator_classes = (_Locator,)

    class KeptBySources(kind):  # type: ignore[misc]
        _impl_class = Place

        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            stamp = self._impl.locator.get_source_stamp()
            self._cache_file: Any = _Files(self.cache_path, self._impl.filename_base, stamp, self._cache_file._dump)

        def load_overload(self, signature: Any, target: Any) -> Any:
            found = super().load_overload(signature, target)
            if found is None:
                tell_compiling()
            return found

    return KeptBySources


class _Locator(_CacheLocator):
    """Folder of the compiled code of the module that a function stands in."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file = file
        self._line = function.__code__.co_firstlineno
        self._folder = _folder(function.__module__, file)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> _Locator:
        return cls(function, file)

    def ensure_cache_path(self) -> None:
        """The folder is made when something is written."""

    def get_cache_path(self) -> str:
        return self._folder

    def get_source_stamp(self) -> str:
        return os.path.basename(self._folder)

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Files:
    """Compiled forms of one function: a file for each signature and processor.

    numba's own files have an index, and processes that compile different signatures at the same time may give them the
    same number in it: one would load the code of the other.
    """

    def __init__(self, folder: str, name: str, stamp: str, dump: Callable[[Any], bytes]) -> None:
        self._folder = folder
        self._name = name
        self._stamp = stamp
        self._dump = dump

    def load(self, key: Any) -> Any:
        """Code of a signature and processor; None where there is none."""
        # what is wrong with a damaged file is told by errors of any kind, and cured by writing it anew
        with suppress(Exception), open(self._path(key), "rb") as file:
            digest, content = file.read(_DIGEST), file.read()
            # code with a wrong bit would run all the same
            if digest == hashlib.sha256(content).digest():
                kept, data = pickle.loads(content)
                if kept == key:
                    return data
        return None

    def save(self, key: Any, data: Any) -> None:
        """Write a file whole or not at all; a full disk is no reason to fail, for the code is in memory."""
        path = self._path(key)
        aside = f"{path}.{uuid.uuid4().hex[:16]}"
        content = self._dump((key, data))
        with suppress(OSError):
            if not os.path.isdir(self._folder):
                _delete_unused(os.path.dirname(self._folder))
                os.makedirs(self._folder, exist_ok=True)
            try:
                with open(aside, "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                os.replace(aside, path)
            except OSError:
                os.unlink(aside)

    def flush(self) -> None:
        """Delete all."""
        with suppress(OSError):
            for name in os.listdir(self._folder):
                if name.startswith(f"{self._name}."):
                    os.unlink(os.path.join(self._folder, name))

    def _path(self, key: Any) -> str:
        digest = hashlib.sha256(f"{self._stamp} {key!r}".encode()).hexdigest()[:16]
        return os.path.join(self._folder, f"{self._name}.{digest}.nbc")


@cache
def _folder(module: str, file: str) -> str:
    """Folder of the compiled code of a module; `_NOWHERE` if its sources are not known."""
    sources = fingerprint(module, file)
    if sources is None:
        return _NOWHERE
    digest = hashlib.sha256(f"{_compiler()} {sources}".encode()).hexdigest()
    folder = os.path.join(_root(), f"{module}-{digest[:16]}")
    # in use: see _delete_unused
    with suppress(OSError):
        os.utime(folder)
    return folder


@cache
def _compiler() -> str:
    """What decides, beside the sources, what is compiled; numba's own key names the processor and the types only."""
    settings = [getattr(numba.config, name, None) for name in _SETTINGS]
    # numba-cuda, if it is there, takes the place of numba.cuda
    versions = [_version_of(name) for name in ("numba", "llvmlite", "numpy", "numba-cuda")]
    return f"{sys.implementation.cache_tag} {versions} {settings}"


def _version_of(distribution: str) -> str:
    """Version of an installed distribution; nothing if it is not installed."""
    with suppress(PackageNotFoundError):
        return version(distribution)
    return ""


@cache
def _root() -> str:
    """The first folder that can be written."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(home):
        home = os.path.expanduser(os.path.join("~", ".cache"))
    chosen = getattr(numba.config, "CACHE_DIR")  # noqa: B009
    kept = os.path.join(chosen, "tilepipe") if chosen else os.path.join(home, "tilepipe", "compiled")
    # a user of no name and no HOME has no home, and "~" is no folder
    if chosen or os.path.isabs(home):
        with suppress(OSError):
            os.makedirs(kept, exist_ok=True)
            tempfile.TemporaryFile(dir=kept).close()
            return kept
    with suppress(OSError):
        passing = os.path.join(tempfile.gettempdir(), f"tilepipe-compiled-{os.getuid()}")
        os.makedirs(passing, mode=0o700, exist_ok=True)
        state = os.lstat(passing)
        # others can make a folder of this name, and their code is not run
        if stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o022:
            return passing
    return _NOWHERE


def _delete_unused(root: str) -> None:
    """Delete what has not been loaded for long; a process that uses it all the same has it in memory."""
    with suppress(OSError), os.scandir(root) as folders:
        for folder in folders:
            if time.time() - folder.stat().st_mtime > UNUSED_DAYS * _DAY:
                shutil.rmtree(folder.path, ignore_errors=True)
