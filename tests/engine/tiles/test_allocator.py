"""The C allocator is told in its own numbers to keep what is freed."""

from __future__ import annotations

import pytest

from tilepipe.engine.tiles import allocator


class Library:
    def __init__(self, refused: int = 0) -> None:
        self.told: dict[int, int] = {}
        self.refused = refused

    def mallopt(self, name: int, value: int) -> int:
        self.told[name] = value
        return int(name != self.refused)


def load(monkeypatch: pytest.MonkeyPatch, library: object) -> None:
    monkeypatch.setattr(allocator.ctypes, "CDLL", lambda name: library)


def test_the_numbers_are_those_of_malloc_h(monkeypatch):
    library = Library()
    load(monkeypatch, library)
    assert allocator.keep_freed_memory()
    arena_max, mmap_max, trim_threshold = -8, -4, -1
    assert library.told == {arena_max: 1, mmap_max: 0, trim_threshold: 1 << 30}


@pytest.mark.parametrize("library", [Library(-8), Library(-4), Library(-1), object()])
def test_an_allocator_that_does_not_know_them_is_told_of(monkeypatch, library):
    load(monkeypatch, library)
    assert not allocator.keep_freed_memory()
