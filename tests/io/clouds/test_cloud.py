"""Clouds to GeoTIFF: CRSs and units, filters, bad files, streaming, nothing half written."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import read_cloud
from tilepipe.io.clouds.crs import common_crs
from tilepipe.pipelines.points import plan, recipe
from tilepipe.pipelines.points.recipe import grid_clouds


def write(path: Path, x, y, z, *, crs="EPSG:25832", scale=0.01, offset=(0.0, 0.0, 0.0), kind=6, **fields) -> Path:
    header = laspy.LasHeader(point_format=kind, version="1.4")
    header.scales, header.offsets = [scale] * 3, list(offset)
    if crs is not None:
        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (np.asarray(a, float) for a in (x, y, z))
    for name, values in fields.items():
        setattr(las, name, np.asarray(values))
    las.write(path)
    return path


@pytest.fixture
def clouds(tmp_path: Path) -> list[Path]:
    """Two overlapping clouds with different scales and offsets, one of them compressed."""
    random = np.random.default_rng(4)
    paths = []
    for i, (name, scale) in enumerate((("a.las", 0.01), ("b.laz", 0.001))):
        x, y = 500000 + random.uniform(0, 400, 30_000) + 200 * i, 5.0e6 + random.uniform(0, 300, 30_000)
        z, intensity = random.uniform(0, 60, 30_000), random.integers(0, 65536, 30_000).astype(np.uint16)
        path = tmp_path / name
        paths.append(write(path, x, y, z, scale=scale, offset=(500000.0, 5.0e6 + 17.0 * i, 3.0), intensity=intensity))
    return paths


def read(path: Path) -> np.ndarray:
    with rasterio.open(path) as dataset:
        return dataset.read(1)


@pytest.mark.parametrize("method", ["nearest", "mean", "idw"])
def test_chunks_workers_and_file_order_are_invisible(clouds, tmp_path, monkeypatch, method) -> None:
    options = {"method": method, "void_reach": 2.0, "resolution": 0.75}
    one = grid_clouds(clouds, tmp_path / "one.tif", **options)
    monkeypatch.setattr(plan, "_TILE", 512)
    two = grid_clouds(clouds[::-1] + clouds[:1], tmp_path / "two.tif", workers=3, chunk_points=7_001, **options)
    np.testing.assert_array_equal(read(one), read(two))
    assert np.isfinite(read(one)).any()


def test_max_and_mean_equal_direct_sums(clouds, tmp_path) -> None:
    las = [laspy.read(path) for path in clouds]
    x, y, z = (np.concatenate([np.asarray(a[name]) for a in las]) for name in "xyz")
    with rasterio.open(grid_clouds(clouds, tmp_path / "max.tif", method="max", resolution=2.0)) as dataset:
        result, inverse, shape = dataset.read(1), ~dataset.transform, dataset.shape
        assert dataset.crs.to_epsg() == 25832 and np.isnan(dataset.nodata) and dataset.dtypes == ("float32",)
        assert dataset.bounds.left % 2 == 0 and dataset.bounds.top % 2 == 0
        assert dataset.units == ("metre",) and dataset.descriptions == ("height (max)",)
    column, row = inverse.a * x + inverse.c, inverse.e * y + inverse.f
    cell = row.astype(int) * shape[1] + column.astype(int)
    expected = np.full(shape[0] * shape[1], -np.inf)
    np.maximum.at(expected, cell, z)
    expected[np.isinf(expected)] = np.nan
    np.testing.assert_array_equal(result.ravel(), expected.astype(np.float32))
    mean = read(grid_clouds(clouds, tmp_path / "mean.tif", method="mean", resolution=2.0)).ravel()
    count = np.bincount(cell, minlength=mean.size)
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(mean, np.bincount(cell, z, mean.size) / count, rtol=1e-6)


def test_resolution_is_metres_in_a_crs_in_feet(tmp_path) -> None:
    path = write(tmp_path / "feet.las", [7e5, 7e5 + 100], [6e5, 6e5 + 100], [10, 20], crs="EPSG:2994")
    with rasterio.open(grid_clouds([path], tmp_path / "o.tif", resolution=1.0)) as dataset:
        assert dataset.transform.a == pytest.approx(1 / 0.3048)
        assert dataset.units == ("foot",)
        assert np.nanmax(dataset.read(1)) == 20


def test_vertical_part_of_a_compound_crs_names_the_unit(tmp_path) -> None:
    path = write(tmp_path / "c.las", [7e5], [6e5], [10], crs="EPSG:2994+5703")
    with rasterio.open(grid_clouds([path], tmp_path / "o.tif")) as dataset:
        assert dataset.units == ("metre",) and dataset.crs.to_epsg() == 2994


def test_filters(tmp_path) -> None:
    path = write(
        tmp_path / "f.las",
        [10.1] * 5,
        [10.1] * 5,
        [1, 2, 3, 4, 5],
        classification=np.array([2, 2, 6, 7, 6], np.uint8),
        return_number=np.array([1, 2, 1, 1, 1], np.uint8),
        number_of_returns=np.array([2, 2, 1, 1, 1], np.uint8),
        withheld=np.array([0, 0, 0, 0, 1], np.uint8),
    )

    def highest(**options) -> float:
        return read(grid_clouds([path], tmp_path / "o.tif", method="max", overwrite=True, **options)).item()

    assert highest() == 3
    assert highest(classes=[2]) == 2
    assert highest(classes=[2], returns="first") == 1
    assert highest(classes=[7]) == 4
    assert read(grid_clouds([path], tmp_path / "p.tif", method="min", returns="last")).item() == 2
    with pytest.raises(InputError, match="no point passes"):
        highest(classes=[9])


def test_intensity_zero_is_a_measurement(tmp_path) -> None:
    path = write(tmp_path / "i.las", [0.1, 1.1], [0.1, 0.1], [5, 5], intensity=np.array([0, 65535], np.uint16))
    result = read(grid_clouds([path], tmp_path / "o.tif", value="intensity"))
    np.testing.assert_array_equal(result, [[0, np.nan, 65535]])


def test_crs_errors(tmp_path) -> None:
    none = write(tmp_path / "none.las", [1], [1], [1], crs=None)
    utm = write(tmp_path / "utm.las", [1], [1], [1])
    degrees = write(tmp_path / "degrees.las", [1], [1], [1], crs="EPSG:4326")
    with pytest.raises(InputError, match=r"none\.las.*--crs EPSG:n"):
        grid_clouds([none], tmp_path / "o.tif")
    with pytest.raises(InputError, match="not projected"):
        grid_clouds([degrees], tmp_path / "o.tif")
    with pytest.raises(InputError, match=r"utm\.las: is in ETRS89 / UTM zone 32N but --crs names Amersfoort"):
        grid_clouds([none, utm], tmp_path / "o.tif", crs="EPSG:28992")
    zone = write(tmp_path / "zone.las", [1], [1], [1], crs="EPSG:25833")
    with pytest.raises(InputError, match="reproject"):
        grid_clouds([utm, zone], tmp_path / "o.tif")
    with pytest.raises(InputError, match="EPSG:n"):
        grid_clouds([none], tmp_path / "o.tif", crs="Amsterdam")
    feet = write(tmp_path / "feet.las", [1], [1], [1], crs="EPSG:25832+6360")
    with pytest.raises(InputError, match="unit"):
        grid_clouds([utm, feet], tmp_path / "o.tif")
    assert common_crs([read_cloud(none), read_cloud(utm)], "EPSG:25832")[0] == CRS.from_epsg(25832)
    assert not (tmp_path / "o.tif").exists()


ENDLESS = "records without end", "extended records without end"


def damaged(path: Path, kind: str) -> None:
    data = bytearray(path.read_bytes())
    match kind:
        case "empty file":
            data = bytearray()
        case "text":
            data = bytearray(b"x,y,z\n1,2,3\n" * 100)
        case "cut off":
            data = data[: len(data) * 2 // 3]
        case "header cut off":
            data = data[:150]
        case "not a number":
            data[131:139] = np.array([np.nan]).tobytes()
        case "records without end":
            data[100:104] = b"\xff" * 4
        case "extended records without end":
            data[24:26], data[243:247] = b"\1\4", b"\xff" * 4
    path.write_bytes(data)


@pytest.mark.parametrize("at_the_end", [False, True])
def test_a_table_of_more_chunks_than_bytes_is_refused(clouds, tmp_path, at_the_end) -> None:
    path = tmp_path / "b.laz"
    data = bytearray(path.read_bytes())
    points = int.from_bytes(data[96:100], "little")
    table = data[points : points + 8]
    place = int.from_bytes(table, "little")
    if at_the_end:
        data[points : points + 8] = b"\xff" * 8
        path.write_bytes(data + table)
        assert read_cloud(path).points > 0
    data[place + 4 : place + 8] = b"\xff" * 4
    path.write_bytes(data + (table if at_the_end else b""))
    with pytest.raises(InputError, match="counts more chunks than fit"):
        read_cloud(path)


@pytest.mark.parametrize("name", ["a.las", "b.laz"])
@pytest.mark.parametrize("kind", ["empty file", "text", "cut off", "header cut off", "not a number", *ENDLESS])
def test_damaged_files_are_named_and_leave_nothing(clouds, tmp_path, name, kind) -> None:
    damaged(tmp_path / name, kind)
    with pytest.raises(InputError, match=name):
        grid_clouds(clouds, tmp_path / "o.tif", chunk_points=5_000)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.las", "b.laz"]


def test_a_cloud_is_not_replaced(clouds, tmp_path) -> None:
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "link.tif").symlink_to(clouds[0])
    for out in (Path(clouds[0]), tmp_path / "link.tif"):
        with pytest.raises(InputError, match="is one of the clouds"):
            grid_clouds(clouds, out, overwrite=True)
    (tmp_path / "link.tif").unlink()
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("between", ["header and points", "two chunks"])
def test_a_cloud_that_is_replaced_while_it_is_read_is_named(clouds, tmp_path, between) -> None:
    """Of the same size and time: nothing but its content and its entry tell."""
    from tilepipe.io.clouds import points
    from tilepipe.io.clouds.points import PointFilter

    cloud = read_cloud(clouds[0])
    status = clouds[0].stat()
    data = bytearray(clouds[0].read_bytes())
    data[-1] ^= 1

    def replace() -> None:
        (tmp_path / "new").write_bytes(data)
        os.utime(tmp_path / "new", ns=(status.st_atime_ns, status.st_mtime_ns))
        os.replace(tmp_path / "new", clouds[0])

    if between == "header and points":
        replace()
    chunks = points.read_points(cloud, points.DecompressionSelection.all(), PointFilter(), 10, False)
    next(chunks)
    if between == "two chunks":
        replace()
    with pytest.raises(InputError, match=f"{clouds[0].name}: has changed since its header was read"):
        list(chunks)


def test_clouds_and_results_lie_on_a_local_disk(clouds, tmp_path) -> None:
    with pytest.raises(
        InputError, match=r"https://host/a\.laz: lies on a server; download it first, for point clouds are read from"
    ):
        grid_clouds(["https://host/a.laz"], tmp_path / "out.tif")
    with pytest.raises(InputError, match=r"s3://bucket/out\.tif: results are written to a local disk"):
        grid_clouds(clouds, "s3://bucket/out.tif")


def test_bad_input_is_refused(clouds, tmp_path) -> None:
    empty = write(tmp_path / "empty.las", [], [], [])
    with pytest.raises(InputError, match="no points"):
        grid_clouds([empty], tmp_path / "o.tif")
    with pytest.raises(InputError, match="no such file"):
        grid_clouds([tmp_path / "missing.las"], tmp_path / "o.tif")
    with pytest.raises(InputError, match="create it"):
        grid_clouds(clouds, tmp_path / "missing" / "o.tif")
    with pytest.raises(InputError, match="no point clouds"):
        grid_clouds([], tmp_path / "o.tif")
    for option in ({"resolution": 0}, {"resolution": 1e-9}, {"void_reach": -1}, {"method": "median"}):
        with pytest.raises(InputError):
            grid_clouds(clouds, tmp_path / "o.tif", **option)
    with pytest.raises(InputError, match="--memory"):
        grid_clouds(clouds, tmp_path / "o.tif", memory=1 << 20)


def test_a_folder_stands_for_its_clouds(clouds, tmp_path) -> None:
    (tmp_path / "out").mkdir()
    one = grid_clouds([tmp_path], tmp_path / "out" / "one.tif", method="max")
    two = grid_clouds(clouds, tmp_path / "out" / "two.tif", method="max")
    np.testing.assert_array_equal(read(one), read(two))
    with pytest.raises(InputError, match=r"no \.las or \.laz"):
        grid_clouds([tmp_path / "out"], tmp_path / "o.tif")


def test_overwrite(clouds, tmp_path) -> None:
    out = tmp_path / "o.tif"
    out.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        grid_clouds(clouds, out)
    assert out.read_text() == "mine"
    grid_clouds(clouds, out, overwrite=True)
    assert read(out).shape[0] > 1


@pytest.mark.parametrize("limit", [50_000, 1_000_000])
def test_full_disk_leaves_the_old_result(clouds, tmp_path, limit) -> None:
    """Files may not grow past the limit: the first stops the points' files, the second the GeoTIFF."""
    out = tmp_path / "o.tif"
    out.write_text("old")
    random = np.random.default_rng(0)
    if limit > 50_000:
        clouds = [write(tmp_path / "c.las", *random.uniform(0, 2000, (3, 80_000)), scale=0.001)]
    code = (
        "import resource, sys; from tilepipe.pipelines.points.recipe import grid_clouds\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n"
        "try: grid_clouds(sys.argv[2:], sys.argv[1], method='max', overwrite=True, void_reach=.5)\n"
        "except ValueError as error: print(error)"
    )
    command = [sys.executable, "-c", code, str(out), *map(str, clouds)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "cannot write" in shown.stdout
    assert out.read_text() == "old"
    assert not list(tmp_path.glob(".o.tif*"))


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.EIO, "Input/output error"), "cannot write .*o.tif: the disk fails; check it"),
        (
            OSError(errno.EMFILE, "Too many open files"),
            "cannot write .*o.tif: too many files are open; raise the limit",
        ),
        (OSError(errno.EFBIG, "File too large"), "cannot write .*o.tif: files there may not grow so large"),
        (PermissionError(errno.EACCES, "Permission denied", "/elsewhere/x"), "^/elsewhere/x: Permission denied$"),
        (OSError("a library fails"), "o.tif: a library fails$"),
    ],
)
def test_advice_is_for_what_has_failed(clouds, tmp_path, monkeypatch, error, told) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(recipe, "grid_tile", fail)
    with pytest.raises(InputError, match=told):
        grid_clouds(clouds, tmp_path / "o.tif")


