"""Point clouds (LAS, LAZ, COPC): found, and their headers checked."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import laspy
import numpy as np
from pyproj import CRS

from tilepipe.errors import InputError
from tilepipe.io.clouds.counts import held_points
from tilepipe.io.clouds.crs import crs_of_header
from tilepipe.io.files.identity import Files, files_of
from tilepipe.io.files.paths import elsewhere, is_local, location, one_line

_HEADER, _RECORD, _EXTENDED_RECORD = 375, 54, 60
"""Bytes of the header of LAS 1.4, and of the heads of its records (LAS 1.4 R15, tables 3, 8 and 9)."""

_WITH_EXTENDED = 4
"""Minor version since which a file may have extended records."""

_COMPRESSED = 0x80
"""Bit of the point format that says LAZ."""

_AT_THE_END = (1 << 64) - 1
"""Place of the table of chunks, -1, of a file that was written as a stream."""


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
        Horizontal part of the CRS, or None if the header names none that is understood.
    vertical_unit
        Unit of heights by name, also one that is not known, or None if the header names none.
    files
        The file as it was when its header was read.
    has_times
        Whether its points have a GPS time.
    """

    path: Path
    points: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    crs: CRS | None
    vertical_unit: str | None
    files: Files
    has_times: bool


def find_clouds(paths: Sequence[str | Path]) -> list[Path]:
    """Files named, and the LAS and LAZ files directly in folders named; sorted, each once.

    Raises
    ------
    InputError
        Naming the folder that holds none, or what is no path of this machine.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.clouds.cloud import find_clouds
    >>> for name in ("b.laz", "a.las", "notes.txt"):
    ...     Path(name).touch()
    >>> [path.name for path in find_clouds(["."])]
    ['a.las', 'b.laz']
    """
    found: set[Path] = set()
    for named in paths:
        if not is_local(named):
            raise InputError(f"{location(named)}: {elsewhere(named)}, for point clouds are read from a local disk")
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
        Naming the file, if it is missing, not a point cloud, without points, or has a header without sense or counts
        more points than it holds.

    Warns
    -----
    UserWarning
        More points lie in the file than its header counts; these are left out.

    Examples
    --------
    >>> import laspy
    >>> import numpy as np
    >>> from tilepipe.io.clouds.cloud import read_cloud
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
        _check_records(path)
        with laspy.open(path) as reader:
            header = reader.header
            count = int(header.point_count)
            has_times = "gps_time" in header.point_format.dimension_names
            scales, offsets = header.scales.astype(float), header.offsets.astype(float)
        held = held_points(path)
    except Exception as error:
        no_cloud = isinstance(error, laspy.LaspyException) and "signature" in str(error)
        reason = "is no point cloud" if no_cloud else one_line(error)
        raise InputError(f"{path}: not a readable LAS, LAZ or COPC file ({reason})") from error
    if held is not None:
        _check_count(path, count, *held)
    if count == 0:
        raise InputError(f"{path}: the cloud has no points; leave the file out")
    # the bounding box is not looked at: writers leave it at zero, at that of the tile, or rounded
    if not ((scales > 0).all() and np.isfinite(scales).all() and np.isfinite(offsets).all()):
        raise InputError(f"{path}: scales or offsets in the header make no sense; repair it")
    crs, vertical_unit = crs_of_header(header, str(path))
    return Cloud(path, count, tuple(scales.tolist()), tuple(offsets.tolist()), crs, vertical_unit, files, has_times)


def _check_count(path: Path, counted: int, least: int, most: int) -> None:
    """Refuse a file that holds fewer points than its header counts; say where it holds more."""
    if counted > most:
        raise InputError(
            f"{path}: its header counts {counted:,} points but the file holds {most:,}; get a fresh copy, or repair it"
        )
    if counted == 0 and least > 0:
        raise InputError(f"{path}: its header counts no points but the file holds {least:,}; repair the header")
    if counted < least:
        holds = f"at least {least:,}" if least < most else f"{least:,}"
        warnings.warn(
            f"{path}: its header counts {counted:,} points, and those beyond are left out, but the file holds {holds}; "
            "repair the header if all of them are meant",
            stacklevel=3,
        )


def _check_records(path: Path) -> None:
    """Refuse a header that counts more than its file has room for: each would be looked for, or given memory."""
    with path.open("rb") as file:
        header, size = file.read(_HEADER), os.fstat(file.fileno()).st_size
        counts = [("records", _number(header, 94, 2) + _number(header, 100, 4) * _RECORD)]
        if _number(header, 25, 1) >= _WITH_EXTENDED and _number(header, 243, 4):
            end = _number(header, 235, 8) + _number(header, 243, 4) * _EXTENDED_RECORD
            counts.append(("extended records", end))
        if _number(header, 104, 1) & _COMPRESSED:
            counts.append(("chunks", _chunks(file, _number(header, 96, 4), size)))
    for name, least in counts:
        if least > size:
            raise ValueError(f"its header counts more {name} than fit into its {size:,} bytes; get a fresh copy")


def _chunks(file: BinaryIO, points: int, size: int) -> int:
    """Number of chunks of LAZ by their table, whose place stands before the points, or last where it came later."""
    place = _number_at(file, points, 8)
    if place == _AT_THE_END:
        place = _number_at(file, max(size - 8, 0), 8)
    return _number_at(file, place + 4, 4) if place < size else 0


def _number_at(file: BinaryIO, place: int, size: int) -> int:
    file.seek(place)
    return _number(file.read(size), 0, size)


def _number(header: bytes, place: int, size: int) -> int:
    return int.from_bytes(header[place : place + size], "little")
