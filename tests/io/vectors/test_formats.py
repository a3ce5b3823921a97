"""Tables and rasters written whole or not at all, with the same bytes for the same content."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
import shapely
from numpy.typing import NDArray
from rasterio.transform import from_origin

from tilepipe.errors import InputError
from tilepipe.io.rasters.cog import cog_from_tiled
from tilepipe.io.vectors import geoparquet
from tilepipe.io.vectors.formats import convert, write_table
from tilepipe.io.vectors.gdal_tables import SUFFIX
from tilepipe.io.vectors.geometries import line_strings
from tilepipe.io.vectors.geoparquet import ParquetLineWriter
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import offsets_of

CRS = "EPSG:2994"
TYPES = {"line_id": np.int64, "region_id": np.uint32, "length_m": np.float64, "name": "string"}
Lines = tuple[dict[str, NDArray[Any]], Polylines]


def make_lines(count: int, seed: int = 0) -> Lines:
    random = np.random.default_rng(seed)
    offsets = offsets_of(random.integers(2, 6, count))
    columns = {
        "line_id": np.arange(count),
        "region_id": random.integers(0, 2**32, count).astype(np.uint32),
        "length_m": np.where(random.random(count) < 0.1, np.nan, random.random(count)),
        "name": np.array([f"s{k % 5}" for k in range(count)], dtype=object),
    }
    return columns, Polylines(offsets, random.random((offsets[-1], 2)) * 1000 + (6e5, 8e5))


def write_in_batches(path: Path, lines: Lines, cuts: list[int]) -> Path:
    columns, polylines = lines
    with ParquetLineWriter(path, TYPES, CRS) as writer:
        for start, stop in pairwise(cuts):
            batch = {name: values[start:stop] for name, values in columns.items()}
            writer.append(batch, polylines.taken(np.arange(start, stop)))
    return path


def test_batches_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(geoparquet, "ROW_GROUP", 64)
    lines = make_lines(300)
    whole = write_in_batches(tmp_path / "whole.parquet", lines, [0, 300])
    for name, cuts in [("even", [0, 64, 128, 300]), ("ragged", [0, 1, 1, 63, 64, 200, 299, 300])]:
        assert write_in_batches(tmp_path / f"{name}.parquet", lines, cuts).read_bytes() == whole.read_bytes()
    metadata = pq.ParquetFile(whole).metadata
    assert [metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)] == [64, 64, 64, 64, 44]


def test_parquet_round_trip(tmp_path: Path) -> None:
    columns, polylines = lines = make_lines(50)
    table = geopandas.read_parquet(write_in_batches(tmp_path / "lines.parquet", lines, [0, 20, 50]))
    assert table.crs == CRS
    assert table["region_id"].dtype == np.uint32
    for name, values in columns.items():
        np.testing.assert_array_equal(table[name].to_numpy(), values)
    np.testing.assert_array_equal(shapely.get_coordinates(table.geometry), polylines.vertices)
    np.testing.assert_array_equal(shapely.get_num_points(table.geometry), polylines.sizes)
    geo = pq.read_schema(tmp_path / "lines.parquet").metadata[b"geo"].decode()
    for part in ('"version": "1.1.0"', '"geometry_types": ["LineString"]', str(polylines.vertices[:, 0].min())):
        assert part in geo


def test_a_missing_value_is_null_not_nan(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "p.parquet", {"width": np.array([1.0, np.nan])}, shapely.points([[0, 0], [1, 1]]), CRS
    )
    assert pq.read_table(path)["width"].null_count == 1


@pytest.mark.parametrize("format", ["gpkg", "fgb", "geojson"])
def test_converted_tables_hold_the_same_and_repeat(tmp_path: Path, format: str) -> None:
    lines = make_lines(100)
    parquet = write_in_batches(tmp_path / "lines.parquet", lines, [0, 100])
    path = convert(parquet, format)
    first = path.read_bytes()
    assert path == tmp_path / f"lines{SUFFIX[format]}"
    table = geopandas.read_file(path).sort_values("line_id")
    expected = geopandas.read_parquet(parquet)
    assert table.crs == ("EPSG:4326" if format == "geojson" else CRS)
    for name in TYPES:
        np.testing.assert_array_equal(table[name].to_numpy(), expected[name].to_numpy())
    off = shapely.hausdorff_distance(table.to_crs(CRS).geometry.to_numpy(), expected.geometry.to_numpy())
    assert off.max() < (0.1 if format == "geojson" else 1e-9)
    time.sleep(1.1 if format == "gpkg" else 0)
    assert convert(parquet, format).read_bytes() == first
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([parquet.name, path.name])


@pytest.mark.parametrize("format", list(SUFFIX))
def test_a_table_without_rows_is_valid(tmp_path: Path, format: str) -> None:
    columns = {"line_id": np.empty(0, np.int64), "name": np.empty(0, "U1")}
    path = write_table(tmp_path / f"e{SUFFIX[format]}", columns, [], CRS, format, geometry_type="LineString")
    table = geopandas.read_parquet(path) if format == "parquet" else geopandas.read_file(path)
    assert len(table) == 0
    if format != "parquet":
        assert pyogrio.read_info(path, force_feature_count=True)["features"] == 0
    with ParquetLineWriter(tmp_path / "none.parquet", TYPES, CRS):
        pass
    assert len(geopandas.read_parquet(tmp_path / "none.parquet")) == 0


def test_single_and_multi_parts_become_multi(tmp_path: Path) -> None:
    square = shapely.box(0, 0, 1, 1)
    shapes = [square, shapely.MultiPolygon([square, shapely.box(2, 2, 3, 3)])]
    table = geopandas.read_parquet(write_table(tmp_path / "p.parquet", {}, shapes, CRS))
    assert set(table.geom_type) == {"MultiPolygon"}
    with pytest.raises(ValueError, match="mixes"):
        write_table(tmp_path / "m.parquet", {}, [square, shapely.Point(0, 0)], CRS)


@pytest.mark.parametrize(
    ("columns", "coordinates", "offsets", "message"),
    [
        ({"a": [1]}, [[0, 0], [1, 1]], [0, 2], "columns"),
        ({"line_id": [1, 2]}, [[0, 0], [1, 1]], [0, 2], "shape"),
        ({"line_id": [0.5]}, [[0, 0], [1, 1]], [0, 2], "does not fit"),
        ({"line_id": [1]}, [[0, 0]], [0, 1], "two vertices"),
        ({"line_id": [1]}, [[0, 0], [1, np.nan]], [0, 2], "finite"),
        ({"line_id": [1]}, [[0, 0], [1, 1]], [0, 3], "offsets"),
    ],
)
def test_bad_batches_are_refused(
    tmp_path: Path, columns: Mapping[str, Any], coordinates: Any, offsets: Any, message: str
) -> None:
    path = tmp_path / "lines.parquet"
    with (
        pytest.raises(ValueError, match=message),
        ParquetLineWriter(path, {"line_id": np.int64}, CRS) as writer,
    ):
        writer.append(columns, Polylines(np.array(offsets), np.array(coordinates, float)))
    assert list(tmp_path.iterdir()) == []


def test_unwritable_places_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"missing/a.parquet: the folder does not exist"):
        write_table(tmp_path / "missing" / "a.parquet", {}, [shapely.Point(0, 0)], CRS)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="not a folder"):
        write_table(tmp_path / "file" / "a.parquet", {}, [shapely.Point(0, 0)], CRS)

    def refuse(self: Path, *_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(InputError, match="no permission"):
        write_table(tmp_path / "a.gpkg", {}, [shapely.Point(0, 0)], CRS, "gpkg")


def test_formats_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown format"):
        write_table(tmp_path / "a.shp", {}, [shapely.Point(0, 0)], CRS, "shp")
    with pytest.raises(InputError, match="--crs"):
        write_table(tmp_path / "a.geojson", {}, [shapely.Point(0, 0)], None, "geojson")
    with pytest.raises(InputError, match="does not exist"):
        convert(tmp_path / "a.parquet", "gpkg")


def test_ragged_lines_may_be_none() -> None:
    assert len(line_strings(Polylines(np.array([0]), np.empty((0, 2))))) == 0


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    """A tiled label raster of 1100 x 1300 that hardly compresses in one part."""
    values = np.kron(np.arange(22 * 26).reshape(22, 26) % 7, np.ones((50, 50))).astype(np.uint32)
    values[:400, :400] = np.random.default_rng(0).integers(0, 2**32, (400, 400))
    profile = {"driver": "GTiff", "width": 1300, "height": 1100, "count": 1, "dtype": "uint32", "nodata": 0}
    profile |= {"crs": CRS, "transform": from_origin(6e5, 8e5, 2, 2), "tiled": True}
    with rasterio.open(tmp_path / "labels.tif", "w", **profile) as file:
        file.write(values, 1)
    return tmp_path / "labels.tif"


def test_cog_keeps_the_labels_for_any_threads(labels: Path, tmp_path: Path) -> None:
    one = cog_from_tiled(labels, tmp_path / "one.tif", threads=1)
    four = cog_from_tiled(labels, tmp_path / "four.tif", threads=4)
    assert one.read_bytes() == four.read_bytes()
    with rasterio.open(labels) as old, rasterio.open(one) as new:
        assert new.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert (new.crs, new.transform, new.nodata) == (old.crs, old.transform, old.nodata)
        assert (new.block_shapes, new.overviews(1)) == ([(512, 512)], [2, 4])
        np.testing.assert_array_equal(new.read(), old.read())
        half = new.read(1, out_shape=(550, 650))
    assert set(np.unique(half)) <= set(np.unique(rasterio.open(labels).read()))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 256 KiB, where the system lets us mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("needs the right to mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("format", list(SUFFIX))
def test_a_full_disk_is_reported_for_tables(small_disk: Path, tmp_path: Path, format: str) -> None:
    columns, polylines = make_lines(9000)
    geometry = line_strings(polylines)
    with pytest.raises(InputError, match="the disk is full"):
        write_table(small_disk / f"t{SUFFIX[format]}", columns, geometry, CRS, format)
    assert list(small_disk.iterdir()) == []
    if format != "parquet":
        source = write_table(tmp_path / "t.parquet", columns, geometry, CRS)
        with pytest.raises(InputError, match="the disk is full"):
            convert(source, format, destination=small_disk / f"t{SUFFIX[format]}")
        assert list(small_disk.iterdir()) == []


def test_a_full_disk_is_reported_for_rasters(small_disk: Path, labels: Path) -> None:
    with pytest.raises(InputError, match=r"t.tif: the disk is full"):
        cog_from_tiled(labels, small_disk / "t.tif")
    assert list(small_disk.iterdir()) == []


def test_a_copy_that_lost_its_end_is_found(labels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rasterio.shutil

    copy = rasterio.shutil.copy

    def lossy(source: str, destination: str, **options: Any) -> None:
        copy(source, destination, **options)
        os.truncate(destination, os.path.getsize(destination) - 4000)

    monkeypatch.setattr(rasterio.shutil, "copy", lossy)
    with pytest.raises(InputError, match="the disk is full"):
        cog_from_tiled(labels, tmp_path / "t.tif")
    assert not (tmp_path / "t.tif").exists()
