"""How long a unit of a map is on the ground: projections stretch, some so far that their metres are no metres."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.degrees import utm_zone
from tilepipe.io.crs.systems import map_unit, unbound_crs

if TYPE_CHECKING:
    from pyproj import CRS

Bounds = tuple[float, float, float, float]
"""Left, bottom, right, top in CRS units."""

RASTERS = "gdalwarp -t_srs {zone} IN OUT"
CLOUDS = "pdal translate IN OUT reprojection --filters.reprojection.out_srs={zone}"
TABLES = "ogr2ogr -t_srs {zone} OUT IN"
"""Commands that reproject to a UTM zone."""

_STRETCH = 0.01
"""Largest relative error of a length: survey grids (UTM, state planes, national grids) keep well within it."""

_STEP = 100.0
"""Length that is measured on the ground, in metres of the map: short beside a city, long beside rounding."""


def ground_scales(crs: CRS, bounds: Bounds) -> tuple[float, float] | None:
    """Least and largest length on the ground of a metre of the map, in any direction, over a part of the map.

    The part is looked at in nine places. In each the geodesics along short steps east and north make the matrix that
    takes directions on the map to the ground; its singular values are the axes of Tissot's indicatrix (Snyder 1987,
    Map Projections: A Working Manual, p. 20).

    Returns
    -------
    tuple of float, or None
        None where it cannot be known: the CRS is a local one, or the part lies outside its projection.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.ground import ground_scales
    >>> berlin = (1492000, 6893000, 1493000, 6894000)
    >>> [round(scale, 3) for scale in ground_scales(CRS("EPSG:3857"), berlin)]
    [0.608, 0.61]
    >>> [round(scale, 3) for scale in ground_scales(CRS("EPSG:25833"), (392000, 5819000, 393000, 5820000))]
    [1.0, 1.0]
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    plain = unbound_crs(crs)
    if plain.geodetic_crs is None or not (ellipsoid := plain.get_geod()):
        return None
    try:
        inverse = Transformer.from_crs(plain, plain.geodetic_crs, always_xy=True)
    except ProjError:
        return None
    step = _STEP / map_unit(crs)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(*bounds[::2], 3), np.linspace(*bounds[1::2], 3)))
    there = [inverse.transform(x + east * step, y + north * step) for east, north in ((0, 0), (1, 0), (0, 1))]
    here, known = there[0], np.isfinite(there).all(axis=(0, 1))
    if not known.any():
        return None
    columns = []
    for longitude, latitude in there[1:]:
        ways = (longitude, latitude, here[0], here[1])
        towards, _, length = ellipsoid.inv(ways[2][known], ways[3][known], ways[0][known], ways[1][known])
        angle = np.radians(towards)
        columns.append(np.stack([length * np.sin(angle), length * np.cos(angle)], axis=-1) / _STEP)
    matrices: NDArray[np.float64] = np.stack(columns, axis=-1)
    scales = np.linalg.svd(matrices, compute_uv=False)
    return float(scales.min()), float(scales.max())


def ground_metres(crs: CRS, bounds: Bounds, name: str, remedy: str = RASTERS) -> float:
    """Length on the ground of a unit of the map, in metres.

    It is the unit's own where projection and unit agree to one percent, as those of survey grids do. Where the map is
    stretched evenly, as Web Mercator is over a city, it is the unit's length times the scale, and a warning says so.

    Parameters
    ----------
    crs
        Horizontal.
    bounds
        The part of the map.
    name
        What lies there, for the message.
    remedy
        Command that reprojects what lies there to ``{zone}``, such as `RASTERS`, `CLOUDS` or `TABLES`.

    Raises
    ------
    InputError
        The lengths of a unit differ by more over the part of the map, or between directions.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.ground import ground_metres
    >>> ground_metres(CRS("EPSG:25833"), (392000, 5819000, 393000, 5820000), "a.tif")
    1.0
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     round(ground_metres(CRS("EPSG:3857"), (1492000, 6893000, 1493000, 6894000), "a.tif"), 3)
    0.609
    >>> str(told[0].message)
    'a.tif: a metre of its map (WGS 84 / Pseudo-Mercator) is 0.6091 m on the ground, where lengths and areas count'
    """
    unit, scales = map_unit(crs), ground_scales(crs, bounds)
    if scales is None or max(abs(scale - 1) for scale in scales) <= _STRETCH:
        return unit
    middle = math.sqrt(scales[0] * scales[1])
    if scales[1] <= (1 + _STRETCH) * middle:
        warnings.warn(
            f"{name}: a metre of its map ({crs.name}) is {middle:.4g} m on the ground, where lengths and areas count",
            stacklevel=3,
        )
        return unit * middle
    raise InputError(
        f"{name}: a metre of its map ({crs.name}) is {scales[0]:.3f} to {scales[1]:.3f} m on the ground, depending on "
        f"place or direction, so lengths and areas would be wrong; reproject it first, for example with: "
        + remedy.format(zone=_zone(crs, bounds))
    )


def _zone(crs: CRS, bounds: Bounds) -> str:
    """UTM zone of the middle of a part of a map."""
    from pyproj import Transformer

    plain = unbound_crs(crs)
    inverse = Transformer.from_crs(plain, plain.geodetic_crs, always_xy=True)
    return utm_zone(*inverse.transform((bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2))
