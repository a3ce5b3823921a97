"""Stream tables of geometries into GeoParquet, with bytes that do not depend on the batches."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.vectors.geometries import checked_polylines
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.wkb import line_strings as wkb_line_strings

if TYPE_CHECKING:
    import pyarrow as pa

ROW_GROUP = 65536
GEOMETRY = "geometry"

_NOWHERE = np.full(4, np.nan)

# GeoParquet's names of the geometry types and the numbers shapely gives them.
TYPE_ID = {
    "Point": 0,
    "LineString": 1,
    "Polygon": 3,
    "MultiPoint": 4,
    "MultiLineString": 5,
    "MultiPolygon": 6,
}


class ParquetWriter:
    """Stream a table with one geometry column into a GeoParquet 1.1 file.

    The bytes depend on the rows and their order only, not on how they are split into batches: rows are held
    back until a row group of exactly `ROW_GROUP` rows is full. The file appears when the ``with`` block
    ends well.

    Parameters
    ----------
    path
        The file to write.
    column_types
        Name -> numpy dtype (or ``"string"``) of each attribute column, in file order.
    crs
        Anything `pyproj.CRS` understands; None writes an unknown CRS.
    geometry_type
        GeoParquet name of the one geometry type of the table, such as ``"LineString"``.

    Notes
    -----
    NaN in a float column means "no value" and is written as null.

    Examples
    --------
    >>> import geopandas
    >>> import shapely
    >>> from tilepipe.io.vectors.geoparquet import ParquetWriter
    >>> with ParquetWriter("trees.parquet", {"height": "float32"}, "EPSG:32633", geometry_type="Point") as writer:
    ...     writer.append({"height": [12.5]}, shapely.points([[392000, 5820000]]))
    ...     writer.append({"height": [float("nan")]}, shapely.points([[392010, 5820000]]))
    >>> geopandas.read_parquet("trees.parquet")["height"].isna().tolist()
    [False, True]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        column_types: Mapping[str, Any],
        crs: Any,
        geometry_type: str = "LineString",
    ) -> None:
        import pyarrow as pa

        if GEOMETRY in column_types:
            raise ValueError(f"{GEOMETRY!r} is the name of the geometry column; rename the attribute")
        fields = [pa.field(name, _arrow_type(kind)) for name, kind in column_types.items()]
        self.schema = pa.schema([*fields, pa.field(GEOMETRY, pa.binary(), nullable=False)])
        self.path = Path(path)
        self.rows = 0
        self._crs = crs
        self._geometry_type = geometry_type
        self._bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
        self._waiting: list[pa.Table] = []
        self._waiting_rows = 0

    def __enter__(self) -> Self:
        import pyarrow.parquet as pq

        self._aside = atomic_write(self.path)
        path = self._aside.__enter__()
        try:
            # Our own handle: pyarrow leaves its file open when closing fails on a full disk.
            self._sink: BinaryIO = open(path, "wb")
            self._file = pq.ParquetWriter(
                self._sink,
                self.schema,
                compression="zstd",
                use_dictionary=[field.name for field in self.schema if _is_text(field.type)],
                store_schema=False,
            )
        except BaseException as error:
            self._aside.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._write_row_groups(all_rows=True)
                self._file.add_key_value_metadata({"geo": json.dumps(self._geo_metadata(), sort_keys=True)})
        except Exception as failure:
            error = failure
        for close in (self._file.close, self._sink.close):
            try:
                close()
            except Exception as failure:
                error = error or failure
        self._aside.__exit__(type(error) if error else None, error, error.__traceback__ if error else None)
        if error is not None and kind is None:
            raise error

    def append(self, columns: Mapping[str, ArrayLike], geometry: NDArray[np.object_]) -> None:
        """Append one row per geometry.

        Parameters
        ----------
        columns
            Name -> array (rows,) for every declared column; converted only where no value changes.
        geometry
            (rows,) shapely geometries of the declared type, none of them missing.

        Raises
        ------
        ValueError
            Columns are missing, unknown, of the wrong length, or do not fit the declared type.
        """
        import pyarrow as pa
        import shapely

        found = set(shapely.get_type_id(geometry).tolist())
        if not found <= {TYPE_ID[self._geometry_type]}:
            raise ValueError(f"this table holds {self._geometry_type} only; the batch has other or missing geometries")
        encoded = pa.array(shapely.to_wkb(geometry, byte_order=1), pa.binary())
        self._append(columns, encoded, shapely.total_bounds(geometry) if len(geometry) else _NOWHERE)

    def _append(self, columns: Mapping[str, ArrayLike], encoded: pa.Array, bounds: NDArray[np.float64]) -> None:
        """Append rows whose geometries are encoded as WKB and lie within bounds."""
        import pyarrow as pa

        names = [name for name in self.schema.names if name != GEOMETRY]
        if set(columns) != set(names):
            raise ValueError(f"the table has the columns {names}, the batch has {sorted(columns)}; give the same")
        arrays = []
        for name in names:
            values = np.asarray(columns[name])
            if values.shape != (len(encoded),):
                raise ValueError(f"column {name!r} has shape {values.shape}, expected ({len(encoded)},)")
            try:
                # a mask instead of from_pandas, which would import pandas
                missing = np.isnan(values) if values.dtype.kind == "f" else None
                arrays.append(pa.array(values, mask=missing).cast(self.schema.field(name).type))
            except pa.ArrowException as error:
                raise ValueError(f"column {name!r} does not fit its declared type: {error}") from error
        if len(encoded) == 0:
            return
        arrays.append(encoded)
        self._bounds[:2] = np.fmin(self._bounds[:2], bounds[:2])
        self._bounds[2:] = np.fmax(self._bounds[2:], bounds[2:])
        self._waiting.append(pa.table(arrays, schema=self.schema))
        self._waiting_rows += len(encoded)
        self.rows += len(encoded)
        if self._waiting_rows >= ROW_GROUP:
            self._write_row_groups(all_rows=False)

    def _write_row_groups(self, *, all_rows: bool) -> None:
        import pyarrow as pa

        if not self._waiting:
            return
        table = pa.concat_tables(self._waiting).combine_chunks()
        end = table.num_rows if all_rows else table.num_rows - table.num_rows % ROW_GROUP
        for start in range(0, end, ROW_GROUP):
            # Page limits follow the chunks of the array given, hence one chunk per row group.
            group = table.slice(start, min(ROW_GROUP, end - start)).combine_chunks()
            self._file.write_table(group, row_group_size=ROW_GROUP)
        rest = table.slice(end)
        self._waiting = [rest] if rest.num_rows else []
        self._waiting_rows = rest.num_rows

    def _geo_metadata(self) -> dict[str, Any]:
        """Return the ``geo`` entry of the file: https://geoparquet.org/releases/v1.1.0/."""
        from pyproj import CRS

        column: dict[str, Any] = {
            "encoding": "WKB",
            "geometry_types": [self._geometry_type],
            "crs": None if self._crs is None else CRS.from_user_input(self._crs).to_json_dict(),
        }
        if np.isfinite(self._bounds).all():
            column["bbox"] = self._bounds.tolist()
        return {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}


