"""What point clouds say of their CRS and of the unit of their heights, and what they share of it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING

import laspy
from laspy.vlrs.known import GeoAsciiParamsVlr, GeoDoubleParamsVlr, GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from pyproj import CRS
from pyproj.exceptions import CRSError

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import (
    agreed_crs,
    check_named_crs,
    crs_of_dataset,
    registered_crs,
    split_crs,
    understood_crs,
)
from tilepipe.io.crs.units import SOME_UNITS, epsg_unit, same_unit, unit_metres, unit_name

if TYPE_CHECKING:
    from tilepipe.io.clouds.cloud import Cloud

_VERTICAL_CRS_KEY, _VERTICAL_UNIT_KEY = 4096, 4099

_DIRECTORY_TAG, _DOUBLES_TAG, _TEXTS_TAG = 34735, 34736, 34737
"""Where a GeoTIFF has its keys and what they refer to; a LAS file numbers its records the same."""

_SHORT, _LONG, _ASCII, _DOUBLE = 3, 4, 2, 12
"""Types of the values of a tag (TIFF 6.0, p. 15)."""


def crs_of_header(header: laspy.LasHeader, name: str) -> tuple[CRS | None, str | None]:
    """Horizontal CRS and unit of heights that the records of a cloud name.

    A file may name a CRS as WKT and by GeoTIFF keys.  Where they differ, the one counts that the WKT bit of the global
    encoding names (LAS 1.4 R15, table 4).

    Parameters
    ----------
    header
        Of a LAS, LAZ or COPC file, with its extended records.
    name
        Name of the file, for messages.

    Returns
    -------
    crs
        None where the file names none that is understood.
    vertical_unit
        By name, also one that is not known; None where the file names none.

    Raises
    ------
    InputError
        The file names two CRS of one kind.

    Examples
    --------
    >>> import laspy
    >>> from pyproj import CRS
    >>> from tilepipe.io.clouds.crs import crs_of_header
    >>> header = laspy.LasHeader(point_format=6, version="1.4")
    >>> header.add_crs(CRS("EPSG:7415"))  # Amersfoort / RD New + NAP height
    >>> crs, vertical_unit = crs_of_header(header, "cloud.laz")
    >>> crs.to_epsg(), vertical_unit
    (28992, 'metre')
    """
    records = [*header.vlrs, *(header.evlrs or [])]
    by_wkt = _only([_of_wkt(record) for record in records if isinstance(record, WktCoordinateSystemVlr)], name)
    directories = [record for record in records if isinstance(record, GeoKeyDirectoryVlr)]
    by_keys = _only([_of_keys(directory, records) for directory in directories], name)
    unit_of_keys = next((unit for unit in map(_vertical_unit, directories) if unit is not None), None)
    chosen = (by_wkt or by_keys) if header.global_encoding.wkt else (by_keys or by_wkt)
    if chosen is None:
        return None, unit_of_keys
    horizontal, vertical = split_crs(chosen)
    if vertical is not None:
        return horizontal, unit_name(vertical)
    contradicted = chosen is by_wkt and by_keys is not None and agreed_crs(horizontal, split_crs(by_keys)[0]) is None
    return horizontal, None if contradicted else unit_of_keys


def _only(found: Sequence[CRS | None], name: str) -> CRS | None:
    """The one CRS of records of one kind."""
    known = [crs for crs in found if crs is not None]
    for other in known[1:]:
        if agreed_crs(known[0], other) is None:
            raise InputError(f"{name}: names two CRS, {known[0].name} and {other.name}; correct its header")
    return known[0] if known else None


def _of_wkt(record: WktCoordinateSystemVlr) -> CRS | None:
    try:
        return registered_crs(CRS.from_wkt(record.string)) if record.string else None
    except CRSError:
        return None


def _of_keys(directory: GeoKeyDirectoryVlr, records: Sequence[laspy.VLR]) -> CRS | None:
    """CRS that GeoTIFF keys describe, as GDAL reads it from a GeoTIFF that has them."""
    from rasterio.errors import RasterioError
    from rasterio.io import MemoryFile

    doubles = b"".join(item.record_data_bytes() for item in records if isinstance(item, GeoDoubleParamsVlr))
    texts = b"".join(item.record_data_bytes() for item in records if isinstance(item, GeoAsciiParamsVlr))
    try:
        with MemoryFile(_geotiff(directory.record_data_bytes(), doubles, texts)) as file, file.open() as dataset:
            crs = crs_of_dataset(dataset)
    except (RasterioError, InputError):
        return None
    # of keys that name nothing GDAL makes a local CRS
    return crs if crs is not None and (crs.is_projected or crs.is_geographic or crs.is_geocentric) else None


def _geotiff(keys: bytes, doubles: bytes, texts: bytes) -> bytes:
    """A GeoTIFF of one pixel with keys and the numbers and texts to which they refer."""
    tags = [(256, _SHORT, 1, 1), (257, _SHORT, 1, 1), (258, _SHORT, 1, 8), (259, _SHORT, 1, 1), (262, _SHORT, 1, 1)]
    tags += [(273, _LONG, 1, 0), (277, _SHORT, 1, 1), (278, _SHORT, 1, 1), (279, _LONG, 1, 1)]
    scale, tie = struct.pack("<3d", 1, 1, 0), struct.pack("<6d", *[0] * 6)
    longer = [(33550, _DOUBLE, 8, scale), (33922, _DOUBLE, 8, tie), (_DIRECTORY_TAG, _SHORT, 2, keys)]
    longer += [
        (tag, kind, size, data)
        for tag, kind, size, data in ((_DOUBLES_TAG, _DOUBLE, 8, doubles), (_TEXTS_TAG, _ASCII, 1, texts))
        if data
    ]
    place = 8 + 2 + 12 * (len(tags) + len(longer)) + 4
    data = b""
    for tag, kind, size, values in longer:
        tags.append((tag, kind, len(values) // size, place + len(data)))
        data += values + bytes(len(values) % 2)
    directory = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + directory + bytes(4) + data


def _vertical_unit(directory: GeoKeyDirectoryVlr) -> str | None:
    """Unit of heights that GeoTIFF keys name, by itself or by a vertical CRS; None where they name none."""
    keys = {key.id: key.value_offset for key in directory.geo_keys}
    if code := keys.get(_VERTICAL_UNIT_KEY):
        return epsg_unit(code) or f"EPSG unit {code}"
    if code := keys.get(_VERTICAL_CRS_KEY):
        try:
            return unit_name(CRS.from_epsg(code).axis_info[-1])
        except CRSError:
            return f"the unit of vertical CRS {code}"
    return None


def common_crs(clouds: Sequence[Cloud], crs: str | CRS | None = None, *, heights: bool = True) -> tuple[CRS, str]:
    """The one projected CRS of all clouds, and the unit of their heights.

    Parameters
    ----------
    clouds
        At least one.
    crs
        For clouds that name none; no cloud may name another.  Its vertical part is for clouds that name no unit of
        heights, or none that is known.
    heights
        Whether heights matter: only then is their unit checked.

    Returns
    -------
    crs
        Horizontal.
    vertical_unit
        By name; that of the horizontal CRS where neither the headers nor ``crs`` name one.

    Raises
    ------
    InputError
        If a cloud has no CRS and none is given, or names another than is given, if CRSs or height units differ, if a
        unit of heights is not known, or if the CRS is not projected.
    """
    given: CRS | None = None
    given_unit: str | None = None
    if crs is not None:
        given, vertical = split_crs(understood_crs(crs, "--crs"))
        given_unit = unit_name(vertical) if vertical else None
    first: tuple[CRS, str] | None = None
    for cloud in clouds:
        horizontal = cloud.crs or given
        if horizontal is None:
            raise InputError(f"{cloud.path}: the file names no CRS that is understood; pass --crs EPSG:n")
        if given is not None:
            horizontal = check_named_crs(str(cloud.path), horizontal, given)
        unit = _height_unit(cloud, given_unit, horizontal) if heights else ""
        if first is None:
            first = horizontal, unit
            continue
        agreed = agreed_crs(first[0], horizontal)
        if agreed is None:
            raise InputError(
                f"{cloud.path} is in {horizontal.name!r} but {clouds[0].path} in {first[0].name!r}; "
                "reproject the clouds to one CRS first"
            )
        if heights and not same_unit(unit_metres(unit) or 0.0, unit_metres(first[1]) or 0.0):
            raise InputError(
                f"heights of {cloud.path} are in {unit} but those of {clouds[0].path} in {first[1]}; "
                "convert the clouds to one unit first"
            )
        first = agreed, first[1]
    if first is None:
        raise InputError("no point clouds given")
    if first[0].is_geographic or first[0].is_geocentric or first[0].is_vertical:
        raise InputError(
            f"the CRS {first[0].name!r} is not projected, so lengths in metres have no meaning in it; "
            "reproject the clouds to a projected CRS (UTM or a national grid) first"
        )
    return first


def _height_unit(cloud: Cloud, given: str | None, horizontal: CRS) -> str:
    """Name of the unit of a cloud's heights, which must be a known length."""
    if cloud.vertical_unit is None:
        return given or unit_name(horizontal.axis_info[0])
    if unit_metres(cloud.vertical_unit) is not None:
        return cloud.vertical_unit
    if given is not None:
        return given
    raise InputError(
        f"{cloud.path}: its heights are in '{cloud.vertical_unit}', which is no known unit of length ({SOME_UNITS}); "
        "name it by a vertical CRS: --crs EPSG:n+m"
    )
