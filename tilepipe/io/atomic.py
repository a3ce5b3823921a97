"""Atomic writes: a file is written beside its final name and renamed when it is whole."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tilepipe.errors import InputError

_REMEDY = {
    errno.ENOSPC: "the disk is full; free some space or choose another folder",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another folder",
    errno.EACCES: "no permission to write there; choose another folder or change its permissions",
    errno.EPERM: "no permission to write there; choose another folder or change its permissions",
    errno.EROFS: "the disk is read-only; choose another folder",
    errno.ENOENT: "the folder does not exist; create it first",
    errno.ENOTDIR: "its parent is a file, not a folder; choose another folder",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}


@contextmanager
def atomic_write(final: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a path to write to; rename it to `final` when the block ends well, remove it when it does not.

    The path has the name of `final` (drivers look at the suffix) in a hidden folder beside it, which also
    takes journals and other side files. What a killed run left there is cleared by the next write of the
    same file.

    Parameters
    ----------
    final
        Path of the finished file. An existing file is replaced in one step.

    Raises
    ------
    InputError
        The folder is missing or unwritable, or the disk is full; the message names the file and the remedy.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.atomic import atomic_write
    >>> with atomic_write("notes.txt") as path:
    ...     _ = path.write_text("whole")
    ...     Path("notes.txt").exists()
    False
    >>> Path("notes.txt").read_text()
    'whole'
    """
    final = Path(final)
    folder = final.parent / f".{final.name}.partial"
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir()
        yield folder / final.name
        _flush_to_disk(folder / final.name)
        os.replace(folder / final.name, final)
    except InputError:
        raise
    except Exception as error:
        remedy = _remedy(error, folder)
        if remedy is None:
            raise
        raise InputError(f"cannot write {final}: {remedy}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def atomic_write_bytes(final: Path, data: bytes) -> None:
    """Write a small file in one step; its folder is made when missing.

    For the many files of a run, which several processes may write at once: it does not wait for the disk, and errors
    of the disk are raised as they are.

    Parameters
    ----------
    final
        Path of the finished file.  An existing file is replaced in one step.
    data
        What it holds.

    Raises
    ------
    OSError
        When the file cannot be written; nothing of it is left.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.atomic import atomic_write_bytes
    >>> atomic_write_bytes(Path("notes/first.txt"), b"whole")
    >>> [path.name for path in Path("notes").iterdir()]
    ['first.txt']
    """
    final.parent.mkdir(parents=True, exist_ok=True)
    aside = final.with_name(f".{final.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data)
        os.replace(aside, final)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def _flush_to_disk(path: Path) -> None:
    """Make the kernel report a full disk now: after the rename it would be too late."""
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


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
    return f"{error}; check that the disk has space and that the file can be written"
