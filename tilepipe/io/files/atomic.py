"""Atomic writes: a file is written beside its final name and renamed when it is whole.

What is written aside has a name that nobody else gives, and is locked while its writer lives: so the next write into
the same folder can clear what a killed one has left, and nothing else.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tilepipe.errors import InputError, OutputError
from tilepipe.io.files.durable import flush_folder, flush_to_disk
from tilepipe.io.files.paths import local_output, side_file

_REMEDY = {
    errno.ENOSPC: "the disk is full; free some space or choose another folder",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another folder",
    errno.EACCES: "no permission to write there; choose another folder or change its permissions",
    errno.EPERM: "no permission to write there; choose another folder or change its permissions",
    errno.EROFS: "the disk is read-only; choose another folder",
    errno.ENOENT: "the folder does not exist; create it first",
    errno.ENOTDIR: "its parent is a file, not a folder; choose another folder",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.EFBIG: "files there may not grow so large; choose another folder or raise the limit (ulimit -f)",
    errno.EIO: "the disk fails; check it, or choose another folder",
    errno.EMFILE: "too many files are open; raise the limit (ulimit -n)",
    errno.ENFILE: "too many files are open on this machine; close some programs",
}

_ASIDE = re.compile(r"\.tilepipe-[0-9a-f]{16}\.partial")
"""Names of the folders in which files are written."""


@contextmanager
def atomic_write(final: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a path to write to; rename it to `final` when the block ends well, remove it when it does not.

    The path has the name of `final` (drivers look at the suffix) in a hidden folder beside it, which also takes
    journals and other side files; what GDAL reads beside a raster goes with it. What killed writers left in that
    place is cleared.

    Parameters
    ----------
    final
        Path of the finished file. An existing file is replaced in one step.

    Raises
    ------
    OutputError
        The folder is missing or unwritable, the disk is full, or `final` is no file; the message names the file and the
        remedy.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.atomic import atomic_write
    >>> with atomic_write("notes.txt") as path:
    ...     _ = path.write_text("whole")
    ...     Path("notes.txt").exists()
    False
    >>> Path("notes.txt").read_text()
    'whole'
    """
    final = local_output(final)
    folder, lock = final.parent, None
    try:
        check_replaceable(final)
        clear_leftovers(final.parent)
        folder, lock = _make_aside(final.parent)
        yield folder / final.name
        replace_file(folder / final.name, final)
    except InputError:
        raise
    except Exception as error:
        remedy = _remedy(error, folder)
        if remedy is None:
            raise
        raise OutputError(f"cannot write {final}: {remedy}") from error
    finally:
        if folder != final.parent:
            _remove(folder)
        if lock is not None:
            os.close(lock)


def _remove(folder: Path) -> None:
    """Remove a folder; an interruption waits until it is gone."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def replace_file(written: Path, final: Path) -> None:
    """Put a finished file in the place of another, and what GDAL reads beside it (`.aux.xml`) with it.

    A file is replaced in one step.  Where something lies beside one of the two, the old file goes first: at no time
    does a file stand beside what belongs to another, which might be its CRS.

    Parameters
    ----------
    written
        The finished file, on the same disk.
    final
        Where it goes.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.atomic import replace_file
    >>> for name in ("new.tif", "old.tif", "old.tif.aux.xml"):
    ...     Path(name).touch()
    >>> replace_file(Path("new.tif"), Path("old.tif"))
    >>> [path.name for path in Path(".").iterdir()]
    ['old.tif']
    """
    beside, stale = side_file(written), side_file(final)
    flush_to_disk(written)
    if beside.exists():
        flush_to_disk(beside)
    if beside.exists() or stale.exists():
        final.unlink(missing_ok=True)
        stale.unlink(missing_ok=True)
    if beside.exists():
        os.replace(beside, stale)
    os.replace(written, final)
    flush_folder(final.parent)


def check_replaceable(final: Path) -> None:
    """Refuse a name under which there is something other than a file.

    Raises
    ------
    OutputError
        It is a folder, a device, a pipe or a socket.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.atomic import check_replaceable
    >>> check_replaceable(Path("/dev/null"))
    Traceback (most recent call last):
        ...
    tilepipe.errors.OutputError: cannot write /dev/null: it is no file but a folder or device; choose another name
    """
    with suppress(OSError):
        if not stat.S_ISREG(final.stat().st_mode):
            raise OutputError(f"cannot write {final}: it is no file but a folder or device; choose another name")


def is_aside(name: str) -> bool:
    """Whether a name is that of a folder in which `atomic_write` writes.

    Examples
    --------
    >>> from tilepipe.io.files.atomic import is_aside
    >>> is_aside(".tilepipe-0123456789abcdef.partial"), is_aside(".streets.tif.partial")
    (True, False)
    """
    return _ASIDE.fullmatch(name) is not None


def clear_leftovers(folder: Path) -> None:
    """Remove what killed writers have left in a folder; what a living one holds stays, and so does all else.

    Where the file system cannot tell whether a writer lives, nothing is removed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.atomic import clear_leftovers
    >>> for name in (".tilepipe-0123456789abcdef.partial", ".streets.tif.partial"):
    ...     Path(name).mkdir()
    >>> clear_leftovers(Path())
    >>> [path.name for path in Path().iterdir()]
    ['.streets.tif.partial']
    """
    # a folder that cannot be listed may still be written to
    with suppress(OSError):
        for item in folder.iterdir():
            if is_aside(item.name) and not item.is_symlink() and item.is_dir():
                with suppress(BlockingIOError):
                    lock = _locked(item)
                    if lock is not None:
                        shutil.rmtree(item, ignore_errors=True)
                        os.close(lock)


def _make_aside(parent: Path) -> tuple[Path, int | None]:
    """A new folder for a file, and its lock where the file system has locks."""
    while True:
        folder = parent / f".tilepipe-{secrets.token_hex(8)}.partial"
        folder.mkdir()
        # another writer may take it for a leftover before it is locked: it removes it, or is about to
        with suppress(BlockingIOError):
            lock = _locked(folder)
            if folder.is_dir():
                return folder, lock
            if lock is not None:
                os.close(lock)


def _locked(folder: Path) -> int | None:
    """The descriptor that holds the lock of a folder; None where it is gone or there are no locks.

    Raises
    ------
    BlockingIOError
        Another writer holds it.
    """
    try:
        import fcntl

        lock = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        if isinstance(error, BlockingIOError):
            raise
        return None
    return lock


def _remedy(error: Exception, folder: Path) -> str | None:
    """Say what the user can do about a failed write into `folder`; None when that is not the cause."""
    if isinstance(error, OSError) and error.errno in _REMEDY:
        other = isinstance(error.filename, str | Path) and not Path(error.filename).is_relative_to(folder)
        return None if other else _REMEDY[error.errno]
    if type(error).__module__.partition(".")[0] not in ("rasterio", "pyogrio"):
        return None
    # GDAL drops the error number, so ask the disk itself while the partial file still fills it.
    if folder.is_dir() and shutil.disk_usage(folder).free < 1 << 20:
        return _REMEDY[errno.ENOSPC]
    return _trial(folder) or f"GDAL refuses it ({error}); the disk has space and can be written"


def _trial(folder: Path) -> str | None:
    """What keeps a small file from being written into a folder; None when nothing does."""
    try:
        folder.mkdir(exist_ok=True)
        (folder / "trial").write_bytes(bytes(1 << 16))
    except OSError as error:
        return _REMEDY.get(error.errno or 0, str(error.strerror))
    return None
