"""Headers of clouds that count more or fewer points than the file holds."""

from __future__ import annotations

import itertools
import struct
import warnings
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
import rasterio

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import read_cloud
from tilepipe.io.clouds.counts import held_points
from tilepipe.pipelines.points.recipe import grid_clouds

POINTS = 1000


def write(path: Path, kind: int) -> Path:
    header = laspy.LasHeader(point_format=kind, version="1.4" if kind >= 6 else "1.2")
    header.scales = [0.01] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.random.default_rng(0).uniform(0, 30, (3, POINTS))
    cloud.write(path)
    return path


def count(path: Path, points: int) -> None:
    """Let a header count so many points."""
    data = bytearray(path.read_bytes())
    layered = data[104] & 0x3F >= 6
    struct.pack_into("<I", data, 107, 0 if layered else points)
    if data[25] >= 4:
        struct.pack_into("<Q", data, 247, points)
    path.write_bytes(data)


FILES = [("a.las", 1), ("a.las", 6), ("a.laz", 6)]
"""Of LAZ before point format 6 nobody knows how full its last chunk is."""


@pytest.mark.parametrize(("name", "kind"), [*FILES, ("a.laz", 1)])
def test_a_header_that_is_right_is_silent(tmp_path, name, kind) -> None:
    path = write(tmp_path / name, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_cloud(path).points == POINTS


@pytest.mark.parametrize(("name", "kind"), FILES)
def test_points_beyond_the_count_are_told(tmp_path, name, kind) -> None:
    path = write(tmp_path / name, kind)
    count(path, 600)
    told = r"a\.la[sz]: its header counts 600 points, and those beyond are left out, but the file holds 1,000; repair"
    with pytest.warns(UserWarning, match=told):
        assert read_cloud(path).points == 600
    count(path, 0)
    with pytest.raises(InputError, match="its header counts no points but the file holds 1,000; repair the header"):
        read_cloud(path)


@pytest.mark.parametrize(("name", "kind"), FILES)
def test_a_count_beyond_the_points_is_refused_before_work(tmp_path, name, kind) -> None:
    path = write(tmp_path / name, kind)
    count(path, 1400)
    with pytest.raises(InputError, match=r"its header counts 1,400 points but the file holds 1,000; get a fresh copy"):
        grid_clouds([path], tmp_path / "o.tif", crs="EPSG:32633")
    assert list(tmp_path.iterdir()) == [path]


def test_what_lies_behind_the_points_is_none(tmp_path) -> None:
    path = write(tmp_path / "a.las", 6)
    cloud = laspy.read(path)
    cloud.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("user", 7, "", bytes(5000))])
    cloud.write(path)
    with laspy.open(path) as file:
        assert file.header.number_of_evlrs == 1
    assert held_points(path) == (POINTS, POINTS)


def test_chunks_of_laz_are_counted_by_their_table(tmp_path) -> None:
    """Of fixed size before point format 6: all but the last are full."""
    path = tmp_path / "a.laz"
    header = laspy.LasHeader(point_format=1, version="1.2")
    cloud = laspy.LasData(header)
    cloud.x = cloud.y = cloud.z = np.arange(60_000.0) % 100
    cloud.write(path)
    assert held_points(path) == (50_001, 100_000)
    count(path, 50_000)
    with pytest.warns(UserWarning, match="but the file holds at least 50,001"):
        read_cloud(path)
    count(path, 100_001)
    with pytest.raises(InputError, match="but the file holds 100,000"):
        read_cloud(path)


def test_a_copc_file_is_read_as_the_las_file_of_its_points(tmp_path) -> None:
    """Its chunks, the nodes of an octree, have each a number of points of its own."""
    plain = write(tmp_path / "a.las", 6)
    cloud, path, ends = laspy.read(plain), tmp_path / "a.copc.laz", [0, 300, 800, POINTS]
    described = lazrs.LazVlr.new_for_compression(6, 0, True)
    header = cloud.header
    header.are_points_compressed = True
    header.vlrs.insert(0, laspy.VLR("copc", 1, "info", bytes(160)))
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "", described.record_data()))
    records = cloud.points.array.view(np.uint8).reshape(POINTS, -1)
    with path.open("wb") as file:
        header.write_to(file)
        writer = lazrs.ParLasZipCompressor(file, described)
        writer.compress_chunks([records[a:b].ravel() for a, b in itertools.pairwise(ends)])
        writer.done()
    assert held_points(path) == (POINTS, POINTS)
    rasters = [
        grid_clouds([each], tmp_path / f"{each.name}.tif", crs="EPSG:32633", method="mean", resolution=2.0)
        for each in (plain, path)
    ]
    expected, found = (rasterio.open(each).read(1) for each in rasters)
    assert np.array_equal(found, expected, equal_nan=True)
    count(path, 1200)
    with pytest.raises(InputError, match="its header counts 1,200 points but the file holds 1,000"):
        read_cloud(path)