def test_progress_reaches_its_totals(clouds, tmp_path) -> None:
    calls: list[tuple[str, int, int]] = []
    grid_clouds(clouds, tmp_path / "o.tif", progress=lambda *call: calls.append(call))
    assert {stage for stage, done, total in calls if done == total} == {"survey", "read", "grid"}
    assert calls[-1][1] == calls[-1][2] == 2


def test_memory_does_not_grow_with_the_cloud(tmp_path, monkeypatch) -> None:
    """Four times the points and the area, the same peak but for the chunks in flight, of which there are a few."""
    monkeypatch.setattr(plan, "_TILE", 512)
    peaks = []
    for height in (512, 2048):
        random = np.random.default_rng(1)
        x, y = random.uniform(0, 256, height * 200), np.sort(random.uniform(0, height, height * 200))
        path = write(tmp_path / f"{height}.las", x, y, x)
        tracemalloc.start()
        grid_clouds([path], tmp_path / f"{height}.tif", workers=1, chunk_points=10_000)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.35 * peaks[0], peaks


def test_amsterdam_needs_a_crs_and_has_no_seams(shared_data, tmp_path) -> None:
    paths = sorted((shared_data / "amsterdam_ahn3_bag").glob("*.laz"))[:2]
    with pytest.raises(InputError, match="--crs"):
        grid_clouds(paths, tmp_path / "o.tif")
    out = grid_clouds(paths, tmp_path / "o.tif", crs="EPSG:28992", void_reach=2.0, value="intensity")
    with rasterio.open(out) as dataset:
        assert dataset.crs.to_epsg() == 28992
        assert np.isfinite(dataset.read(1)[:, 250:380]).mean() > 0.75


