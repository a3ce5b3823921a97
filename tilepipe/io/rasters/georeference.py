"""Where pixels lie on the ground, and the refusal of everything that could go silently wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.degrees import utm_zone
from tilepipe.io.crs.systems import check_named_crs, crs_text, map_unit, split_crs, understood_crs
from tilepipe.io.crs.units import SOME_UNITS, axis_metres, unit_metres

ROUNDING = 1e-2
"""Largest displacement that is taken for rounding, in pixels: of tiles to each other, or of a corner by rotation."""


@dataclass(frozen=True)
class Geometry:
    """Where the pixels of a raster lie: north-up grid of square pixels in a projected CRS.

    ``left``, ``top`` are the coordinates of the upper left corner and ``pixel`` is the pixel size, in CRS units;
    ``metres`` is the length of one CRS unit on the ground in metres, and ``height_metres`` that of one unit of heights,
    should the values be heights; ``unknown_unit`` is the name of a unit of the values that is no known length.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.rasters.georeference import Geometry
    >>> foot = 0.3048
    >>> geometry = Geometry("EPSG:2222", 600000, 900000, 1.5, (2000, 3000), metres=foot, height_metres=foot)
    >>> round(geometry.resolution, 4)  # metres, of 1.5 feet
    0.4572
    >>> geometry.coordinates(np.array([[0, 0], [2000, 3000]])).tolist()  # upper left and lower right corner
    [[600000.0, 900000.0], [604500.0, 897000.0]]
    """

    crs: str
    left: float
    top: float
    pixel: float
    shape: tuple[int, int]
    metres: float
    height_metres: float
    unknown_unit: str | None = None

    @property
    def resolution(self) -> float:
        """Ground size of a pixel in metres."""
        return self.pixel * self.metres

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) of rasterio for this grid."""
        return self.pixel, 0.0, self.left, 0.0, -self.pixel, self.top

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top in CRS units."""
        rows, columns = self.shape
        return self.left, self.top - rows * self.pixel, self.left + columns * self.pixel, self.top

    def check_heights(self, name: str) -> None:
        """Refuse values as heights whose unit is no known length; ``name`` is that of the source.

        Raises
        ------
        InputError
            Says which units are known.
        """
        if self.unknown_unit is not None:
            raise InputError(
                f"{name}: its heights are in '{self.unknown_unit}', which is no known unit of length; name one with "
                f"gdal_edit -units (in an array: its attribute units): {SOME_UNITS}"
            )

    def coordinates(self, vertices: NDArray[Any]) -> NDArray[np.float64]:
        """Map coordinates x, y of rows and columns counted from the upper left corner of the first pixel."""
        row, column = vertices.astype(np.float64).T
        a, b, c, d, e, f = self.transform
        return np.stack([a * column + b * row + c, d * column + e * row + f], axis=1)


def check_geometry(
    name: str,
    crs: object,
    transform: Sequence[float],
    shape: tuple[int, int],
    override: str | None,
    unit: str | None = None,
) -> Geometry:
    """Turn a CRS and an affine transform into a `Geometry`, refusing what the pipelines cannot use.

    Parameters
    ----------
    name
        Name of the source for messages.
    crs
        Anything pyproj accepts, or None.
    transform
        Affine coefficients (a, b, c, d, e, f).
    shape
        Rows and columns.
    override
        CRS to use when ``crs`` is None; must be the same otherwise.
    unit
        Unit of the values, as the source names it. Heights are in it where it is a length, else in the unit of the
        vertical axis of the CRS, else in that of its horizontal axes.

    Raises
    ------
    InputError
        See `open_raster`.

    Examples
    --------
    >>> from tilepipe.io.rasters.georeference import check_geometry
    >>> check_geometry("a.tif", "EPSG:32633", (0.5, 0, 392000, 0, -0.5, 5820000), (100, 100), None).shape
    (100, 100)
    >>> check_geometry("b.tif", "EPSG:4326", (0.1, 0, 13, 0, -0.1, 52), (100, 100), None)
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: b.tif: is in degrees (WGS 84); reproject it to a projected CRS first...
    """
    a, b, c, d, e, f = transform[:6]
    if crs is None and override is None:
        raise InputError(f"{name}: has no coordinate reference system; pass --crs EPSG:n (crs='EPSG:n')")
    system, vertical = split_crs(understood_crs(crs if crs is not None else override, name))
    given_vertical = None
    if override is not None:
        given, given_vertical = split_crs(understood_crs(override, "--crs"))
        system = check_named_crs(name, system, given)
    height_metres = unit_metres(unit)
    # a unit that the user names by the CRS stands for one that nobody knows
    unknown = unit if unit and height_metres is None and given_vertical is None else None
    vertical = vertical or given_vertical
    if system.is_geocentric or system.is_vertical:
        raise InputError(f"{name}: {system.name} is no map projection; reproject it to a projected CRS first")
    if system.is_geographic:
        raise InputError(
            f"{name}: is in degrees ({system.name}); reproject it to a projected CRS first, for example with: "
            f"rio warp IN OUT --dst-crs {utm_zone(c, f)} --dst-nodata 0"
        )
    if max(abs(b) * shape[0], abs(d) * shape[1]) > ROUNDING * abs(a):
        raise InputError(f"{name}: is rotated; resample it north-up first, for example with gdalwarp")
    if not (a > 0 and e < 0):
        raise InputError(f"{name}: is not north-up; resample it first, for example with gdalwarp")
    if abs(a + e) > 1e-6 * a:
        raise InputError(f"{name}: pixels are not square ({a} × {-e}); resample it with gdalwarp -tr {a} {a}")
    if min(shape) < 3:
        raise InputError(f"{name}: is {shape[1]} × {shape[0]} pixels; at least 3 × 3 are needed")
    metres = map_unit(system)
    if height_metres is None:
        height_metres = axis_metres(vertical) if vertical else metres
    return Geometry(crs_text(system), float(c), float(f), float(a), shape, metres, height_metres, unknown)
