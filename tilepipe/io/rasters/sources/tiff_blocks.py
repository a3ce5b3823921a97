"""Where the pixels of a TIFF end in its file, told by its directory alone (TIFF 6.0, section 2; BigTIFF)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_OFFSETS, _COUNTS = (324, 273), (325, 279)
"""Tags of the places and sizes of tiles, or else of strips."""

_TYPES = {3: "u2", 4: "u4", 16: "u8"}
_AT_ONCE = 1 << 20
"""Blocks looked at together: a raster may have many millions."""


def end_of_pixels(path: Path) -> int:
    """Bytes that a file must have for all blocks of its first image; blocks never written need none.

    Raises
    ------
    ValueError
        The file is no TIFF.

    Examples
    --------
    An image of one block; what ends before it is not whole.

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import rasterio
    >>> from tilepipe.io.rasters.sources.tiff_blocks import end_of_pixels
    >>> with rasterio.open("image.tif", "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8") as image:
    ...     image.write(np.ones((1, 9, 9), np.uint8))
    >>> end_of_pixels(Path("image.tif")) <= Path("image.tif").stat().st_size
    True
    """
    file = np.memmap(path, np.uint8, "r")
    order = {b"II": "<", b"MM": ">"}.get(bytes(file[:2]))
    version = int(file[2:4].view(f"{order or '<'}u2")[0]) if file.size >= 8 else 0
    if order is None or version not in (42, 43):
        raise ValueError(f"{path} is no TIFF")
    word, count, start = ("u4", "u2", 4) if version == 42 else ("u8", "u8", 8)
    kinds = {"tag": f"{order}u2", "type": f"{order}u2", "count": f"{order}{word}", "value": f"V{word[1]}"}
    entry = np.dtype(list(kinds.items()))
    if file.size < start + int(word[1]):
        return start + int(word[1])
    first = int(file[start : start + int(word[1])].view(order + word)[0])
    after = first + int(count[1])
    if after > file.size:
        return after
    number = int(file[first:after].view(order + count)[0])
    end = after + number * entry.itemsize
    if end > file.size:
        return end
    entries = file[after:end].view(entry)
    tables: list[NDArray[np.unsignedinteger]] = []
    for tags in (_OFFSETS, _COUNTS):
        found = next((item for tag in tags for item in entries[entries["tag"] == tag]), None)
        if found is None or int(found["type"]) not in _TYPES:
            return end
        kind = np.dtype(order + _TYPES[int(found["type"])])
        size = int(found["count"]) * kind.itemsize
        value = np.frombuffer(found["value"].tobytes(), np.uint8)
        if size > value.size:
            place = int(value.view(order + word)[0])
            if place + size > file.size:
                return place + size
            value = file[place : place + size]
        tables.append(value[:size].view(kind))
    offsets, counts = tables
    for begin in range(0, min(offsets.size, counts.size), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        end = max(end, int((offsets[part].astype(np.uint64) + counts[part].astype(np.uint64)).max()))
    return end
