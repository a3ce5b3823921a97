"""The file of a tile's facts: named arrays end to end under a checksum, of which a few can be read alone."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

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
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, zlib.crc32(header))


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Named arrays as bytes: CRC-32 of the rest, length of the header, header (JSON), the arrays end to end.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.facts_file import pack, read_facts
    >>> data = pack({"top": np.array([1, 2]), "count": np.array([3])})
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
