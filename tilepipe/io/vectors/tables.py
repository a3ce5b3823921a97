"""Tables of lines or polygons, read from files or from the folder of a run, and their coordinates in metres."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.ground import TABLES, Bounds, ground_metres
from tilepipe.io.crs.systems import same_crs, split_crs, understood_crs
from tilepipe.io.files.paths import elsewhere, is_local, location
from tilepipe.io.vectors.vector_files import read_vector_file

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

LAYER_OPTIONS = {"truth": "--layer", "result": "--result-layer", "area": "--area-layer"}
"""Options that name the layer of a file of several, by the role of the file."""

LINES = ("LineString", "MultiLineString")
POLYGONS = ("Polygon", "MultiPolygon")


@dataclass(frozen=True)
class VectorLayer:
    """A table of geometries with its name for messages."""

    name: str
    table: GeoDataFrame

    @property
    def types(self) -> set[str]:
        """Types of its geometries that are not empty; none for an empty layer."""
        geometry = self.table.geometry
        return set(geometry.geom_type[~(geometry.isna() | geometry.is_empty)])

    @property
    def metres_per_unit(self) -> float:
        """See `metres_per_unit`."""
        left, bottom, right, top = (float(side) for side in self.table.total_bounds)
        return metres_per_unit(self.table.crs, self.name, (left, bottom, right, top))

    def of(self, types: tuple[str, ...]) -> VectorLayer:
        """Return the layer itself.

        Raises
        ------
        InputError
            It holds geometries of other types.
        """
        if not self.types <= set(types):
            raise InputError(f"the {self.name} holds {', '.join(sorted(self.types))}; give {' or '.join(types)}")
        return self

    def reprojected(self, crs: Any) -> NDArray[np.object_]:
        """Geometries in another CRS; those that are in it already stay as they are.

        Raises
        ------
        InputError
            Some lie where the CRS has no coordinates, or no way leads to it.
        """
        import shapely
        from pyproj.exceptions import ProjError

        other = understood_crs(crs, self.name)
        if same_crs(self.table.crs, other):
            return self.table.geometry.to_numpy()  # type: ignore[no-any-return]
        try:
            geometry: NDArray[np.object_] = self.table.to_crs(other).geometry.to_numpy()
        except ProjError as error:
            raise InputError(
                f"no way leads from the CRS of the {self.name} ({self.table.crs.name}) to {other.name}; "
                "give both in one CRS"
            ) from error
        if not np.isfinite(shapely.get_coordinates(geometry)).all():
            raise InputError(
                f"the {self.name} lies, wholly or in part, where {other.name} has no coordinates; "
                f"check its CRS ({self.table.crs.name}), or cut it to the place"
            )
        return geometry

    def in_metres(self) -> NDArray[np.object_]:
        """Geometries with coordinates in metres; see `in_metres`."""
        return in_metres(self.table.geometry.to_numpy(), self.metres_per_unit)


def read_layer(source: str | os.PathLike[str] | VectorLayer, role: str, layer: str | None = None) -> VectorLayer:
    """Read a vector file (GeoParquet or anything GDAL reads).

    Parameters
    ----------
    source
        The file, or a layer already read.
    role
        What messages call it: ``truth``, ``result`` or ``area``.
    layer
        Name of the layer in a file of several; None for the only one with geometry.

    Raises
    ------
    InputError
        The file is missing or unreadable, names no CRS, or holds several layers and none is named.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.io.vectors.formats import write_table
    >>> from tilepipe.io.vectors.tables import read_layer
    >>> line = shapely.linestrings([[[0, 0], [3, 4]]])
    >>> layer = read_layer(write_table("roads.gpkg", {}, line, "EPSG:2263", "gpkg"), "the truth")
    >>> [round(each.length, 3) for each in layer.in_metres()]  # five US survey feet
    [1.524]
    """
    if isinstance(source, VectorLayer):
        return source
    path, name = Path(source), f"{role} {location(source)}"
    if not is_local(source):
        raise InputError(f"the {name} {elsewhere(source)} and name the file")
    if is_folder(path):
        raise InputError(f"the {name} is a folder; name a file in it")
    if not path.exists():
        raise InputError(f"the {name} does not exist; correct the path")
    table = read_vector_file(path, f"the {name}", layer, LAYER_OPTIONS.get(role, "--layer"))
    if table.crs is None:
        raise InputError(f"the {name} names no CRS; write it into the file (ogr2ogr -a_srs EPSG:n)")
    return VectorLayer(name, table)


def is_folder(path: Path) -> bool:
    """Whether a path is a folder of files, not one dataset as a file geodatabase is."""
    return path.is_dir() and path.suffix.lower() != ".gdb"


def read_vectors(path: Path, role: str, types: tuple[str, ...] = LINES) -> GeoDataFrame:
    """Table of a vector file of given types of geometry; see `read_layer`."""
    return read_layer(path, role).of(types).table


def are_polygons(result: VectorLayer, truth: VectorLayer) -> bool:
    """Whether two layers are to be scored as polygons, not as lines; an empty layer may be either.

    Raises
    ------
    InputError
        One layer holds polygons and the other does not.
    """
    found = result.types | truth.types
    if found & set(LINES) and found & set(POLYGONS):
        both = " and ".join(", ".join(sorted(layer.types)) for layer in (result, truth))
        raise InputError(f"result and truth hold {both}; give two layers of lines, or two of polygons")
    return bool(found & set(POLYGONS))


def metres_per_unit(crs: Any, name: str, bounds: Bounds) -> float:
    """Length on the ground in metres of the unit of a projected CRS, see `tilepipe.io.crs.ground.ground_metres`.

    Parameters
    ----------
    crs
        Anything that pyproj accepts, or None.
    name
        What an error message calls its owner.
    bounds
        Where on the map.

    Raises
    ------
    InputError
        There is no CRS, it is geographic (degrees are no lengths), or its map is stretched unevenly there.

    Examples
    --------
    >>> from tilepipe.io.vectors.tables import metres_per_unit
    >>> metres_per_unit("EPSG:32633", "the truth", (392000, 5819000, 393000, 5820000))
    1.0
    >>> metres_per_unit("EPSG:4326", "the truth", (13, 52, 14, 53))
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: the truth is in longitude and latitude (WGS 84)...
    """
    if crs is None:
        raise InputError(f"{name} names no CRS, so metres are unknown; write the CRS into the file")
    horizontal, _ = split_crs(understood_crs(crs, name))
    if horizontal.is_geographic:
        raise InputError(
            f"{name} is in longitude and latitude ({horizontal.name}), where a buffer in metres has no meaning; "
            "reproject it to metres or feet (ogr2ogr -t_srs EPSG:n), or give the GeoParquet of a run"
        )
    return ground_metres(horizontal, bounds, name, TABLES)


def run_table(folder: Path, name: str) -> Path | None:
    """Find the table `name` in a run's folder, in whatever format it was written, or None."""
    from tilepipe.io.vectors.gdal_tables import SUFFIX

    for suffix in SUFFIX.values():
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    return None


def in_metres(geometry: NDArray[np.object_], metres: float) -> NDArray[np.object_]:
    """Geometries without heights, their coordinates multiplied by the length of the unit in metres.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.io.vectors.tables import in_metres
    >>> [line.wkt for line in in_metres(shapely.from_wkt(["LINESTRING Z (0 0 5, 10 0 5)"]), metres=0.3048)]
    ['LINESTRING (0 0, 3.048 0)']
    """
    import shapely

    scaled: NDArray[np.object_] = shapely.transform(shapely.force_2d(geometry), lambda points: points * metres)
    return scaled
