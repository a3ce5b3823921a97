"""Which files of a folder tilepipe has written: only these, and only as they were written, may be replaced or removed.

A file is known by its name, size and CRC-32, so that one of the same name that somebody else has put there, or that was
edited since, is not taken for it.
"""

from __future__ import annotations

import stat
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tilepipe.errors import InputError, OutputError
from tilepipe.io.files.durable import atomic_write_bytes
from tilepipe.io.files.record import as_toml, read_record

_FOREIGN = "was not written by tilepipe or has changed since; move it away"

_PIECE = 1 << 22
"""Bytes that are read at once."""


@dataclass(frozen=True)
class Written:
    """A file as it was written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.manifest import Written
    >>> _ = Path("streets.tif").write_bytes(b"layer")
    >>> written = Written.of(Path("streets.tif"))
    >>> written.lies_in(Path())
    True
    >>> _ = Path("streets.tif").write_bytes(b"mine!")
    >>> written.lies_in(Path())
    False
    """

    name: str
    size: int
    crc32: int

    @classmethod
    def of(cls, path: Path) -> Written:
        """A file as it lies on disk."""
        return cls(path.name, path.stat().st_size, _crc32(path))

    def lies_in(self, folder: Path) -> bool:
        """Whether the file lies in a folder as it was written; a link is another file."""
        path = folder / self.name
        try:
            status = path.lstat()
            return stat.S_ISREG(status.st_mode) and status.st_size == self.size and _crc32(path) == self.crc32
        except OSError:
            return False


def as_table(files: Iterable[Written]) -> dict[str, dict[str, int]]:
    """Files as a table of a record; `from_table` reads it back.

    Examples
    --------
    >>> from tilepipe.io.files.manifest import Written, as_table, from_table
    >>> as_table([Written("streets.tif", size=5, crc32=7)])
    {'streets.tif': {'size': 5, 'crc32': 7}}
    >>> from_table({"streets.tif": {"size": 5, "crc32": 7}})
    [Written(name='streets.tif', size=5, crc32=7)]
    """
    return {file.name: {"size": file.size, "crc32": file.crc32} for file in files}


def from_table(table: dict[str, Any]) -> list[Written]:
    """Files of a record that `as_table` has put there; the record is checked (`tilepipe.io.files.record`)."""
    return [Written(name, entry["size"], entry["crc32"]) for name, entry in table.items()]


def read_manifest(path: Path) -> list[Written]:
    """Files that a manifest names, a file of TOML that holds nothing else; none where it is missing.

    Raises
    ------
    InputError
        It is another file, or damaged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.manifest import Written, read_manifest, write_manifest
    >>> write_manifest(Path("files.toml"), [Written("streets.tif", size=5, crc32=7)])
    >>> read_manifest(Path("files.toml"))
    [Written(name='streets.tif', size=5, crc32=7)]
    """
    if not (path.is_symlink() or path.exists()):
        return []
    record = read_record(path)
    if set(record) != {"files"}:
        raise InputError(f"{path}: {_FOREIGN}")
    return from_table(record["files"])


def write_manifest(path: Path, files: Iterable[Written]) -> None:
    """Write a manifest, which must be on disk before the files that it names appear; `read_manifest` reads it."""
    atomic_write_bytes(path, as_toml({"files": as_table(files)}), durable=True)


def refuse_foreign(folder: Path, names: Iterable[str], known: Iterable[Written]) -> None:
    """Refuse to replace or remove files of which it is not certain that tilepipe has written them.

    Parameters
    ----------
    folder
        Where they lie.
    names
        Of files that would be replaced or removed; those that are not there are of no account.
    known
        What tilepipe has written there.

    Raises
    ------
    OutputError
        One of them is another file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.manifest import refuse_foreign
    >>> _ = Path("streets.tif").write_bytes(b"a map of mine")
    >>> refuse_foreign(Path("."), ["streets.tif"], known=[])
    Traceback (most recent call last):
        ...
    tilepipe.errors.OutputError: streets.tif: was not written by tilepipe or has changed since; move it away
    """
    known = list(known)
    for name in dict.fromkeys(names):
        path = folder / name
        if (path.is_symlink() or path.exists()) and not any(
            file.lies_in(folder) for file in known if file.name == name
        ):
            raise OutputError(f"{path}: {_FOREIGN}")


def _crc32(path: Path) -> int:
    found = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            found = zlib.crc32(piece, found)
    return found
