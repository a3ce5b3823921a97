"""Longitude and latitude: the zone of a place on Earth, and the way there from a map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import unbound_crs

if TYPE_CHECKING:
    from pyproj import CRS

_WGS84_AXIS, _WGS84_FLATTENING = 6378137.0, 298.257
"""Semi-major axis in metres and inverse flattening of the ellipsoid of WGS 84, and but for a hair of GRS 1980."""


def utm_zone(longitude: float, latitude: float) -> str:
    """EPSG code of the UTM zone of a place in degrees.

    Examples
    --------
    >>> from tilepipe.io.crs.degrees import utm_zone
    >>> utm_zone(13.4, 52.5), utm_zone(-43.2, -22.9)  # Berlin, Rio de Janeiro
    ('EPSG:32633', 'EPSG:32723')
    """
    zone = int((longitude + 180) // 6) % 60 + 1
    return f"EPSG:{327 if latitude < 0 else 326}{zone:02d}"


def check_degrees(crs: CRS, name: str) -> None:
    """Refuse GeoJSON, which is always longitude and latitude on WGS 84, where nobody knows the way there.

    Raises
    ------
    InputError
        The CRS is a local one, or its datum is unknown and its ellipsoid another than that of WGS 84.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.degrees import check_degrees
    >>> check_degrees(CRS("EPSG:28992"), "a.tif")
    >>> check_degrees(CRS('LOCAL_CS["site",UNIT["metre",1]]'), "a.tif")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: a.tif: no way leads from its CRS (site) to longitude and latitude on WGS 84, in...
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    ellipsoid = unbound_crs(crs).ellipsoid
    without_shift = (
        ellipsoid is not None
        and not crs.is_bound
        and abs(ellipsoid.semi_major_metre - _WGS84_AXIS) < 1
        and abs(ellipsoid.inverse_flattening - _WGS84_FLATTENING) < 1e-3
    )
    try:
        Transformer.from_crs(crs, "EPSG:4326", allow_ballpark=without_shift)
    except ProjError as error:
        raise InputError(
            f"{name}: no way leads from its CRS ({crs.name}) to longitude and latitude on WGS 84, in which GeoJSON is; "
            "use --format parquet"
        ) from error
