"""Which tiles of which pass are done, and what facts they left: the files that make a run resumable.

A finished tile leaves one file ``<pass>/<tile>.facts`` written aside and renamed, which holds its facts and the
checksums of all that it wrote elsewhere.  On resume the file is read and the checksums are compared with what lies
on disk; a tile that does not verify is computed again.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.facts import Facts

_SUFFIX = ".facts"


def checksum(array: NDArray[Any]) -> int:
    """CRC-32 of an array's values, shape and type.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.engine.ledger import checksum
    >>> zeros = np.zeros((2, 3), np.uint8)
    >>> checksum(zeros) == checksum(zeros.copy()), checksum(zeros) == checksum(zeros.T)  # the shape counts
    (True, False)
    """
    header = f"{array.dtype.str}{array.shape}".encode()
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, zlib.crc32(header))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it appears under its name only when complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data)
        os.replace(aside, path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Named arrays as bytes: CRC-32 of the rest, length of the header, header (JSON), the arrays end to end.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.ledger import pack, read_packed
    >>> data = pack({"top": np.array([1, 2]), "count": np.array([3])})
    >>> _ = Path("whole.facts").write_bytes(data), Path("cut.facts").write_bytes(data[:-1])
    >>> {name: values.tolist() for name, values in read_packed(Path("whole.facts")).items()}
    {'top': [1, 2], 'count': [3]}
    >>> read_packed(Path("cut.facts"))
    Traceback (most recent call last):
        ...
    ValueError: damaged or incomplete file
    """
    flat = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    header = json.dumps([[name, array.dtype.str, array.shape] for name, array in flat.items()]).encode()
    body = b"".join([len(header).to_bytes(4, "little"), header, *(array.tobytes() for array in flat.values())])
    return zlib.crc32(body).to_bytes(4, "little") + body


Layout = tuple[tuple[str, str, tuple[int, ...], int], ...]
"""Name, dtype, shape and first byte of each array in a file."""


def layout(data: bytes) -> Layout:
    """Where the arrays of `pack` lie in a file.

    Raises
    ------
    ValueError
        When the bytes are damaged or cut short.
    """
    if len(data) < 8 or zlib.crc32(memoryview(data)[4:]) != int.from_bytes(data[:4], "little"):
        raise ValueError("damaged or incomplete file")
    start = 8 + int.from_bytes(data[4:8], "little")
    found = []
    for name, dtype, shape in json.loads(data[8:start]):
        found.append((name, dtype, tuple(shape), start))
        start += math.prod(shape) * np.dtype(dtype).itemsize
    return tuple(found)


@lru_cache(maxsize=4096)
def _checked_layout(path: Path, _modified: int) -> Layout:
    """Layout of a file; its checksum is verified once per process."""
    return layout(path.read_bytes())


def read_packed(path: Path, prefix: str = "") -> Facts:
    """Arrays of a file whose names begin with ``prefix``.

    Raises
    ------
    ValueError
        When the file is damaged or cut short.
    """
    facts: Facts = {}
    wanted = [entry for entry in _checked_layout(path, path.stat().st_mtime_ns) if entry[0].startswith(prefix)]
    with path.open("rb") as file:
        for name, dtype, shape, start in wanted:
            file.seek(start)
            facts[name] = np.fromfile(file, dtype, math.prod(shape)).reshape(shape)
    return facts


@dataclass(frozen=True)
class Ledger:
    """The facts of one pass, one file a tile, in ``folder``.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.ledger import Ledger
    >>> ledger = Ledger(Path("regions"))
    >>> ledger.record("r0c0", {"count": np.array([7])})
    >>> ledger.done(), ledger.facts("r0c0")["count"].item()
    ({'r0c0'}, 7)
    """

    folder: Path

    def path(self, tile_name: str) -> Path:
        """File of a tile's facts."""
        return self.folder / f"{tile_name}{_SUFFIX}"

    def record(self, tile_name: str, facts: Facts) -> None:
        """Mark a tile as done, with its facts."""
        write_whole(self.path(tile_name), pack(facts))

    def facts(self, tile_name: str, prefix: str = "") -> Facts:
        """Facts of a finished tile whose names begin with ``prefix``.

        Raises
        ------
        ValueError
            When the file is damaged.
        FileNotFoundError
            When the tile is not done.
        """
        return read_packed(self.path(tile_name), prefix)

    def all_facts(self) -> list[Facts]:
        """Facts of all finished tiles in row-major order."""
        return list(self.each())

    def each(self) -> Iterator[Facts]:
        """Facts of all finished tiles in row-major order, one after the other."""
        names = sorted(self.done(), key=lambda name: [int(part) for part in name[1:].split("c")])
        return (self.facts(name) for name in names)

    def forget(self, tile_name: str) -> None:
        """Mark a tile as not done."""
        self.path(tile_name).unlink(missing_ok=True)

    def done(self) -> set[str]:
        """Names of the tiles marked as done (not yet verified)."""
        if not self.folder.is_dir():
            return set()
        return {path.name[: -len(_SUFFIX)] for path in self._files()}

    def _files(self) -> Iterator[Path]:
        return (p for p in self.folder.iterdir() if p.name.endswith(_SUFFIX) and not p.name.startswith("."))
