"""Where pixels lie on the ground, and the refusal of everything that could go silently wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tilepipe.errors import InputError


@dataclass(frozen=True)
class Geometry:
    """Where the pixels of a raster lie: north-up grid of square pixels in a projected CRS.

    ``left``, ``top`` are the coordinates of the upper left corner and ``pixel`` is the pixel size, in CRS units;
    ``metres`` is the length of one CRS unit in metres.
    """

    crs: str
    left: float
    top: float
    pixel: float
    shape: tuple[int, int]
    metres: float

    @property
    def resolution(self) -> float:
        """Ground size of a pixel in metres."""
        return self.pixel * self.metres

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) of rasterio for this grid."""
        return self.pixel, 0.0, self.left, 0.0, -self.pixel, self.top


def check_geometry(
    name: str, crs: object, transform: Sequence[float], shape: tuple[int, int], override: str | None
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
        CRS to use when ``crs`` is None.

    Raises
    ------
    InputError
        See `open_raster`.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    a, b, c, d, e, f = transform[:6]
    if crs is None and override is None:
        raise InputError(f"{name}: has no coordinate reference system; pass --crs EPSG:n (crs='EPSG:n')")
    try:
        system = CRS.from_user_input(crs if crs is not None else override)
    except CRSError as error:
        raise InputError(f"{name}: CRS '{crs or override}' is not understood; pass --crs EPSG:n") from error
    if system.is_compound:
        system = system.sub_crs_list[0]
    if system.is_geocentric or system.is_vertical:
        raise InputError(f"{name}: {system.name} is no map projection; reproject it to a projected CRS first")
    if system.is_geographic:
        raise InputError(
            f"{name}: is in degrees ({system.name}); reproject it to a projected CRS first, "
            "for example with: gdalwarp -t_srs EPSG:n IN OUT"
        )
    if b or d:
        raise InputError(f"{name}: is rotated; resample it north-up first, for example with gdalwarp")
    if not (a > 0 and e < 0):
        raise InputError(f"{name}: is not north-up; resample it first, for example with gdalwarp")
    if abs(a + e) > 1e-6 * a:
        raise InputError(f"{name}: pixels are not square ({a} × {-e}); resample it with gdalwarp -tr {a} {a}")
    if min(shape) < 3:
        raise InputError(f"{name}: is {shape[0]} × {shape[1]} pixels; at least 3 × 3 are needed")
    metres = float(system.axis_info[0].unit_conversion_factor) if system.axis_info else 1.0
    authority = system.to_authority(min_confidence=100)
    text = ":".join(authority) if authority else system.to_wkt()
    return Geometry(text, float(c), float(f), float(a), shape, metres)
