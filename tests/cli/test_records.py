"""Records of any content: what cannot be used is refused in one line, whichever command reads it."""

from __future__ import annotations

import copy
import os
import socket
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, date, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.scenes import write_raster
from tilepipe.cli import records
from tilepipe.engine.options import RunOptions
from tilepipe.engine.request import checked_request
from tilepipe.engine.run_folder import Uses, check_folder
from tilepipe.errors import InputError
from tilepipe.io.files.record import RECORD, STATE, as_toml, read_record
from tilepipe.pipelines import registry
from tilepipe.report.finished_run import open_folder

TOKEN = "0" * 32


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Has the input of a run, whose record is `valid`."""
    path = tmp_path_factory.mktemp("records")
    write_raster(path / "intensity.tif", np.arange(600, dtype=np.float32).reshape(20, 30))
    return path


@cache
def valid(folder: Path, name: str) -> dict[str, Any]:
    """Record of a run as it reads back."""
    pipeline, options = registry.pipeline(name), RunOptions(tile=64, workers=1)
    request = checked_request(pipeline, folder / "intensity.tif", {}, None, None, None, options)
    return tomllib.loads(
        as_toml(request.record(folder / "run") | {"files": {"a.tif": {"size": 3, "crc32": 4}}}).decode()
    )


VALUES = st.one_of(
    st.integers(min_value=-(10**30), max_value=10**30),
    st.sampled_from([0, -1, 1 << 31, 1 << 63, 10**400, True, float("nan"), float("inf"), -0.0, 1e308, 5e-324]),
    st.sampled_from(["", "\0", "\n", "..", "../a", "numpy", "tcp://", "-", "9" * 400 + "G", "EPSG:0", "x" * 300]),
    st.sampled_from([[], [[]], [1], [1, 2, 3], ["a"], [{}], {}, {"a": {"b": {}}}, {"size": -1, "crc32": "x"}]),
    st.sampled_from([date(2020, 2, 29), datetime(2020, 1, 1, tzinfo=UTC)]),
)


def places(record: dict[str, Any]) -> list[tuple[str, ...]]:
    """The keys that lead to each entry."""
    found: list[tuple[str, ...]] = []
    for key, value in record.items():
        found += [(key,), *((key, *rest) for rest in (places(value) if isinstance(value, dict) else []))]
    return found


@st.composite
def changes(draw: st.DrawFn, depth: int) -> list[tuple[int, str, Any]]:
    """Entries by their number, what happens to them, and a value."""
    kinds = st.sampled_from(["set", "set", "remove", "add"])
    return draw(st.lists(st.tuples(st.integers(0, depth), kinds, VALUES), min_size=1, max_size=3))


def changed(record: dict[str, Any], edits: list[tuple[int, str, Any]]) -> dict[str, Any]:
    record = copy.deepcopy(record)
    for number, kind, value in edits:
        found = places(record)
        if not found:
            break
        *path, key = found[number % len(found)]
        table = record
        for part in path:
            table = table[part]
        if kind == "remove":
            del table[key]
        else:
            table[f"{key}_" if kind == "add" else key] = value
    return record


def readers(folder: Path) -> list[Callable[[], object]]:
    """All that reads the record of a run, of the one in ``folder`` and of one in its state."""
    return [
        lambda: records.plan(folder / RECORD),
        lambda: records.status(folder),
        lambda: records.status(folder / "unfinished"),
        lambda: registry.pipelines_of(folder),
        lambda: open_folder(folder, None).facts(""),
        lambda: check_folder(folder, Uses((folder / "intensity.tif",), ("a.tif",)), overwrite=True),
    ]


def read_by_all(folder: Path, content: bytes) -> None:
    """Every reader takes the record, or refuses it in one line."""
    state = folder / "unfinished" / STATE
    (state / TOKEN).mkdir(parents=True, exist_ok=True)
    (state / "lock").write_bytes(b"tilepipe: state of an unfinished run\n")
    (state / "identity.toml").write_text(f'token = "{TOKEN}"\n[identity]\n')
    for path in (folder / RECORD, state / RECORD):
        path.write_bytes(content)
    for read in readers(folder):
        with suppress(InputError):
            read()


@pytest.mark.parametrize("name", registry.OWN)
@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=changes(depth=60))
def test_a_changed_record_is_taken_or_refused(folder: Path, name: str, edits: list[tuple[int, str, Any]]) -> None:
    record = changed(valid(folder, name), edits)
    try:
        content = as_toml(record)
    except ValueError:  # Python writes no whole number of so many digits
        content = b"a = " + b"9" * 9999
    read_by_all(folder, content)


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.one_of(st.binary(max_size=60), st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace")))
)
def test_any_bytes_are_refused(folder: Path, content: bytes) -> None:
    read_by_all(folder, content)


@pytest.mark.parametrize(("entry", "value"), [("crs", ""), ("left", 1e30), ("top", -1e308), ("pixel", 1e308)])
def test_a_run_that_lies_nowhere_is_not_drawn(folder: Path, entry: str, value: Any) -> None:
    record = copy.deepcopy(valid(folder, "streets"))
    record["raster"][entry] = value
    (folder / RECORD).write_bytes(as_toml(record))
    with pytest.raises(InputError, match=r"run\.toml: its \[raster\] (lies nowhere|crs is none that is known)"):
        open_folder(folder, None)


SPECIAL = {
    "nested": b"a = " + b"[" * 100_000,
    "tables in tables": b"a" + b".a" * 200_000 + b" = 1",
    "quoted tables": b"a = {" + b"'a' . " * 2000 + b"b = 1}",
    "headers": b"[" + b"a." * 90 + b"a]\n" + b"b." * 50 + b"b = 1",
    "many digits": b"a = " + b"9" * 10_000,
    "no day": b"a = 2021-02-30",
    "no UTF-8": b"a = '\xff'",
    "NUL": b"a = '\0'",
}


@pytest.mark.parametrize("content", SPECIAL.values(), ids=SPECIAL)
def test_special_content_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / RECORD).write_bytes(content)
    with pytest.raises(InputError, match=r"run\.toml: is no valid TOML \(.+\)$"):
        records.load_record(tmp_path / RECORD, None)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
@pytest.mark.parametrize("name", ["", ".", "..", "../map.tif", "/map.tif", "..\\\\map.tif"])
def test_only_names_in_the_folder_are_files_of_a_run(tmp_path: Path, name: str) -> None:
    path = tmp_path / RECORD
    path.write_text(f'files."{name}" = {{size = 1, crc32 = 1}}')
    with pytest.raises(InputError, match=r"is no name of a file in the folder of the run"):
        read_record(path)


def test_the_mark_of_an_encoding_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / RECORD
    path.write_text('command = "streets"', encoding="utf-8-sig")
    assert read_record(path) == {"command": "streets"}


def test_what_is_no_file_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        for path in (Path("pipe"), Path("socket"), Path("/dev/zero"), tmp_path):
            with pytest.raises(InputError, match="is no file but a folder or device; name the run"):
                read_record(path)
    with pytest.raises(InputError, match="no such file"):
        read_record(tmp_path / "nowhere")
    with pytest.raises(InputError, match="cannot be read"):
        read_record(tmp_path / ("x" * 300))


def test_a_refusal_is_one_line_and_2(tmp_path: Path) -> None:
    path = tmp_path / "a\nb.toml"
    path.write_text("command = 3")
    command = [sys.executable, "-m", "tilepipe", "run", str(path), "--out", str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == f"tilepipe: error: {tmp_path}/a b.toml: command must be a text, not 3; correct it\n"
