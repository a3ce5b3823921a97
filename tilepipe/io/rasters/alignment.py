"""Sources of one mosaic share CRS, pixel grid and unit of heights, or are refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import agreed_crs, same_crs, unbound_crs
from tilepipe.io.crs.units import same_unit
from tilepipe.io.rasters.georeference import ROUNDING
from tilepipe.io.rasters.sources.source import Source

if TYPE_CHECKING:
    from pyproj import CRS


def common_crs(sources: Sequence[Source]) -> CRS:
    """The CRS that all sources share, whatever their order: with the way to WGS 84 if some of them name it."""
    from pyproj import CRS

    texts = sorted({source.geometry.crs for source in sources}, key=lambda text: (len(text), text))
    common, *others = map(CRS, texts)
    for other in others:
        agreed = agreed_crs(common, other)
        if agreed is None:
            raise InputError(
                f"{sources[0].name} and others name different ways from {common.name} to WGS 84 (TOWGS84); "
                "give all of them the same CRS with gdal_edit -a_srs"
            )
        common = agreed
    return common


def check_same_grid(source: Source, reference: Source) -> None:
    """Refuse a source whose CRS, pixel size or alignment differs from the reference's."""
    from pyproj import CRS

    mine, theirs = source.geometry, reference.geometry
    if mine.crs != theirs.crs and not same_crs(unbound_crs(CRS(mine.crs)), unbound_crs(CRS(theirs.crs))):
        raise InputError(
            f"{source.name}: its CRS ({_short(mine.crs)}) differs from that of {reference.name} "
            f"({_short(theirs.crs)}); reproject one of them with gdalwarp"
        )
    if not math.isclose(mine.pixel, theirs.pixel, rel_tol=1e-6):
        raise InputError(
            f"{source.name}: its pixel size {mine.pixel} differs from {theirs.pixel} of {reference.name}; "
            "resample one of them with gdalwarp -tr"
        )
    for distance in (mine.left - theirs.left, mine.top - theirs.top):
        if abs(distance / theirs.pixel - round(distance / theirs.pixel)) > ROUNDING:
            raise InputError(
                f"{source.name}: its pixels do not line up with those of {reference.name}; "
                "resample one of them with gdalwarp -tap"
            )


def check_same_heights(source: Source, reference: Source) -> None:
    """Refuse a source whose heights would be in another unit than the reference's."""
    mine, theirs = source.geometry.height_metres, reference.geometry.height_metres
    if not same_unit(mine, theirs):
        raise InputError(
            f"{source.name}: its heights count in units of {mine:.6g} m, those of {reference.name} in {theirs:.6g} m; "
            "convert one of them, or name the unit in both with gdal_edit -units"
        )


def _short(crs: str) -> str:
    from pyproj import CRS

    return crs if len(crs) < 20 else CRS(crs).name
