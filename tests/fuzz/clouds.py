"""Readers of point clouds: LAS, LAZ, COPC."""

from __future__ import annotations

from pathlib import Path
from random import Random

import laspy
import numpy as np
from laspy.vlrs.vlrlist import VLRList
from pyproj import CRS

from tests.fuzz.mutations import mutated_bytes, mutated_field
from tests.fuzz.reader import Reader
from tilepipe.io.clouds.cloud import read_cloud
from tilepipe.io.clouds.points import IDENTITY, PointFilter, identities, raw_coordinates, read_points, ticks

_POINTS = 40
_AT_ONCE = 1000

_FIELDS = (
    *((24, "<B"), (25, "<B"), (6, "<H"), (94, "<H"), (96, "<I"), (100, "<I"), (104, "<B"), (105, "<H"), (107, "<I")),
    *((place, "<d") for place in range(131, 227, 8)),
    *((227, "<Q"), (235, "<Q"), (243, "<I"), (247, "<Q"), (255, "<Q")),
)
"""Fields of a header of LAS 1.4 (R15, table 3) that say how to read it: version, sizes, places, counts, scales."""

_RECORD = (18, "<H"), (20, "<H"), (54, "<H"), (58, "<I"), (62, "<I")
"""Within the first record behind a header: its number and size; of LAZ its compressor and the points of a chunk."""


def _cloud(path: Path, version: str, form: int, *, copc: bool = False) -> bytes:
    random = np.random.default_rng(1)
    cloud = laspy.LasData(laspy.LasHeader(point_format=form, version=version))
    cloud.header.scales, cloud.header.offsets = np.full(3, 0.01), np.array([392000, 5820000, 0.0])
    cloud.x, cloud.y = 392000 + random.random(_POINTS) * 10, 5820000 + random.random(_POINTS) * 10
    cloud.z = random.random(_POINTS) * 30
    cloud.intensity, cloud.classification = random.integers(0, 9, (2, _POINTS))
    cloud.header.add_crs(CRS("EPSG:7415"))
    if copc:
        cloud.header.vlrs.insert(0, laspy.VLR("copc", 1, "info", bytes(160)))
        cloud.evlrs = VLRList([laspy.VLR("copc", 1000, "hierarchy", bytes(32))])
    cloud.write(path)
    return path.read_bytes()


def _clouds(folder: Path) -> list[bytes]:
    return [
        _cloud(folder / "old.las", "1.2", 3),
        _cloud(folder / "new.las", "1.4", 6),
        _cloud(folder / "old.laz", "1.2", 1),
        _cloud(folder / "new.laz", "1.4", 7),
        _cloud(folder / "tree.copc.laz", "1.4", 6, copc=True),
    ]


def _read(content: bytes, folder: Path) -> None:
    path = folder / "a.laz"
    path.write_bytes(content)
    cloud = read_cloud(path)
    for parallel in (False, True):
        for _, points in read_points(cloud, IDENTITY, PointFilter(), _AT_ONCE, parallel):
            if len(points):
                raw_coordinates(points)
                ticks(cloud, points, "intensity", 1.0)
                identities(cloud, points, [cloud])


def _mutated(content: bytes, random: Random) -> bytes:
    kind = random.random()
    if kind < 0.4:
        return mutated_bytes(content, random)
    behind = int.from_bytes(content[94:96], "little")
    places = _FIELDS if kind < 0.8 else [(behind + place, type) for place, type in _RECORD]
    for _ in range(random.randint(1, 2)):
        content = mutated_field(content, *random.choice(places), random)
    return content


READERS = (Reader("cloud", _clouds, _read, _mutated),)
