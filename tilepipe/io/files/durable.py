"""Small files in one step, and content and names that a loss of power cannot undo."""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path


def atomic_write_bytes(final: Path, *parts: bytes | memoryview, durable: bool = False) -> None:
    """Write a small file in one step; its folder must be there.

    For the many files of a run, which several processes, even of several machines, may write at once: errors of the
    disk are raised as they are.  A folder that is gone stays gone: nobody wants what it held.

    Parameters
    ----------
    final
        Path of the finished file.  An existing file is replaced in one step.
    parts
        What it holds, end to end.
    durable
        Wait until a loss of power cannot undo it.

    Raises
    ------
    OSError
        When the file cannot be written; nothing of it is left.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.durable import atomic_write_bytes
    >>> atomic_write_bytes(Path("first.txt"), b"whole")
    >>> [path.name for path in Path().iterdir()]
    ['first.txt']
    """
    # processes of different machines may have one number
    aside = final.with_name(f".{final.name}.{secrets.token_hex(8)}.part")
    try:
        with aside.open("wb") as file:
            file.writelines(parts)
        if durable:
            flush_to_disk(aside)
        os.replace(aside, final)
        if durable:
            flush_folder(final.parent)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def flush_to_disk(path: Path) -> None:
    """Wait until the content of a file is on disk: so the kernel reports a full disk, and a loss of power is harmless.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.durable import flush_to_disk
    >>> _ = Path("notes.txt").write_text("kept")
    >>> flush_to_disk(Path("notes.txt"))
    """
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """Wait until the names in a folder are on disk, where the file system can be asked for that.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.durable import flush_folder
    >>> flush_folder(Path())
    """
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
