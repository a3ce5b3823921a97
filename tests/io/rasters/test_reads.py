"""What a tile has read is noted with checksums, and found again or not."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np
import pytest

from tilepipe.io.rasters.reads import bands_noted, is_unchanged, noted_reads
from tilepipe.tiling.grid import Window

WINDOW = Window(1, 2, 4, 6)


class Source:
    """Bands of numbers."""

    def __init__(self, content: str = "00000000000000ff") -> None:
        self.content = content
        self.values = np.arange(3 * 8 * 9, dtype=np.float32).reshape(3, 8, 9)
        self.checked: list[Window | None] = []
        self.times = 0

    def read_bands(self, window: Window) -> Iterator[np.ndarray]:
        self.times += 1
        for band in self.values:
            yield band[window.slices]

    def check(self, window: Window | None = None) -> None:
        self.checked.append(window)


def take(source: Source, bands: int, window: Window = WINDOW) -> None:
    for _, _ in zip(range(bands), bands_noted(source, window), strict=False):
        pass


def checksum(source: Source, bands: int) -> int:
    return zlib.crc32(b"".join(band[WINDOW.slices].tobytes() for band in source.values[:bands]))


@pytest.mark.parametrize("bands", [1, 2, 3])
def test_the_bands_that_were_taken_are_noted(bands):
    source = Source()
    with noted_reads() as reads:
        take(source, bands)
    assert reads.table().tolist() == [[255, 1, 2, 4, 6, bands, checksum(source, bands)]]
    reads.check()
    assert source.checked == [WINDOW]


def test_the_most_that_was_taken_of_a_window_counts():
    source = Source()
    with noted_reads() as reads:
        for bands in (1, 3, 2):
            take(source, bands)
    assert reads.table()[:, 5:].tolist() == [[3, checksum(source, 3)]]


def test_nothing_is_noted_outside():
    source = Source()
    with noted_reads() as reads:
        with noted_reads() as inner:
            take(source, 1)
        take(source, 2)
    take(source, 3)
    assert len(inner.table()) == 1 and reads.table()[:, 5].tolist() == [2]
    assert noted_reads().__enter__().table().shape == (0, 7)


@pytest.mark.parametrize("band", [0, 1, 2])
def test_only_what_was_read_must_be_unchanged(band):
    source = Source()
    with noted_reads() as reads:
        take(source, 2)
    table = reads.table()
    assert is_unchanged([table], [source])
    source.times = 0
    assert is_unchanged([table, table], [source]) and source.times == 1
    source.values[band, 3, 5] += 1
    assert is_unchanged([table], [source]) == (band == 2)
    source.values[band, 3, 5] -= 1
    source.values[band, 4, 5] += 1
    assert is_unchanged([table], [source])
    assert not is_unchanged([table], [Source("00000000000000fe")])
    assert is_unchanged([], [])
