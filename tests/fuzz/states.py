"""Readers of tilepipe's own files: records of runs, facts of tiles, intermediate rasters."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

import numpy as np

from tests.fuzz.mutations import mutated_bytes, mutated_json, mutated_text
from tests.fuzz.reader import Reader, assert_one_line
from tilepipe.engine.run_folder import FILES, IDENTITY, is_finished, known_files, read_identity, status
from tilepipe.engine.tiles.facts_file import count_rows, pack, read_facts
from tilepipe.engine.tiles.state import StateArray
from tilepipe.errors import InputError
from tilepipe.io.files.manifest import Written, read_manifest, write_manifest
from tilepipe.io.files.record import PICTURES, RECORD, STATE, as_toml, read_record
from tilepipe.report.finished_run import open_folder
from tilepipe.tiling.grid import TileGrid, Window

_TOKEN = "0" * 32

_RECORD = {
    "command": "streets",
    "version": "0.1.0",
    "out": "run",
    "inputs": {"intensity": ["a.tif", "b.tif"], "crs": "EPSG:32633", "band": 1},
    "raster": {"shape": [20, 30], "tile": [64, 64], "crs": "EPSG:32633", "left": 392000.0, "top": 5820000.0}
    | {"pixel": 0.5, "metres": 1.0, "height_metres": 1.0},
    "options": {"workers": 1, "memory": "2GiB", "executor": "threads", "backend": "numpy", "format": "parquet"},
    "parameters": {"street_width": [5.0, 30.0], "threshold": 0.5, "name": "a\nb"},
    "files": {"streets.tif": {"size": 5, "crc32": 7}},
}


def _records(folder: Path) -> list[bytes]:
    write_manifest(folder / FILES, [Written("streets.tif", size=5, crc32=7)])
    identity = {"token": _TOKEN, "identity": {"pipeline": "streets", "files": ["5 7 - a.tif"]}}
    log = {"files": [{"streets.tif": {"size": 5, "crc32": 7}}, {RECORD: {"size": 5, "crc32": 7}}]}
    return [as_toml(_RECORD), (folder / FILES).read_bytes(), as_toml(identity), as_toml(log)]


def _read_records(content: bytes, folder: Path) -> None:
    """A content as each of the files of TOML in the folder of a run, finished or not."""
    state = folder / STATE
    (state / _TOKEN).mkdir(parents=True)
    valid = {RECORD: as_toml({"command": "streets"}), IDENTITY: as_toml({"token": _TOKEN, "identity": {}})}
    readers: tuple[Callable[[Path], object], ...] = (
        read_record,
        read_manifest,
        lambda _: known_files(folder),
        lambda _: is_finished(folder),
        lambda _: read_identity(state),
        lambda _: status(folder),
        lambda _: open_folder(folder, None),
    )
    for file in (folder / RECORD, folder / PICTURES, state / RECORD, state / IDENTITY, state / FILES):
        for name, text in valid.items():
            (state / name).write_bytes(text)
        file.write_bytes(content)
        for read in readers:
            try:
                read(file)
            except InputError as error:
                # what is one kind of file is none of the others
                assert_one_line(error)
        file.unlink()


_ARRAYS = {
    "top": np.arange(6, dtype=np.int64).reshape(3, 2),
    "count": np.array([7], np.uint32),
    "none": np.zeros((0, 3)),
}


def _facts(folder: Path) -> list[bytes]:
    return [b"".join(pack(_ARRAYS)), b"".join(pack({}))]


def _read_facts(content: bytes, folder: Path) -> None:
    """A content as it is, and under its right checksum, so that what stands behind it is read."""
    sealed = zlib.crc32(content[4:]).to_bytes(4, "little") + content[4:]
    refused = None
    for name, data in (("as-it-is", content), ("sealed", sealed)):
        path = folder / name
        path.write_bytes(data)
        for read in (read_facts, count_rows):
            try:
                read(path)
            except ValueError as error:
                refused = error
    if refused is not None:
        raise refused


def _mutated_facts(content: bytes, random: Random) -> bytes:
    size = int.from_bytes(content[4:8], "little")
    header, arrays = content[8 : 8 + size], content[8 + size :]
    if random.random() < 0.3:
        return mutated_bytes(content, random)
    header = mutated_json(header, random)
    return content[:4] + len(header).to_bytes(4, "little") + header + arrays


_GRID = TileGrid((8, 12), (8, 6))


def _array(path: Path) -> StateArray:
    return StateArray(path, _GRID, "uint32")


def _states(folder: Path) -> list[bytes]:
    """Description of an array, a line feed, and the bytes of a chunk."""
    array = _array(folder / "ids")
    array.create()
    array.write(_GRID.tile(0), np.full((8, 6), 7, np.uint32))
    description = json.dumps(json.loads((array.path / "zarr.json").read_bytes())).encode()
    return [description + b"\n" + (array.path / "c" / "0" / "0").read_bytes()]


def _read_state(content: bytes, folder: Path) -> None:
    """Whatever stands there, what is created can be written and read; a damaged chunk is an error or other values."""
    description, _, chunk = content.partition(b"\n")
    array = _array(folder / "ids")
    (array.path / "c" / "0").mkdir(parents=True)
    (array.path / "c" / "0" / "0").write_bytes(chunk)
    (array.path / "zarr.json").write_bytes(description)
    array.create()
    # as `passes` does, which computes the tile again
    with suppress(Exception):
        array.checksum(_GRID.tile(0))
    array.write(_GRID.tile(1), np.full((8, 6), 9, np.uint32))
    assert (array.read(Window(0, 6, 8, 12)) == 9).all()


def _mutated_state(content: bytes, random: Random) -> bytes:
    description, _, chunk = content.partition(b"\n")
    if random.random() < 0.8:
        return mutated_json(description, random).replace(b"\n", b" ") + b"\n" + chunk
    return description + b"\n" + mutated_bytes(chunk, random)


READERS = (
    Reader("record", _records, _read_records, mutated_text),
    Reader("facts", _facts, _read_facts, _mutated_facts, ValueError),
    Reader("state", _states, _read_state, _mutated_state),
)
