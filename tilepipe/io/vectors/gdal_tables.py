"""The formats of tables that GDAL writes, and which CRS each of them holds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from tilepipe.errors import InputError
from tilepipe.io.crs.degrees import check_degrees
from tilepipe.io.crs.systems import same_crs, understood_crs

if TYPE_CHECKING:
    import pyarrow as pa
    from pyproj import CRS

SUFFIX = {"parquet": ".parquet", "gpkg": ".gpkg", "fgb": ".fgb", "geojson": ".geojson"}
DRIVER = {"gpkg": "GPKG", "fgb": "FlatGeobuf", "geojson": "GeoJSON"}

# GeoPackage stores the time of the last change; a constant one keeps equal content equal in bytes.
_CONSTANT_TIME = "2000-01-01T00:00:00Z"


def write_arrow(
    reader: pa.RecordBatchReader, path: Path, format: str, geometry_name: str, geometry_type: str, crs: CRS | None
) -> None:
    """Write batches of rows in a format of GDAL."""
    import pyogrio

    options = {
        "gpkg": {"ASPATIAL_VARIANT": "GPKG_ATTRIBUTES"},
        "fgb": {"TEMPORARY_DIR": str(path.parent)},
        "geojson": {"RFC7946": "YES"},
    }[format]
    with _gdal_options(OGR_CURRENT_DATE=_CONSTANT_TIME):
        pyogrio.write_arrow(
            reader,
            path,
            layer=path.stem,
            driver=DRIVER[format],
            geometry_name=geometry_name,
            geometry_type=geometry_type,
            crs=None if crs is None else crs.to_wkt(),
            **options,
        )


def check_format(format: str, crs: Any, name: str) -> None:
    """Refuse a format of tables that cannot hold a CRS, before any table is made.

    Parameters
    ----------
    format
        ``"parquet"``, ``"gpkg"``, ``"fgb"`` or ``"geojson"``.
    crs
        Anything `pyproj.CRS` understands, or None.
    name
        What has the CRS, for messages.

    Raises
    ------
    InputError
        The format is unknown; or no way is known from the CRS to the longitude and latitude of GeoJSON; or the CRS is
        read back from the format as another.

    Examples
    --------
    GDAL takes kilometres for metres in some formats.

    >>> from tilepipe.io.vectors.gdal_tables import check_format
    >>> check_format("gpkg", "EPSG:28992", "a.tif")
    >>> check_format("gpkg", "+proj=utm +zone=31 +datum=WGS84 +units=km", "a.tif")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: a.tif: gpkg files cannot hold its CRS (unknown), GDAL reads WGS 84 / UTM zone 31N fro...
    """
    from pyproj import CRS

    if format not in SUFFIX:
        raise InputError(f"unknown format {format!r}; choose one of {', '.join(SUFFIX)}")
    if crs is None:
        if format == "geojson":
            raise InputError("GeoJSON needs longitude and latitude, but the data name no CRS; give --crs EPSG:n")
        return
    given = understood_crs(crs, name)
    if format == "geojson":
        check_degrees(given, name)
        return
    read = CRS.from_json_dict(given.to_json_dict()) if format == "parquet" else _read_back(format, given)
    if not same_crs(read, given):
        raise InputError(
            f"{name}: {format} files cannot hold its CRS ({given.name}), GDAL reads {read.name} from them; "
            "use --format parquet"
        )


def _read_back(format: str, crs: CRS) -> CRS:
    """CRS of a table without rows in a format, as it is read back."""
    import pyarrow as pa
    import pyogrio
    import pyproj

    schema = pa.schema([pa.field("geometry", pa.binary())])
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"table{SUFFIX[format]}"
        write_arrow(pa.RecordBatchReader.from_batches(schema, []), path, format, "geometry", "Point", crs)
        return pyproj.CRS(pyogrio.read_info(path)["crs"])


@contextmanager
def _gdal_options(**options: str) -> Iterator[None]:
    """Set options of pyogrio's GDAL for the length of a block."""
    import pyogrio

    before = {name: pyogrio.get_gdal_config_option(name) for name in options}
    pyogrio.set_gdal_config_options(options)
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options(before)
