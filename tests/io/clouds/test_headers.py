"""A header counts at most what its file has room for (LAS 1.4, table 3), to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from tilepipe.io.clouds.cloud import _check_records

RECORD, EXTENDED = 54, 60
"""Bytes of the headers of records, at least."""


def write(path: Path, size: int, fields: dict[int, tuple[int, int]], tail: dict[int, tuple[int, int]] | None = None):
    """A file of zeros with numbers (value, bytes) at places."""
    content = bytearray(size)
    for place, (value, length) in (fields | (tail or {})).items():
        content[place : place + length] = value.to_bytes(length, "little")
    path.write_bytes(content)


def is_taken(path: Path) -> bool:
    try:
        _check_records(path)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("counted", [0, 1, 3, 77])
@pytest.mark.parametrize("room", [0, 1, -1])
def test_records_begin_behind_the_header(tmp_path, counted, room):
    begin = 375
    write(tmp_path / "a", begin + counted * RECORD + room, {94: (begin, 2), 100: (counted, 4)})
    assert is_taken(tmp_path / "a") == (room >= 0)


@pytest.mark.parametrize("minor", [2, 3, 4, 5])
@pytest.mark.parametrize("counted", [0, 1, 5])
@pytest.mark.parametrize("room", [0, 1, -1])
def test_extended_records_begin_where_the_header_says(tmp_path, minor, counted, room):
    begin, size = 1000, 1000 + counted * EXTENDED + room
    write(tmp_path / "a", size, {25: (minor, 1), 94: (375, 2), 235: (begin, 8), 243: (counted, 4)})
    # before LAS 1.4 there were none, nor does their place count where there are none
    assert is_taken(tmp_path / "a") == (room >= 0 or minor < 4 or counted == 0)


@pytest.mark.parametrize("compressed", [0, 0x80, 0x81, 0x7F])
@pytest.mark.parametrize("at_the_end", [False, True])
@pytest.mark.parametrize("more", [0, 1])
def test_chunks_have_a_byte_each(tmp_path, compressed, at_the_end, more):
    size, points, table = 900, 400, 500
    fields = {94: (375, 2), 96: (points, 4), 104: (compressed, 1), table + 4: (size + more, 4)}
    fields[points] = ((1 << 64) - 1 if at_the_end else table, 8)
    write(tmp_path / "a", size, fields, {size - 8: (table, 8)} if at_the_end else None)
    assert is_taken(tmp_path / "a") == (more == 0 or not compressed & 0x80)


@pytest.mark.parametrize("place", [900, 901, 1 << 40])
def test_a_table_beyond_the_end_counts_nothing(tmp_path, place):
    write(tmp_path / "a", 900, {94: (375, 2), 96: (400, 4), 104: (0x80, 1), 400: (place, 8)})
    assert is_taken(tmp_path / "a")
