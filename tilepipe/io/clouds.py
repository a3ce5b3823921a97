"""Point clouds (LAS, LAZ, COPC): found, their headers checked, and the CRS that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from tilepipe.errors import InputError
from tilepipe.io.georeference import check_named_crs, split_crs
from tilepipe.io.identity import Files, files_of
from tilepipe.io.paths import is_local, location

_VERTICAL_CRS_KEY, _VERTICAL_UNIT_KEY = 4096, 4099
_UNIT_NAMES = {9001: "metre", 9002: "foot", 9003: "US survey foot"}


@dataclass(frozen=True)
class Cloud:
    """What the header of one point cloud says.

    Attributes
    ----------
    path
        The file.
    points
        Number of points, at least 1.
    scales, offsets
        For x, y, z: coordinate = integer * scale + offset, in CRS units.
    crs
        Horizontal part of the CRS, or None if the header names none.
    vertical_unit
        Unit of heights by name, or None if the header names none.
    files
        The file as it was when its header was read.
    """

    path: Path
    points: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    crs: CRS | None
    vertical_unit: str | None
    files: Files


def metres_per_unit(crs: CRS) -> float:
    """Length of a projected CRS's unit in metres.

    Raises
    ------
    InputError
        If the CRS is not projected (degrees are no lengths).

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.clouds import metres_per_unit
    >>> metres_per_unit(CRS("EPSG:32633")), round(metres_per_unit(CRS("EPSG:2263")), 6)  # metres, US survey feet
    (1.0, 0.304801)
    """
    if not crs.is_projected:
        raise InputError(
            f"the CRS {crs.name!r} is not projected, so lengths in metres have no meaning in it; "
            "reproject the clouds to a projected CRS (UTM or a national grid) first"
        )
    return float(crs.axis_info[0].unit_conversion_factor)


def _vertical_unit_of_keys(header: laspy.LasHeader) -> str | None:
    for directory in header.vlrs.get("GeoKeyDirectoryVlr"):
        keys = {key.id: key.value_offset for key in directory.geo_keys}
        if keys.get(_VERTICAL_UNIT_KEY) in _UNIT_NAMES:
            return _UNIT_NAMES[keys[_VERTICAL_UNIT_KEY]]
        try:
            return str(CRS.from_epsg(keys[_VERTICAL_CRS_KEY]).axis_info[0].unit_name)
        except (KeyError, IndexError, CRSError):
            continue
    return None


def _crs_of(header: laspy.LasHeader) -> tuple[CRS | None, str | None]:
    try:
        crs = header.parse_crs()
    except CRSError:
        crs = None
    if crs is None:
        return None, _vertical_unit_of_keys(header)
    horizontal, vertical = split_crs(crs)
    return horizontal, str(vertical.unit_name) if vertical else _vertical_unit_of_keys(header)


def find_clouds(paths: Sequence[str | Path]) -> list[Path]:
    """Files named, and the LAS and LAZ files directly in folders named; sorted, each once.

    Raises
    ------
    InputError
        Naming the folder that holds none, or what is no path of this machine.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.clouds import find_clouds
    >>> for name in ("b.laz", "a.las", "notes.txt"):
    ...     Path(name).touch()
    >>> [path.name for path in find_clouds(["."])]
    ['a.las', 'b.laz']
    """
    found: set[Path] = set()
    for named in paths:
        if not is_local(named):
            raise InputError(f"{location(named)}: point clouds are read from a local disk; download it first")
        path = Path(location(named))
        if path.is_dir():
            inside = [file.resolve() for file in path.iterdir() if file.suffix.lower() in (".las", ".laz")]
            if not inside:
                raise InputError(f"{path}: no .las or .laz file in this folder")
            found.update(inside)
        else:
            found.add(path.resolve())
    return sorted(found)


def read_cloud(path: str | Path) -> Cloud:
    """Read and check the header of a LAS, LAZ or COPC file.

    Raises
    ------
    InputError
        Naming the file, if it is missing, not a point cloud, without points, or has a header without sense.

    Examples
    --------
    >>> import laspy
    >>> import numpy as np
    >>> from tilepipe.io.clouds import read_cloud
    >>> cloud = laspy.create()
    >>> cloud.x, cloud.y, cloud.z = np.array([[10.0, 12.5], [20.0, 21.0], [3.0, 4.0]])
    >>> cloud.write("cloud.las")
    >>> read_cloud("cloud.las").points
    2
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        files = files_of(str(path), [(str(path), None)])
        with laspy.open(path) as reader:
            header = reader.header
            count = int(header.point_count)
            scales, offsets = header.scales.astype(float), header.offsets.astype(float)
            crs, vertical_unit = _crs_of(header)
    except Exception as error:
        reason = "is no point cloud" if isinstance(error, laspy.LaspyException) and "signature" in str(error) else error
        raise InputError(f"{path}: not a readable LAS, LAZ or COPC file ({reason})") from error
    if count == 0:
        raise InputError(f"{path}: the cloud has no points; leave the file out")
    # the bounding box is not looked at: writers leave it at zero, at that of the tile, or rounded
    if not ((scales > 0).all() and np.isfinite(scales).all() and np.isfinite(offsets).all()):
        raise InputError(f"{path}: scales or offsets in the header make no sense; repair it")
    return Cloud(path, count, tuple(scales.tolist()), tuple(offsets.tolist()), crs, vertical_unit, files)


def common_crs(clouds: Sequence[Cloud], crs: str | CRS | None = None) -> tuple[CRS, str]:
    """The one projected CRS of all clouds, and the unit of their heights.

    Parameters
    ----------
    clouds
        At least one.
    crs
        For clouds that name none; no cloud may name another.

    Returns
    -------
    crs
        Horizontal.
    vertical_unit
        By name; that of the horizontal CRS where neither the headers nor ``crs`` name one.

    Raises
    ------
    InputError
        If a cloud has no CRS and none is given, or names another than is given, if CRSs or height units differ,
        or if the CRS is not projected.
    """
    given: CRS | None = None
    given_unit: str | None = None
    if crs is not None:
        try:
            given, vertical = split_crs(CRS.from_user_input(crs))
        except CRSError as error:
            raise InputError(f"cannot understand the CRS {crs!r}; write it as EPSG:n") from error
        given_unit = str(vertical.unit_name) if vertical else None
    first: tuple[CRS, str] | None = None
    for cloud in clouds:
        horizontal = cloud.crs or given
        if horizontal is None:
            raise InputError(f"{cloud.path}: the file names no CRS; pass --crs EPSG:n")
        if cloud.crs is not None and given is not None:
            check_named_crs(str(cloud.path), cloud.crs, given)
        metres_per_unit(horizontal)
        unit = cloud.vertical_unit or given_unit or str(horizontal.axis_info[0].unit_name)
        if first is None:
            first = horizontal, unit
        elif not horizontal.equals(first[0], ignore_axis_order=True):
            raise InputError(
                f"{cloud.path} is in {horizontal.name!r} but {clouds[0].path} in {first[0].name!r}; "
                "reproject the clouds to one CRS first"
            )
        elif unit != first[1]:
            raise InputError(
                f"heights of {cloud.path} are in {unit} but those of {clouds[0].path} in {first[1]}; "
                "convert the clouds to one unit first"
            )
    if first is None:
        raise InputError("no point clouds given")
    return first
