"""Facts come back as they were recorded, damage is noticed, nothing is half written."""

from __future__ import annotations

import json
import tracemalloc
import zlib
from io import BytesIO

import numpy as np
import pytest

from tilepipe.engine.tiles.facts_file import checksum, count_rows, layout, pack, read_facts
from tilepipe.engine.tiles.ledger import Ledger


def test_facts_come_back(tmp_path):
    ledger = Ledger(tmp_path / "pass")
    facts = {"edge:top": np.arange(5), "empty": np.empty((0, 2), np.float32)}
    assert ledger.done() == set()
    ledger.record("r0000c0001", facts)
    found = ledger.facts("r0000c0001")
    assert ledger.done() == {"r0000c0001"}
    assert found.keys() == facts.keys()
    for name, value in facts.items():
        np.testing.assert_array_equal(found[name], value)
        assert found[name].dtype == value.dtype


@pytest.mark.parametrize("position", [0, 10, -1])
def test_a_changed_byte_is_noticed(position):
    data = bytearray(b"".join(pack({"a": np.arange(100)})))
    data[position] ^= 1
    with pytest.raises(ValueError, match="damaged"):
        layout(BytesIO(data))


@pytest.mark.parametrize(
    "header",
    [
        *(7, {"a": 1}, [["a"]], [["a", "<i4", [-1]]], [["a", "<i4", [2.0]]], [["a", "|O", [1]]], [[1, "<i4", [1]]]),
        *([["a", "no type", [1]]], [["a", "<i4", [1 << 40]]], [["a", "<i4", 1]]),
    ],
)
def test_a_header_that_is_none_of_facts_is_noticed_whatever_its_checksum(tmp_path, header):
    text = json.dumps(header).encode()
    rest = len(text).to_bytes(4, "little") + text + bytes(4)
    path = tmp_path / "tile.facts"
    path.write_bytes(zlib.crc32(rest).to_bytes(4, "little") + rest)
    for read in (read_facts, count_rows):
        with pytest.raises(ValueError, match="damaged"):
            read(path)


def test_a_short_file_is_noticed():
    with pytest.raises(ValueError, match="damaged"):
        layout(BytesIO(b"".join(pack({"a": np.arange(100)}))[:-1]))


def test_checksum_sees_value_shape_and_type():
    a = np.arange(6, dtype=np.int32)
    others = [a + 1, a.reshape(2, 3), a.astype(np.uint32), a[::-1]]
    assert checksum(a) == checksum(a.copy())
    assert all(checksum(a) != checksum(other) for other in others)


def test_a_file_of_facts_takes_no_second_copy_of_them(tmp_path):
    facts = {name: np.arange(500_000) for name in "abcd"}
    size = sum(values.nbytes for values in facts.values())
    tracemalloc.start()
    Ledger(tmp_path).record("r0c0", facts)
    written = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    found = Ledger(tmp_path).facts("r0c0")
    read = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert all((found[name] == facts[name]).all() for name in facts)
    assert written < size / 4 and read < 1.25 * size


def test_rows_are_counted_from_the_heads_of_the_files(tmp_path):
    ledger = Ledger(tmp_path)
    ledger.record("r0c0", {"edges": np.zeros((3, 2)), "count": np.zeros(0)})
    ledger.record("r0c1", {"edges": np.zeros((4, 2)), "count": np.zeros(5)})
    assert ledger.rows() == {"edges": 7, "count": 5}
