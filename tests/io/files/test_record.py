"""Each entry of a record is taken up to its bounds and refused beyond them."""

from __future__ import annotations

from typing import Any

import pytest

from tilepipe.errors import InputError
from tilepipe.io.files.record import as_toml, check_record, parsed_toml

MOST = 2**31 - 1
"""What GDAL counts rows, columns and bands with."""


@pytest.mark.parametrize(
    ("table", "entry", "right", "wrong"),
    [
        ("inputs", "band", [1, MOST], [0, -1, MOST + 1, True, 1.0, "1"]),
        ("inputs", "height_band", [1, MOST], [0, MOST + 1, "1"]),
        ("inputs", "crs", ["", "EPSG:1"], [1, ["EPSG:1"]]),
        ("inputs", "rasters", ["a", ["a", "b"], []], [1, ["a", 1], {"a": "b"}]),
        ("raster", "shape", [[1, 1], [MOST, MOST]], [[1], [1, 1, 1], [0, 1], [1, MOST + 1], 1, [1.0, 1]]),
        ("raster", "left", [0, -1.5], [float("inf"), float("nan"), True, "0", 10**400]),
        ("raster", "pixel", [1, 1e-9], [0, -1, float("inf"), True]),
        ("raster", "metres", [1, 1e-9], [0, -0.1]),
        ("options", "format", ["gpkg"], [1]),
        ("files", "a.tif", [{"size": 0, "crc32": 0}, {"size": 2**62, "crc32": 1}], [{"size": 1}, {}, 1]),
        ("files", "b.tif", [], [{"size": -1, "crc32": 0}, {"size": 2**62 + 1, "crc32": 0}]),
    ],
)
def test_bounds_of_entries(table: str, entry: str, right: list[Any], wrong: list[Any]) -> None:
    for value in right:
        check_record({table: {entry: value}}, "it")
    for value in wrong:
        with pytest.raises(InputError, match=rf"^it: \[{table}\] {entry} must be .*; correct it$"):
            check_record({table: {entry: value}}, "it")


@pytest.mark.parametrize("name", [".", "..", "a/b", "/a", "a\\b", ""])
def test_names_of_files_lead_nowhere_else(name: str) -> None:
    with pytest.raises(InputError, match="is no name of a file in the folder"):
        check_record({"files": {name: {"size": 1, "crc32": 1}}}, "it")


@pytest.mark.parametrize("record", [{"command": "\0"}, {"parameters": {"a": [["b", "\0"]]}}, {"parameters": {"\0": 1}}])
def test_a_text_with_nul_is_refused(record: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="a text holds the character NUL"):
        check_record(record, "it")


def test_a_value_is_shown_on_a_part_of_a_line() -> None:
    for length, shown in ((58, "'" + "x" * 58 + "'"), (59, "'" + "x" * 56 + "…")):
        with pytest.raises(InputError, match=rf"not {shown}; correct it$"):
            check_record({"inputs": {"band": "x" * length}}, "it")


def test_tables_within_tables_have_an_end() -> None:
    def nested(levels: int) -> str:
        return "a = " + "[" * levels + "]" * levels

    deepest = next(levels for levels in range(1, 1000) if not _is_taken(nested(levels))) - 1
    assert 10 < deepest < 200
    assert _is_taken(nested(deepest)) and not _is_taken(".".join("a" * (deepest + 2)) + " = 1")


def _is_taken(text: str) -> bool:
    try:
        return as_toml(parsed_toml(text)) != b""
    except ValueError:
        return False