class ParquetLineWriter:
    """Stream a table of polylines into a GeoParquet 1.1 file.

    Parameters and behaviour are those of `ParquetWriter`, with LineString as the geometry type.

    Examples
    --------
    >>> import geopandas
    >>> import numpy as np
    >>> from tilepipe.io.vectors.geoparquet import ParquetLineWriter
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> line = Polylines(np.array([0, 2]), np.array([[0.0, 0.0], [30.0, 40.0]]))
    >>> with ParquetLineWriter("streets.parquet", {"width": "float32"}, "EPSG:32633") as writer:
    ...     writer.append({"width": [12.0]}, line)
    >>> geopandas.read_parquet("streets.parquet").length.tolist()
    [50.0]
    """

    def __init__(self, path: str | os.PathLike[str], column_types: Mapping[str, Any], crs: Any) -> None:
        self._table = ParquetWriter(path, column_types, crs, "LineString")

    @property
    def rows(self) -> int:
        """Number of lines appended so far."""
        return self._table.rows

    def __enter__(self) -> Self:
        self._table.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._table.__exit__(kind, error, trace)

    def append(self, columns: Mapping[str, ArrayLike], lines: Polylines) -> None:
        """Append one row per line.

        Parameters
        ----------
        columns
            Name -> array (lines,) for every declared column.
        lines
            With vertices (x, y) in the table's CRS, float64.

        Raises
        ------
        ValueError
            Shapes do not match, a line has fewer than two vertices, or a coordinate is not finite.
        """
        lines = checked_polylines(lines)
        count = len(lines)
        arrays: dict[str, NDArray[Any]] = {name: np.asarray(values) for name, values in columns.items()}
        for name, array in arrays.items():
            if array.shape != (count,):
                raise ValueError(f"column {name!r} has shape {array.shape}, expected ({count},)")
        # in parts, since the bytes of one array of arrow are counted in 31 bits
        for first in range(0, max(count, 1), ROW_GROUP):
            part = slice(first, min(first + ROW_GROUP, count))
            within = lines.offsets[part.start : part.stop + 1]
            points = lines.vertices[within[0] : within[-1]]
            bounds = np.concatenate([points.min(axis=0), points.max(axis=0)]) if len(points) else _NOWHERE
            rows = {name: array[part] for name, array in arrays.items()}
            self._table._append(rows, _encoded(Polylines(within - within[0], points)), bounds)


def _encoded(polylines: Polylines) -> pa.Array:
    """LineStrings as little-endian WKB."""
    import pyarrow as pa

    ends, wkb = wkb_line_strings(polylines)
    if ends[-1] > np.iinfo(np.int32).max:
        raise ValueError("lines are too long for one batch; append fewer of them at a time")
    buffers = [None, pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(wkb)]
    return pa.Array.from_buffers(pa.binary(), len(polylines), buffers)


def _is_text(kind: pa.DataType) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(kind))


def _arrow_type(kind: Any) -> pa.DataType:
    import pyarrow as pa

    return pa.string() if isinstance(kind, str) and kind == "string" else pa.from_numpy_dtype(np.dtype(kind))
