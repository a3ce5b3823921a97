"""All readers that are fuzzed, by their names."""

from __future__ import annotations

from tests.fuzz import clouds, rasters, states, tables
from tests.fuzz.reader import Reader

READERS: dict[str, Reader] = {
    reader.name: reader for module in (rasters, clouds, tables, states) for reader in module.READERS
}
