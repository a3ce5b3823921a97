"""Readers of tables of geometries: GeoParquet, and what GDAL reads."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import numpy as np
import pyarrow.parquet as pq
import shapely

from tests.fuzz.mutations import mutated_bytes, mutated_json, mutated_text
from tests.fuzz.reader import Reader
from tilepipe.io.vectors.formats import write_table
from tilepipe.io.vectors.tables import read_layer

_LINES = np.array([shapely.LineString([(392000, 5820000), (392009, 5820005)]), shapely.LineString([(0, 0), (1, 1)])])
_COLUMNS = {"width": np.array([12.0, 3.5]), "kind": np.array([1, 2])}


def _read(path: Path) -> None:
    layer = read_layer(path, "truth").of(("LineString", "MultiLineString", "Polygon", "MultiPolygon"))
    if len(layer.table):
        layer.in_metres()
        layer.reprojected("EPSG:32633")


def _written(folder: Path, format: str) -> bytes:
    return write_table(folder / f"lines.{format}", _COLUMNS, _LINES, "EPSG:32633", format).read_bytes()


def _parquets(folder: Path) -> list[bytes]:
    """Whole files, and metadata ``geo`` alone, which the reader puts into a file."""
    whole = _written(folder, "parquet")
    return [whole, pq.read_schema(folder / "lines.parquet").metadata[b"geo"]]


def _read_parquet(content: bytes, folder: Path) -> None:
    path = folder / "a.parquet"
    if content[:1] == b"{":
        _written(folder, "parquet")
        table = pq.read_table(folder / "lines.parquet")
        pq.write_table(table.replace_schema_metadata({b"geo": content}), path)
    else:
        path.write_bytes(content)
    _read(path)


def _mutated_parquet(content: bytes, random: Random) -> bytes:
    return mutated_json(content, random) if content[:1] == b"{" else mutated_bytes(content, random)


def _tables(folder: Path) -> list[bytes]:
    # of old GeoJSON, for that of today is in degrees, which have no length
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32633"}}
    projected = json.loads(_written(folder, "geojson")) | {"crs": crs}
    return [_written(folder, "gpkg"), _written(folder, "fgb"), json.dumps(projected).encode()]


def _read_table(content: bytes, folder: Path) -> None:
    suffix = "gpkg" if content[:6] == b"SQLite" else "fgb" if content[:3] == b"fgb" else "geojson"
    path = folder / f"a.{suffix}"
    path.write_bytes(content)
    _read(path)


def _mutated_table(content: bytes, random: Random) -> bytes:
    if content[:1] == b"{":
        return mutated_json(content, random)
    if content[:6] == b"SQLite" and random.random() < 0.5:
        # most of the file is empty; what is not are texts and small numbers
        used = [place for place in range(0, len(content), 64) if any(content[place : place + 64])]
        place = random.choice(used)
        piece = mutated_text(content[place : place + 64], random)[:64].ljust(64)
        return content[:place] + piece + content[place + 64 :]
    return mutated_bytes(content, random)


READERS = (
    Reader("parquet", _parquets, _read_parquet, _mutated_parquet),
    Reader("table", _tables, _read_table, _mutated_table),
)
