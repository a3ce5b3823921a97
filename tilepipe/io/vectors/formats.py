"""Write tables of geometries in the formats that GIS read, whole or not at all; same content, same bytes.

GeoParquet is the native format and is written as a stream of batches. The other formats are converted from
the finished GeoParquet file, again batch by batch, so memory does not grow with the table.

Every file is written in a hidden folder beside its final name and renamed when it is whole, so a killed or
failing run leaves nothing under the final name.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.vectors.gdal_tables import DRIVER, SUFFIX, check_format, write_arrow
from tilepipe.io.vectors.geoparquet import ROW_GROUP, TYPE_ID, ParquetWriter

if TYPE_CHECKING:
    import pyarrow as pa


def write_table(
    path: str | os.PathLike[str],
    columns: Mapping[str, ArrayLike],
    geometry: ArrayLike,
    crs: Any,
    format: str = "parquet",
    *,
    geometry_type: str | None = None,
) -> Path:
    """Write one table of geometries with typed columns.

    Parameters
    ----------
    path
        The file to write; it keeps the suffix given.
    columns
        Name -> array (rows,); the dtype decides the column's type, object and str arrays become text.
    geometry
        (rows,) shapely geometries of one type; single and multi parts mixed are written as multi parts.
    crs
        Anything `pyproj.CRS` understands, or None.
    format
        ``"parquet"``, ``"gpkg"``, ``"fgb"`` or ``"geojson"``; GeoJSON is reprojected to EPSG:4326 (RFC 7946).
    geometry_type
        Declared type; needed only for a table without rows.

    Raises
    ------
    InputError
        The file cannot be written, the format is unknown or cannot hold the CRS, or GeoJSON is asked for without one.

    Examples
    --------
    Two streets with their lengths, as a GeoPackage.

    >>> import geopandas
    >>> import shapely
    >>> from tilepipe.io.vectors.formats import write_table
    >>> streets = shapely.linestrings([[[0, 0], [30, 40]], [[0, 0], [60, 80]]])
    >>> path = write_table("streets.gpkg", {"length": [50.0, 100.0]}, streets, "EPSG:32633", "gpkg")
    >>> geopandas.read_file(path).length.tolist()
    [50.0, 100.0]
    """
    path = Path(path)
    check_format(format, crs, str(path))
    rows, geometry_type = _one_type(np.asarray(geometry, dtype=object), geometry_type)
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    types = {name: "string" if a.dtype.kind in "OUT" else a.dtype for name, a in arrays.items()}
    if format == "parquet":
        with ParquetWriter(path, types, crs, geometry_type) as writer:
            writer.append(arrays, rows)
        return path
    with atomic_write(path) as aside:
        parquet = aside.with_name("table.parquet")
        with ParquetWriter(parquet, types, crs, geometry_type) as writer:
            writer.append(arrays, rows)
        _write_converted(parquet, aside, format)
    return path


def convert(
    parquet_path: str | os.PathLike[str], format: str, *, destination: str | os.PathLike[str] | None = None
) -> Path:
    """Convert a GeoParquet file of this module to another format, in batches of `ROW_GROUP` rows.

    GeoJSON is always longitude and latitude on WGS 84 (RFC 7946): coordinates are reprojected to EPSG:4326
    and rounded to 7 decimals (about 1 cm). The other formats keep the CRS.

    Parameters
    ----------
    parquet_path
        The file to convert; it stays as it is.
    format
        ``"gpkg"``, ``"fgb"`` or ``"geojson"``.
    destination
        The file to write; by default the Parquet file's name with the format's suffix.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        The source is missing or no GeoParquet, or the destination cannot be written.

    Examples
    --------
    >>> import json
    >>> import shapely
    >>> from tilepipe.io.vectors.formats import convert, write_table
    >>> path = write_table("trees.parquet", {"height": [12.5]}, shapely.points([[392000, 5820000]]), "EPSG:32633")
    >>> feature = json.loads(convert(path, "geojson").read_text())["features"][0]
    >>> feature["properties"], [round(degrees, 3) for degrees in feature["geometry"]["coordinates"]]
    ({'height': 12.5}, [13.408, 52.519])
    """
    source = Path(parquet_path)
    if format not in DRIVER:
        raise InputError(f"cannot convert to {format!r}; choose one of {', '.join(DRIVER)}")
    if not source.is_file():
        raise InputError(f"{source} does not exist; run the pipeline first or correct the path")
    final = Path(destination) if destination is not None else source.with_suffix(SUFFIX[format])
    if final.exists() and final.samefile(source):
        raise InputError(f"cannot write {final}: it is the table to be converted; choose another name")
    with atomic_write(final) as aside:
        _write_converted(source, aside, format)
    return final


def _write_converted(source: Path, aside: Path, format: str) -> None:
    """Stream `source` (GeoParquet) through GDAL into the file `aside`."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyproj import CRS

    with pq.ParquetFile(source) as file:
        geo = json.loads((file.metadata.metadata or {}).get(b"geo", b"{}"))
        if not geo:
            raise InputError(f"{source} is not GeoParquet (it has no 'geo' metadata); give a file of this program")
        column = geo["columns"][geo["primary_column"]]
        crs = None if column["crs"] is None else CRS.from_json_dict(column["crs"])
        check_format(format, crs, str(source))
        schema = file.schema_arrow
        schema = pa.schema([pa.field(f.name, _portable(f.type), f.nullable) for f in schema])
        batches = (batch.cast(schema) for batch in file.iter_batches(batch_size=ROW_GROUP))
        reader = pa.RecordBatchReader.from_batches(schema, batches)
        write_arrow(reader, aside, format, geo["primary_column"], column["geometry_types"][0], crs)
        _check_converted(aside, format, file.metadata.num_rows)


