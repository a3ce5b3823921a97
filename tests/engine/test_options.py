"""Options are taken up to their bounds and refused beyond them, in a line."""

from __future__ import annotations

from typing import Any

import pytest

from tilepipe.engine.layers import TableLayer
from tilepipe.engine.options import RunOptions, default_workers, format_memory, parse_memory
from tilepipe.errors import InputError


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("0", 0),
        ("17", 17),
        ("17B", 17),
        ("2K", 2 << 10),
        ("2kib", 2 << 10),
        ("1.5 MB", 3 << 19),
        (" 3GiB ", 3 << 30),
        ("4T", 4 << 40),
    ],
)
def test_sizes(text: str, size: int) -> None:
    assert parse_memory(text) == size


@pytest.mark.parametrize("text", ["", "x", "-1", "1 PiB", "1e3", "1.", ".5G", "1 G B"])
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(InputError, match="is not understood; write for example 8GiB"):
        parse_memory(text)


def test_a_size_beyond_all_machines() -> None:
    with pytest.raises(InputError, match="is more than any machine has"):
        parse_memory("9" * 400 + "G")


@pytest.mark.parametrize(
    ("size", "up", "down"),
    [
        (0, "0 B", "0 B"),
        (1023, "1023 B", "1023 B"),
        (1024, "1 KiB", "1 KiB"),
        (1025, "2 KiB", "1 KiB"),
        ((1 << 20) + 1, "2 MiB", "1 MiB"),
        (1 << 30, "1.0 GiB", "1.0 GiB"),
        ((1 << 30) + 1, "1.1 GiB", "1.0 GiB"),
        (11 << 40, "11264.0 GiB", "11264.0 GiB"),
    ],
)
def test_sizes_for_people(size: int, up: str, down: str) -> None:
    assert (format_memory(size), format_memory(size, up=False)) == (up, down)


@pytest.mark.parametrize(
    ("name", "right", "wrong"),
    [
        ("tile", [1, 1 << 20], [0, -1, 1.5, "1"]),
        ("workers", [None, 1, 99], [0, -1, 1.5]),
        ("seed", [0, (1 << 62) - 1], [-1, 1 << 62, 0.5]),
        ("memory", [0, 1 << 50], [1.5, None]),
        ("backend", ["auto", "numpy", "cupy"], ["gpu", ""]),
        ("format", ["parquet", "gpkg", "fgb", "geojson"], ["shp", ""]),
    ],
)
def test_bounds(name: str, right: list[Any], wrong: list[Any]) -> None:
    for value in right:
        assert getattr(RunOptions(**{name: value}), name) == value
    for value in wrong:
        with pytest.raises(InputError, match=str(value) if value != "" else "''"):
            RunOptions(**{name: value})


def test_a_cluster_is_an_address() -> None:
    assert RunOptions(executor="tcp://host:8786").uses_cluster and not RunOptions(executor="processes").uses_cluster
    for backend, resolved in (("auto", "numpy"), ("numpy", "numpy"), ("cupy", "cupy")):
        assert RunOptions(executor="tcp://host:8786", backend=backend).resolved_backend() == resolved
    assert RunOptions(workers=3).resolved_workers == 3


def test_a_table_has_a_known_geometry() -> None:
    assert TableLayer("a", "LineString", {}, "").files == ("a.parquet", "a.gpkg", "a.fgb", "a.geojson")
    with pytest.raises(ValueError, match="table 'a' has the geometry 'Line'; use one of LineString, "):
        TableLayer("a", "Line", {}, "")  # type: ignore[arg-type]


def test_as_many_workers_as_cores_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("os.sched_getaffinity", lambda process: asked.append(process) or {2, 5, 7}, raising=False)
    assert default_workers() == RunOptions().resolved_workers == 3
    assert set(asked) == {0}, "0 is this process"
    monkeypatch.delattr("os.sched_getaffinity")
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert default_workers() == 1
