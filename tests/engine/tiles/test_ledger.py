"""Facts come back as they were recorded, damage is noticed, nothing is half written."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe.engine.tiles.facts_file import checksum, layout, pack
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
    data = bytearray(pack({"a": np.arange(100)}))
    data[position] ^= 1
    with pytest.raises(ValueError, match="damaged"):
        layout(bytes(data))


def test_a_short_file_is_noticed():
    with pytest.raises(ValueError, match="damaged"):
        layout(pack({"a": np.arange(100)})[:-1])


def test_checksum_sees_value_shape_and_type():
    a = np.arange(6, dtype=np.int32)
    others = [a + 1, a.reshape(2, 3), a.astype(np.uint32), a[::-1]]
    assert checksum(a) == checksum(a.copy())
    assert all(checksum(a) != checksum(other) for other in others)
