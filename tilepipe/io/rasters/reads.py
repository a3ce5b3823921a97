"""What a tile has read: windows of sources with the checksums of their values, so that it can be verified later."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.grid import Window


class Readable(Protocol):
    """What can be read again, and says whether it is still what it was."""

    @property
    def content(self) -> str:
        """Digest of what it holds, whenever that was written, of 16 hexadecimal digits."""
        ...

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """Values of a window, band after band."""
        ...

    def check(self, window: Window | None = None) -> None:
        """Raise `ChangedInputError` when a window, or anything, is no longer what it was."""
        ...


class Reads:
    """Windows of sources that were read, with the checksums of their values."""

    def __init__(self) -> None:
        self._windows: dict[tuple[int, Window], tuple[Readable, int, int]] = {}

    def add(self, source: Readable, window: Window, bands: int, checksum: int) -> None:
        """Note that so many bands of a window were read, and the checksum of their values."""
        _, known, _ = self._windows.get((id(source), window), (source, 0, 0))
        if bands >= known:
            self._windows[id(source), window] = source, bands, checksum

    def check(self) -> None:
        """Check that all of it is still what it was before it was read.

        Raises
        ------
        ChangedInputError
            Names the file.
        """
        for (_, window), (source, *_) in self._windows.items():
            source.check(window)

    def table(self) -> NDArray[np.uint64]:
        """One row for each: source, top, left, bottom, right, bands, checksum; uint64 of shape (n, 7)."""
        rows = [
            (int(source.content, 16), window.top, window.left, window.bottom, window.right, bands, checksum)
            for (_, window), (source, bands, checksum) in self._windows.items()
        ]
        return np.array(rows, np.uint64).reshape(-1, 7)


_current: ContextVar[Reads | None] = ContextVar("reads", default=None)


@contextmanager
def noted_reads() -> Iterator[Reads]:
    """Note all that this thread reads of rasters within a block.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> from tilepipe.io.rasters.reads import noted_reads
    >>> from tilepipe.tiling.grid import Window
    >>> y, x = 5820000 - np.arange(4.0), 392000.0 + np.arange(3)
    >>> raster = tilepipe.open_raster([xr.DataArray(np.ones((4, 3)), {"y": y, "x": x}, ("y", "x"))], crs="EPSG:32633")
    >>> with noted_reads() as reads:
    ...     _ = raster.read(Window(0, 0, 2, 3))
    >>> reads.table()[:, 1:5].tolist()
    [[0, 0, 2, 3]]
    """
    reads = Reads()
    token = _current.set(reads)
    try:
        yield reads
    finally:
        _current.reset(token)


def bands_noted(source: Readable, window: Window) -> Iterator[NDArray[np.float32]]:
    """Values of a window of a source, band after band; a block of `noted_reads` takes note of those that are taken."""
    reads = _current.get()
    checksum = 0
    for bands, values in enumerate(source.read_bands(window), 1):
        if reads is not None:
            checksum = _checksum(values, checksum)
            reads.add(source, window, bands, checksum)
        yield values


def _checksum(values: NDArray[np.float32], before: int) -> int:
    return zlib.crc32(np.ascontiguousarray(values).view(np.uint8).data, before)


def is_unchanged(tables: Iterable[NDArray[np.uint64]], sources: Sequence[Readable]) -> bool:
    """Whether reading again gives the values that `Reads.table` has noted; each window is read once.

    Parameters
    ----------
    tables
        What tiles have noted.
    sources
        Where they have read.  What none of them holds has changed.
    """
    by_content = {int(source.content, 16): source for source in sources}
    seen: dict[tuple[int, ...], int] = {}
    for table in tables:
        for *place, checksum in table.tolist():
            known = seen.get(tuple(place))
            if known is None:
                source = by_content.get(place[0])
                if source is None:
                    return False
                known = 0
                for values in itertools.islice(source.read_bands(Window(*place[1:5])), place[5]):
                    known = _checksum(values, known)
                seen[tuple(place)] = known
            if known != checksum:
                return False
    return True
