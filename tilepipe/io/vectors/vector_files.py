"""One table of geometries out of a vector file, which may hold several layers, whatever its format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tilepipe.errors import InputError

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

_PARQUET = b"PAR1"
"""First bytes of a Parquet file, whatever it is called."""


def read_vector_file(path: Path, name: str, layer: str | None, option: str) -> GeoDataFrame:
    """Read the layer of a GeoParquet file, or of anything that GDAL reads.

    Parameters
    ----------
    path
        A file, or the folder of a file geodatabase.
    name
        What messages call it.
    layer
        Name of the layer; None for the only one with geometry.
    option
        What messages call the option that names the layer.

    Raises
    ------
    InputError
        The file cannot be read, holds no geometry or no such layer, or holds several and none is named.

    Examples
    --------
    >>> from pathlib import Path
    >>> import geopandas
    >>> import shapely
    >>> from tilepipe.io.vectors.vector_files import read_vector_file
    >>> lines = geopandas.GeoDataFrame(geometry=[shapely.LineString([(0, 0), (3, 4)])], crs="EPSG:32633")
    >>> lines.to_file("town.gpkg", layer="fences")
    >>> lines.to_file("town.gpkg", layer="streets", mode="a")
    >>> len(read_vector_file(Path("town.gpkg"), "the truth", "streets", "--layer"))
    1
    >>> read_vector_file(Path("town.gpkg"), "the truth", None, "--layer")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: the truth holds the layers 'fences', 'streets'; choose one with --layer NAME
    """
    import geopandas

    unreadable = (
        f"{name} cannot be read as lines or polygons; give a layer of a run, or another "
        "GeoParquet, GeoPackage, FlatGeobuf or GeoJSON file"
    )
    try:
        if _is_parquet(path):
            if layer is not None:
                raise InputError(f"{name} has no layers, being Parquet; leave {option} out")
            return _read_parquet(path, name)
        table = geopandas.read_file(path, layer=_chosen_layer(path, name, layer, option))
    except InputError:
        raise
    except Exception as error:
        raise InputError(unreadable) from error
    if not isinstance(table, geopandas.GeoDataFrame):
        raise InputError(f"{name} holds no geometry; give a layer of lines or polygons")
    return table


def _is_parquet(path: Path) -> bool:
    if path.is_dir():
        return False
    with open(path, "rb") as file:
        return file.read(len(_PARQUET)) == _PARQUET


def _read_parquet(path: Path, name: str) -> GeoDataFrame:
    import geopandas
    import pyarrow.parquet as pq

    if b"geo" not in (pq.read_schema(path).metadata or {}):
        raise InputError(
            f"{name} is Parquet without 'geo' metadata, so that its geometry and CRS are unknown; write it as "
            "GeoParquet, such as with geopandas or ogr2ogr"
        )
    return geopandas.read_parquet(path)


def _chosen_layer(path: Path, name: str, layer: str | None, option: str) -> str:
    """Name of the layer to read: that asked for, or the only one with geometry."""
    import pyogrio

    kinds: dict[str, str | None] = {str(each): kind for each, kind in pyogrio.list_layers(path)}
    with_geometry = [each for each, kind in kinds.items() if kind is not None]
    listed = ", ".join(repr(each) for each in with_geometry)
    if not with_geometry:
        raise InputError(f"{name} holds no geometry; give a layer of lines or polygons")
    if layer is not None:
        if layer not in with_geometry:
            wrong = "has no geometry" if layer in kinds else "is not among them"
            raise InputError(f"{name} holds the layers {listed}; {layer!r} {wrong}: choose one with {option} NAME")
        return layer
    if len(with_geometry) > 1:
        raise InputError(f"{name} holds the layers {listed}; choose one with {option} NAME")
    return with_geometry[0]