def _check_converted(path: Path, format: str, rows: int) -> None:
    """Look at the end of a finished file: GDAL reports no error when the last bytes found the disk full."""
    import sqlite3
    from contextlib import closing

    import pyogrio

    if format == "gpkg":
        # The spatial index is made last, and a GeoPackage without one opens as if nothing were missing.
        with closing(sqlite3.connect(path)) as database:
            indexes = database.execute(
                "SELECT COUNT(*) FROM gpkg_extensions WHERE extension_name = 'gpkg_rtree_index'"
            ).fetchone()[0]
        whole = indexes == 1 and pyogrio.read_info(path)["features"] == rows
    elif format == "fgb":
        last = pyogrio.raw.read(path, skip_features=max(rows - 1, 0), max_features=1)
        whole = len(last[2]) == min(rows, 1)
    else:
        with open(path, "rb") as file:
            file.seek(-5, os.SEEK_END)
            whole = file.read() == b"\n]\n}\n"
    if not whole:
        raise OSError(errno.ENOSPC, "the file is incomplete", str(path))


def _one_type(geometry: NDArray[np.object_], declared: str | None) -> tuple[NDArray[np.object_], str]:
    """Return the geometries and their one type, single parts lifted to multi parts where both occur."""
    import shapely

    names = {number: name for name, number in TYPE_ID.items()}
    found = {names.get(number, "") for number in shapely.get_type_id(geometry).tolist()}
    wanted = declared or max(found, key=len, default=None)
    if wanted is None:
        raise ValueError("a table without rows needs geometry_type, such as 'LineString'")
    if found <= {wanted}:
        return geometry, wanted
    if not wanted.startswith("Multi") or not found <= {wanted, wanted.removeprefix("Multi")}:
        raise ValueError(f"the table mixes geometry types {sorted(found)}; write one table per type")
    make: Any = {
        "MultiPoint": shapely.multipoints,
        "MultiLineString": shapely.multilinestrings,
        "MultiPolygon": shapely.multipolygons,
    }[wanted]
    single = shapely.get_type_id(geometry) != TYPE_ID[wanted]
    lifted = geometry.copy()
    lifted[single] = [make([part]) for part in geometry[single]]
    return lifted, wanted


def _portable(kind: pa.DataType) -> pa.DataType:
    """Return the type a GDAL layer can hold without loss; the cast refuses uint64 beyond int64."""
    import pyarrow as pa

    wider = {
        pa.uint8(): pa.int16(),
        pa.uint16(): pa.int32(),
        pa.uint32(): pa.int64(),
        pa.uint64(): pa.int64(),
    }
    return wider.get(kind, kind)
