"""Who is at work in the folder of a run: one process at a time, on whatever machine that shares the folder.

A lock of the system decides among the processes of one machine; it ends with its process.  Whether it holds between
machines depends on the network file system.  So the holder also writes its name into a file, which only one can create,
and goes on writing there: who finds the name of another machine watches whether that still happens.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import socket
import threading
import time
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tilepipe.errors import InputError, OutputError
from tilepipe.io.files.durable import flush_folder

LOCK = "lock"
OWNER = "owner"

MARK = b"tilepipe: state of an unfinished run\n"
"""Content of the lock file, by which a state folder is known."""

_BEAT = 2.0
"""Seconds between two signs of life."""

_PATIENCE = 30.0
"""Seconds without a sign of life after which a process of another machine is taken for dead: many times a beat, for a
network file system may show a change late.  Should it live all the same, its state is gone and it cannot publish."""

_STALE = ".stale"


class RunLock:
    """Held while a process works in a folder; see `held`."""

    def __init__(self, state: Path) -> None:
        self.state = state
        self.owner = state / OWNER
        self.name = json.dumps(
            {"host": socket.gethostname(), "boot": _boot(), "pid": os.getpid(), "token": secrets.token_hex(16)}
        ).encode()
        self._ended = threading.Event()

    def still_held(self) -> bool:
        """Whether no other process has taken the folder over, in the belief that this one was dead."""
        with suppress(OSError):
            return self.owner.read_bytes().startswith(self.name)
        return False

    def require(self) -> None:
        """Go no further when another process has taken the folder over.

        Raises
        ------
        OutputError
            One has.
        """
        if not self.still_held():
            raise OutputError(f"{self.state.parent}: another process has taken it over; this run is not published")

    @contextmanager
    def signing(self, alone: bool) -> Iterator[None]:
        """Write the name and show signs of life; ``alone``: no other process of this machine holds the lock."""
        descriptor = self._claim(alone)
        beating = threading.Thread(target=self._beat, args=(descriptor,), daemon=True, name="sign of life")
        beating.start()
        try:
            yield
        finally:
            self._ended.set()
            beating.join()
            if self.still_held():
                self.owner.unlink(missing_ok=True)
            os.close(descriptor)

    def _claim(self, alone: bool) -> int:
        while True:
            try:
                descriptor = os.open(self.owner, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
            except FileExistsError:
                self._wait_for_death(alone)
                continue
            os.write(descriptor, self.name)
            os.fsync(descriptor)
            return descriptor

    def _wait_for_death(self, alone: bool) -> None:
        """Remove the name of a dead process.

        Raises
        ------
        InputError
            It lives.
        """
        with suppress(FileNotFoundError):
            known = self.owner.read_bytes()
            other = _read_name(known)
            if not (alone and other.get("boot") == _boot()):
                self._watch(known, other)
            aside = self.owner.with_name(f"{OWNER}.{secrets.token_hex(8)}{_STALE}")
            # of several that have waited one gets to do it
            os.rename(self.owner, aside)
            if aside.read_bytes() != known:
                os.rename(aside, self.owner)
                raise _at_work(self.state.parent, other)
            aside.unlink()

    def _watch(self, known: bytes, other: dict[str, Any]) -> None:
        told = f"process {other.get('pid')} of {other.get('host')} was at work in it"
        warnings.warn(f"{self.state.parent}: {told}; waiting {_PATIENCE:.0f} s for a sign of life", stacklevel=2)
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            time.sleep(_BEAT)
            if self.owner.read_bytes() != known:
                raise _at_work(self.state.parent, other)

    def _beat(self, descriptor: int) -> None:
        number = 0
        while not self._ended.wait(_BEAT):
            number += 1
            with suppress(OSError):
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, self.name + f"\n{number}".encode())
                os.fsync(descriptor)


@contextmanager
def held(folder: Path, state: Path) -> Iterator[RunLock]:
    """Hold the lock of a run's folder, whose state folder is made when missing.

    Raises
    ------
    InputError
        Another process is at work there.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.engine.run_lock import held
    >>> Path("run").mkdir()
    >>> with held(Path("run"), Path("run/.state")) as lock:
    ...     lock.still_held()
    ...     with held(Path("run"), Path("run/.state")):
    ...         pass
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: run: another process is at work in it; wait for it or name another folder
    """
    lock, alone = _open_lock(folder, state)
    try:
        if os.fstat(lock).st_size == 0:
            os.write(lock, MARK)
            os.fsync(lock)
            flush_folder(state)
            flush_folder(folder)
        found = RunLock(state)
        with found.signing(alone):
            yield found
    finally:
        os.close(lock)
        # a network file system keeps the names of open files
        with suppress(OSError):
            state.rmdir()


def is_marked(state: Path) -> bool:
    """Whether a state folder is one of tilepipe: it has its mark, or holds nothing.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.engine.run_lock import is_marked
    >>> Path(".state").mkdir()
    >>> is_marked(Path(".state"))
    True
    >>> _ = Path(".state/lock").write_text("for my bicycle")
    >>> is_marked(Path(".state"))
    False
    """
    lock = state / LOCK
    # a pipe would make its reader wait
    if any(path.is_symlink() or (path.exists() and not path.is_file()) for path in (lock, state / OWNER)):
        return False
    if lock.is_file() and lock.stat().st_size:
        with lock.open("rb") as file:
            return file.read(len(MARK) + 1) == MARK
    return all(item.name == LOCK for item in state.iterdir())


def _open_lock(folder: Path, state: Path) -> tuple[int, bool]:
    """Descriptor of the lock file, and whether the system says that nobody else of this machine holds it."""
    while True:
        state.mkdir(exist_ok=True)
        try:
            lock = os.open(state / LOCK, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except FileNotFoundError:
            continue
        try:
            alone = _lock(lock, folder, state)
            # who has just finished has removed the file between these two lines
            if _is_file_of(lock, state / LOCK):
                return lock, alone
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)


def _lock(lock: int, folder: Path, state: Path) -> bool:
    try:
        import fcntl
    except ImportError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        with suppress(OSError):
            raise _at_work(folder, _read_name((state / OWNER).read_bytes())) from None
        raise _at_work(folder, {}) from None
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF):
            return False
        raise
    return True


def _is_file_of(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _at_work(folder: Path, other: dict[str, Any]) -> InputError:
    elsewhere = f" (process {other.get('pid')} of {other['host']})" if other.get("boot", _boot()) != _boot() else ""
    return InputError(f"{folder}: another process is at work in it{elsewhere}; wait for it or name another folder")


def _read_name(content: bytes) -> dict[str, Any]:
    """Name of a process as it has written it; empty where a loss of power has left something else."""
    try:
        found = json.loads(content.splitlines()[0])
    except (ValueError, IndexError):
        return {}
    return found if isinstance(found, dict) else {}


def _boot() -> str:
    """The same for all processes that see the same locks of the system: those of one kernel since it was started."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return f"{socket.gethostname()} {uuid.getnode():x}"