def test_autzen_in_feet(shared_data, tmp_path) -> None:
    path = shared_data / "autzen_north" / "autzen_crop_800ft.laz"
    with rasterio.open(grid_clouds([path], tmp_path / "o.tif", void_reach=2.0)) as dataset:
        assert dataset.res[0] == pytest.approx(0.5 / 0.3048)
        assert dataset.units == ("foot",)
        heights = dataset.read(1)
    assert 415 < np.nanmin(heights) < np.nanmax(heights) < 505
    assert np.isfinite(heights).mean() > 0.99


def test_clouds_far_apart_are_refused(tmp_path) -> None:
    near = [write(tmp_path / f"near{k}.las", [5e5, 5e5 + 500], [5e6, 5e6 + 500], [1, 1]) for k in range(2)]
    far = write(tmp_path / "far.las", [8e5, 8e5 + 500], [5.4e6, 5.4e6 + 500], [1, 1])
    told = r"far\.las: 1 point at x 800500, .* 500\.0 km from most of .*near0\.las: .* 481 Gpx, .*--resolution 11"
    with pytest.raises(InputError, match=told):
        grid_clouds([*near, far], tmp_path / "o.tif")
    assert not (tmp_path / "o.tif").exists()
    # few cells, however empty
    assert grid_clouds([*near, far], tmp_path / "o.tif", resolution=50).exists()
