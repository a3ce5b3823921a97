"""Where pixels lie on the ground, and the refusal of everything that could go silently wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError

if TYPE_CHECKING:
    from pyproj import CRS
    from pyproj._crs import Axis

_UNITS = {
    1.0: "m metre metres meter meters",
    0.01: "cm centimetre centimetres centimeter centimeters",
    0.001: "mm millimetre millimetres millimeter millimeters",
    0.3048: "ft foot feet international_foot international_feet",
    1200 / 3937: "us_ft ft_us ftus usft us_foot us_feet us_survey_foot us_survey_feet survey_foot survey_feet sfoot",
}
_METRES = {name: metres for metres, names in _UNITS.items() for name in names.split()}
"""Length in metres of the units that rasters name."""

ROUNDING = 1e-2
"""Largest displacement that is taken for rounding, in pixels: of tiles to each other, or of a corner by rotation."""

_SAME_UNIT = 1e-9
"""Largest relative difference of two spellings of one unit."""


@dataclass(frozen=True)
class Geometry:
    """Where the pixels of a raster lie: north-up grid of square pixels in a projected CRS.

    ``left``, ``top`` are the coordinates of the upper left corner and ``pixel`` is the pixel size, in CRS units;
    ``metres`` is the length of one CRS unit in metres, and ``height_metres`` that of one unit of heights, should the
    values be heights.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.georeference import Geometry
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

    @property
    def resolution(self) -> float:
        """Ground size of a pixel in metres."""
        return self.pixel * self.metres

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) of rasterio for this grid."""
        return self.pixel, 0.0, self.left, 0.0, -self.pixel, self.top

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
    >>> from tilepipe.io.georeference import check_geometry
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
    system, vertical = split_crs(_understood(crs if crs is not None else override, name))
    if crs is not None and override is not None:
        given, given_vertical = split_crs(_understood(override, "--crs"))
        check_named_crs(name, system, given)
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
    metres = float(system.axis_info[0].unit_conversion_factor) if system.axis_info else 1.0
    authority = system.to_authority(min_confidence=100)
    text = ":".join(authority) if authority else system.to_wkt()
    height_metres = unit_metres(unit) or (float(vertical.unit_conversion_factor) if vertical else metres)
    return Geometry(text, float(c), float(f), float(a), shape, metres, height_metres)


def _understood(crs: object, name: str) -> CRS:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(f"{name}: CRS '{crs}' is not understood; pass --crs EPSG:n") from error


def split_crs(crs: CRS) -> tuple[CRS, Axis | None]:
    """Horizontal part of a CRS, and its vertical axis (None without one).

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.georeference import split_crs
    >>> horizontal, vertical = split_crs(CRS("EPSG:7415"))  # Amersfoort / RD New + NAP height
    >>> horizontal.to_epsg(), vertical.unit_name
    (28992, 'metre')
    """
    if crs.is_bound and crs.source_crs is not None:
        return split_crs(crs.source_crs)
    if crs.is_compound:
        horizontal, vertical = crs.sub_crs_list[:2]
        return split_crs(horizontal)[0], vertical.axis_info[0] if vertical.axis_info else None
    if not crs.is_geocentric and len(crs.axis_info) == 3:
        return crs.to_2d(), crs.axis_info[2]
    return crs, None


def utm_zone(longitude: float, latitude: float) -> str:
    """EPSG code of the UTM zone of a place in degrees.

    Examples
    --------
    >>> from tilepipe.io.georeference import utm_zone
    >>> utm_zone(13.4, 52.5), utm_zone(-43.2, -22.9)  # Berlin, Rio de Janeiro
    ('EPSG:32633', 'EPSG:32723')
    """
    zone = int((longitude + 180) // 6) % 60 + 1
    return f"EPSG:{327 if latitude < 0 else 326}{zone:02d}"


def check_named_crs(name: str, named: CRS, given: CRS) -> None:
    """Refuse a source that names another horizontal CRS than the user does.

    Raises
    ------
    InputError
        Names the source and both CRS.
    """
    code = named.to_epsg()
    if not named.equals(given, ignore_axis_order=True) and (code is None or code != given.to_epsg()):
        raise InputError(
            f"{name}: is in {named.name} but --crs names {given.name}; --crs is for inputs that name no CRS: "
            "leave it out, or correct the file if what it names is wrong"
        )


def unit_metres(unit: str | None) -> float | None:
    """Length in metres of a unit by name (m, metre, ft, US survey foot, …); None where it is no known length.

    Examples
    --------
    >>> from tilepipe.io.georeference import unit_metres
    >>> unit_metres("metre"), unit_metres("ft"), unit_metres("furlongs per fortnight")
    (1.0, 0.3048, None)
    """
    return _METRES.get("_".join((unit or "").lower().replace("-", " ").replace("_", " ").split()))


def same_unit(a: float, b: float) -> bool:
    """Whether two units have the same length, but for rounding.

    Examples
    --------
    >>> from tilepipe.io.georeference import same_unit
    >>> same_unit(0.3048, 0.30480000001), same_unit(0.3048, 1200 / 3937)  # the US survey foot is another one
    (True, False)
    """
    return abs(a - b) <= _SAME_UNIT * a
