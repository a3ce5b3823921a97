"""What a pipeline publishes: layers, declared with all that users and programs want to know of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from tilepipe.io.files.paths import SIDE
from tilepipe.io.vectors.gdal_tables import SUFFIX

GeometryType = Literal["LineString", "MultiLineString", "Polygon", "MultiPolygon", "Point", "MultiPoint"]


@dataclass(frozen=True)
class Column:
    """A column of a table: its dtype, what it means, and its unit (empty for names, numbers and shares)."""

    dtype: str
    meaning: str
    unit: str = ""


@dataclass(frozen=True)
class TableLayer:
    """A table of geometries, written as GeoParquet or in the format that the user asks for.

    Attributes
    ----------
    name
        Name of the file without its suffix.
    geometry
        Type of its geometries: ``Point``, ``LineString``, ``Polygon``, or ``Multi`` before one of them.
    columns
        Its columns by name, in order.
    meaning
        What a row is.
    scored
        Whether ``tilepipe evaluate RUN`` may take it; of several the first that is there.

    Raises
    ------
    ValueError
        When the type of geometry is unknown.
    """

    name: str
    geometry: GeometryType
    columns: Mapping[str, Column]
    meaning: str
    scored: bool = False

    def __post_init__(self) -> None:
        if self.geometry not in get_args(GeometryType):
            known = ", ".join(get_args(GeometryType))
            raise ValueError(f"table '{self.name}' has the geometry '{self.geometry}'; use one of {known}")

    @property
    def dtypes(self) -> dict[str, str]:
        """Dtypes of the columns by name."""
        return {name: column.dtype for name, column in self.columns.items()}

    @property
    def files(self) -> tuple[str, ...]:
        """Names that the file may have."""
        return tuple(self.name + suffix for suffix in SUFFIX.values())


@dataclass(frozen=True)
class RasterLayer:
    """A raster on the pixels of the input, a cloud-optimised GeoTIFF.

    Attributes
    ----------
    name
        Name of the file, which ends in ``.tif``.
    dtype
        Type of its values.
    nodata
        Value where the input has no data.
    meaning
        What a value is.
    """

    name: str
    dtype: str
    nodata: float
    meaning: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the file, and of the one beside it that holds a CRS for which GeoTIFF has no place."""
        return self.name, self.name + SIDE


@dataclass(frozen=True)
class DocumentLayer:
    """A file about the whole run, such as the diagnostics of a sampler as JSON; ``name`` is that of the file."""

    name: str
    meaning: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names that the file may have."""
        return (self.name,)


Layer = TableLayer | RasterLayer | DocumentLayer
