"""The file of a tile's facts: named arrays end to end under a checksum, of which a few can be read alone."""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.facts import Facts


def checksum(array: NDArray[Any]) -> int:
    """CRC-32 of an array's values, shape and type.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.facts_file import checksum
    >>> zeros = np.zeros((2, 3), np.uint8)
    >>> checksum(zeros) == checksum(zeros.copy()), checksum(zeros) == checksum(zeros.T)  # the shape counts
    (True, False)
    """
    header = f"{array.dtype.str}{array.shape}".encode()
    return zlib.crc32(_bytes_of(np.ascontiguousarray(array)), zlib.crc32(header))


Part = bytes | memoryview

_DAMAGED = "damaged or incomplete file"

_READ = 1 << 20
"""Bytes that are read at once for a checksum."""


def pack(arrays: Mapping[str, NDArray[Any]]) -> list[Part]:
    """Named arrays as parts of a file: CRC-32 of the rest, length of the header, header (JSON), the arrays end to end.

    The parts of arrays are their own memory: a file takes no more of it than they do.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.facts_file import pack, read_facts
    >>> data = b"".join(pack({"top": np.array([1, 2]), "count": np.array([3])}))
    >>> _ = Path("whole.facts").write_bytes(data), Path("cut.facts").write_bytes(data[:-1])
    >>> {name: values.tolist() for name, values in read_facts(Path("whole.facts")).items()}
    {'top': [1, 2], 'count': [3]}
    >>> read_facts(Path("cut.facts"))
    Traceback (most recent call last):
        ...
    ValueError: damaged or incomplete file
    """
    flat = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    header = json.dumps([[name, array.dtype.str, array.shape] for name, array in flat.items()]).encode()
    parts: list[Part] = [len(header).to_bytes(4, "little"), header, *(_bytes_of(array) for array in flat.values())]
    check = 0
    for part in parts:
        check = zlib.crc32(part, check)
    return [check.to_bytes(4, "little"), *parts]


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


Layout = tuple[tuple[str, str, tuple[int, ...], int], ...]
"""Name, dtype, shape and first byte of each array in a file."""


def layout(file: BinaryIO) -> Layout:
    """Where the arrays of `pack` lie in a file, which is read to its end.

    Raises
    ------
    ValueError
        When the file is damaged or cut short.
    """
    found, check = file.read(4), 0
    while part := file.read(_READ):
        check = zlib.crc32(part, check)
    if len(found) < 4 or check != int.from_bytes(found, "little"):
        raise ValueError(_DAMAGED)
    return _header(file)


def _header(file: BinaryIO) -> Layout:
    """Layout that the header tells, which must be that of the whole file."""
    end = file.seek(0, os.SEEK_END)
    file.seek(4)
    size = int.from_bytes(file.read(4), "little")
    start, found = 8 + size, []
    try:
        for name, dtype, shape in json.loads(file.read(min(size, end))):
            kind = np.dtype(str(dtype))
            sizes = all(type(rows) is int and rows >= 0 for rows in shape)
            if not isinstance(name, str) or kind.hasobject or not sizes:
                raise ValueError(_DAMAGED)
            found.append((name, kind.str, tuple(shape), start))
            start += math.prod(shape) * kind.itemsize
    # whatever another text makes Python say
    except (TypeError, ValueError, RecursionError, SyntaxError) as error:
        raise ValueError(_DAMAGED) from error
    if start != end:
        raise ValueError(_DAMAGED)
    return tuple(found)


def count_rows(path: Path) -> dict[str, int]:
    """Rows of each array of a file, from its header alone, whose checksum is left to `read_facts`.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.facts_file import count_rows, pack
    >>> _ = Path("tile.facts").write_bytes(b"".join(pack({"edges": np.zeros((7, 2)), "count": np.zeros(3)})))
    >>> count_rows(Path("tile.facts"))
    {'edges': 7, 'count': 3}
    """
    with path.open("rb") as file:
        return {name: shape[0] for name, _, shape, _ in _header(file) if shape}


@lru_cache(maxsize=4096)
def _checked_layout(path: Path, _modified: int) -> Layout:
    """Layout of a file; its checksum is verified once per process."""
    with path.open("rb") as file:
        return layout(file)


def read_facts(path: Path, prefix: str = "") -> Facts:
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
