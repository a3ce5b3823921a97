"""Files and arrays of every kind become the same mosaic: values, nodata, geometry; nothing is read before it is due."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import pytest
import rasterio
import rioxarray
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS
from rasterio.transform import from_origin

import tilepipe
from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.io.rasters.raster import Member, Raster, as_dataarray, check_aligned, open_raster
from tilepipe.io.rasters.sources.source import FileSource, _unreadable
from tilepipe.tiling.grid import Window

LEFT, TOP = 500000.0, 5000000.0


def whole(raster: Raster) -> np.ndarray:
    return raster.read(Window(0, 0, *raster.shape))


def same(a: Any, b: Any) -> bool:
    return np.array_equal(np.asarray(a, np.float32), np.asarray(b, np.float32), equal_nan=True)


def numbers(rows: int = 7, columns: int = 9) -> np.ndarray:
    return np.arange(1, rows * columns + 1, dtype=np.float32).reshape(rows, columns)


def part(folder: Path, values: np.ndarray, row: int, column: int, **options: Any) -> Path:
    """A tile whose first pixel is (row, column) of the grid at (LEFT, TOP)."""
    name = f"part{len(list(folder.iterdir()))}.tif"
    return write_raster(folder / name, values, origin=(LEFT + column, TOP - row), **options)


# --- mosaics


def test_where_tiles_overlap_the_first_valid_value_holds(tmp_path):
    first = np.full((5, 5), 1, np.float32)
    first[4, 4] = np.nan
    a, b = part(tmp_path, first, 0, 0), part(tmp_path, np.full((5, 5), 2, np.float32), 3, 3)
    expected = np.full((8, 8), np.nan)
    expected[3:8, 3:8] = 2
    expected[:5, :5] = 1
    expected[4, 4] = 2
    assert same(whole(open_raster([a, b])), expected)
    expected[3:5, 3:5] = 2
    assert same(whole(open_raster([b, a])), expected)


def test_the_order_of_tiles_does_not_move_the_mosaic(tmp_path):
    tiles = [part(tmp_path, numbers(4, 4) + 100 * i, *at) for i, at in enumerate([(0, 4), (4, 0), (8, 11)])]
    tiles.append(part(tmp_path, numbers(4, 4), 12, 12, crs=CRS("EPSG:32633").to_wkt("WKT1_GDAL")))
    reference = open_raster(tiles)
    assert reference.shape == (16, 16)
    assert reference.geometry.transform == (1, 0, LEFT, 0, -1, TOP)
    for turned in (tiles[::-1], tiles[2:] + tiles[:2]):
        other = open_raster(turned)
        assert other.geometry == reference.geometry
        assert same(whole(other), whole(reference))
    assert np.isnan(whole(reference)).sum() == 16 * 16 - 4 * 16


def test_rounding_of_pixel_and_corner_does_not_depend_on_the_order(tmp_path):
    a = write_raster(tmp_path / "a.tif", numbers(), pixel=0.5, origin=(LEFT, TOP))
    b = write_raster(tmp_path / "b.tif", numbers(), pixel=0.5 + 1e-8, origin=(LEFT + 4.5 + 1e-6, TOP - 1e-6))
    assert open_raster([a, b]).geometry == open_raster([b, a]).geometry
    assert open_raster([a, b]).shape == (7, 18)


@given(data=st.data())
def test_any_window_of_any_mosaic_is_a_slice_of_the_whole(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("mosaic")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**20)))
    rows, columns = 30, 34
    expected = np.full((rows, columns), np.nan, np.float32)
    tiles = []
    for _ in range(data.draw(st.integers(1, 4))):
        shape = rng.integers(3, 16, 2)
        row, column = int(rng.integers(0, rows - shape[0] + 1)), int(rng.integers(0, columns - shape[1] + 1))
        values = rng.integers(0, 50, shape).astype(np.float32)
        values[rng.random(shape) < 0.2] = -9
        tiles.append((part(folder, values, row, column, nodata=-9), row, column))
        target = expected[row : row + shape[0], column : column + shape[1]]
        np.copyto(target, np.where(values == -9, np.nan, values), where=np.isnan(target))
    raster = open_raster([path for path, _, _ in tiles])
    top, left = min(row for _, row, _ in tiles), min(column for _, _, column in tiles)
    expected = expected[top : top + raster.shape[0], left : left + raster.shape[1]]
    assert same(whole(raster), expected)
    low = [data.draw(st.integers(0, n - 1)) for n in raster.shape]
    high = [data.draw(st.integers(a + 1, n)) for a, n in zip(low, raster.shape, strict=True)]
    window = Window(*low, *high)
    assert same(raster.read(window), expected[window.slices])


def test_alignment_with_another_raster(tmp_path):
    a, b = part(tmp_path, numbers(), 0, 0), part(tmp_path, numbers(20, 20), -3, -5)
    assert check_aligned(open_raster([b]), open_raster([a]), "height raster") == Window(-3, -5, 17, 15)
    shifted = write_raster(tmp_path / "shifted.tif", numbers(), origin=(LEFT + 0.5, TOP))
    with pytest.raises(InputError, match=r"height raster .*shifted\.tif.* do not line up"):
        check_aligned(open_raster([shifted]), open_raster([a]), "height raster")


# --- nodata


@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [
        ("uint8", 0),
        ("uint8", 255),
        ("int16", -32768),
        ("uint16", 65535),
        ("int32", -9999),
        ("float32", -9999),
        ("float32", float(np.finfo(np.float32).min)),
        ("float64", -1.7976931348623157e308),
        ("float32", float("nan")),
    ],
)
def test_a_nodata_value_becomes_nan(tmp_path, dtype, nodata):
    values = numbers().astype(dtype)
    values[1, 2] = values[6, 8] = nodata
    expected = numbers()
    expected[1, 2] = expected[6, 8] = np.nan
    raster = open_raster([write_raster(tmp_path / "a.tif", values, nodata=nodata)])
    assert whole(raster).dtype == np.float32
    assert same(whole(raster), expected)


def test_infinities_and_what_float32_cannot_hold_become_nan(tmp_path):
    values = numbers().astype(np.float64)
    values[0, :4] = np.inf, -np.inf, np.nan, 1e300
    expected = numbers()
    expected[0, :4] = np.nan
    assert same(whole(open_raster([write_raster(tmp_path / "a.tif", values)])), expected)
    assert same(whole(open_raster([grid_array(values)])), expected)


@pytest.mark.parametrize("nodata", [None, 5])
def test_a_mask_replaces_a_nodata_value(tmp_path, nodata):
    values, mask = numbers().astype(np.uint8), np.full((7, 9), 255, np.uint8)
    mask[2:4, 3:5] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        path = write_raster(tmp_path / "a.tif", values, nodata=nodata)
        with rasterio.open(path, "r+") as dataset:
            dataset.write_mask(mask)
    assert same(whole(open_raster([path])), np.where(mask == 0, np.nan, numbers()))


def test_scale_and_offset_are_applied(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers().astype(np.int16), nodata=1)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.5,), (100.0,)
    expected = numbers() / 2 + 100
    expected[0, 0] = np.nan
    assert same(whole(open_raster([path])), expected)
    array = grid_array(numbers().astype(np.int16)).assign_attrs(scale_factor=0.5, add_offset=100.0, _FillValue=1)
    array.to_dataset(name="a").to_zarr(tmp_path / "a.zarr", zarr_format=2)
    assert same(whole(open_raster([array])), expected)
    assert same(whole(open_raster([tmp_path / "a.zarr"])), expected)
    decoded = xr.open_zarr(tmp_path / "a.zarr", decode_coords="all")["a"]
    assert same(whole(open_raster([decoded])), expected)


# --- files


def test_bands_are_chosen(tmp_path):
    with rasterio.open(
        tmp_path / "a.tif",
        "w",
        driver="GTiff",
        width=9,
        height=7,
        count=2,
        dtype="float32",
        crs="EPSG:32633",
        transform=from_origin(LEFT, TOP, 1, 1),
    ) as dataset:
        dataset.write(np.stack([numbers(), -numbers()]))
    assert same(whole(open_raster([tmp_path / "a.tif"], band=2)), -numbers())
    with pytest.raises(InputError, match="no band 3; it has 2"):
        open_raster([tmp_path / "a.tif"], band=3)


def _vrt(path: Path, source: Path, shape: tuple[int, int]) -> Path:
    path.write_text(
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>EPSG:32633</SRS>'
        f"<GeoTransform>{LEFT}, 1, 0, {TOP}, 0, -1</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{source.name}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return path


def test_vrt(tmp_path):
    source = write_raster(tmp_path / "a.tif", numbers())
    raster = open_raster([_vrt(tmp_path / "a.vrt", source, (7, 9))])
    assert same(whole(raster), numbers())
    assert raster.geometry.transform == (1, 0, LEFT, 0, -1, TOP)


def test_the_stamp_changes_with_the_content_behind_a_vrt_only(tmp_path):
    source = write_raster(tmp_path / "a.tif", numbers())
    vrt = _vrt(tmp_path / "a.vrt", source, (7, 9))

    def stamp() -> str:
        return open_raster([vrt]).members[0].source.stamp

    before = stamp()
    (tmp_path / "a.vrt.aux.xml").write_text("<PAMDataset></PAMDataset>")
    assert stamp() == before
    write_raster(source, numbers(8, 9)[1:])
    assert stamp() != before


def test_cog_with_overviews(tmp_path):
    values = np.random.default_rng(0).integers(0, 200, (700, 600)).astype(np.uint8)
    plain = write_raster(tmp_path / "a.tif", values, nodata=0)
    from rasterio.shutil import copy

    copy(str(plain), str(tmp_path / "cog.tif"), driver="COG", blocksize=256)
    with rasterio.open(tmp_path / "cog.tif") as dataset:
        assert dataset.overviews(1)
    window = Window(250, 500, 700, 600)
    expected = np.where(values == 0, np.nan, values)[window.slices]
    assert same(open_raster([tmp_path / "cog.tif"]).read(window), expected)


def test_a_file_written_anew_is_read_anew(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    assert same(whole(open_raster([path])), numbers())
    path.unlink()
    write_raster(path, numbers(12, 9))
    assert same(whole(open_raster([path])), numbers(12, 9))


def test_a_damaged_file_is_named(tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (200, 200)).astype(np.uint8)
    path = write_raster(tmp_path / "a.tif", values)
    path.write_bytes(path.read_bytes()[:10000])
    with pytest.raises(InputError, match=r"a\.tif: is damaged, it has 10,000 bytes but its pixels reach to 40,"):
        open_raster([path])


@pytest.mark.parametrize(("terms", "rotated"), [((1e-17, -2.3e-17), False), ((1e-3, -1e-3), False), ((0, 2e-3), True)])
def test_a_rotation_that_moves_no_pixel_is_none(tmp_path, terms, rotated):
    b, d = terms
    path = write_raster(tmp_path / "a.tif", numbers(), transform=rasterio.Affine(1, b, LEFT, d, -1, TOP))
    if rotated:  # by 0.018 pixels at the right side
        with pytest.raises(InputError, match="is rotated"):
            open_raster([path])
    else:
        assert open_raster([path]).geometry.transform == (1, 0, LEFT, 0, -1, TOP)


# --- coordinate reference systems


def test_pixels_in_feet(tmp_path):
    origin = 600000, 900000
    raster = open_raster([write_raster(tmp_path / "a.tif", numbers(), crs="EPSG:2994", pixel=3.0, origin=origin)])
    assert raster.geometry.crs == "EPSG:2994"
    assert raster.geometry.pixel == 3
    assert raster.geometry.resolution == pytest.approx(3 * 0.3048, rel=1e-12)


def test_the_horizontal_part_of_a_compound_crs_counts(tmp_path):
    raster = open_raster([write_raster(tmp_path / "a.tif", numbers(), crs="EPSG:7415", origin=(120000, 480000))])
    assert raster.geometry.crs == "EPSG:28992"
    assert raster.geometry.metres == 1
    plain = write_raster(tmp_path / "b.tif", numbers(), crs="EPSG:28992", origin=(120009, 480000))
    assert open_raster([tmp_path / "a.tif", plain]).shape == (7, 18)


def test_a_named_crs_serves_inputs_that_have_none(tmp_path):
    bare = write_raster(tmp_path / "a.tif", numbers(), crs=None, origin=(120000, 480000))
    assert open_raster([bare], crs="EPSG:28992").geometry.crs == "EPSG:28992"
    with pytest.raises(InputError, match="'EPSG:n' is not understood"):
        open_raster([bare], crs="EPSG:n")
    named = write_raster(tmp_path / "b.tif", numbers(), crs="EPSG:28992", origin=(120009, 480000))
    assert open_raster([bare, named], crs="EPSG:7415").shape == (7, 18)
    with pytest.raises(InputError, match=r"b\.tif: is in Amersfoort / RD New but --crs names WGS 84 / UTM zone 33N"):
        open_raster([named], crs="EPSG:32633")


FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


@pytest.mark.parametrize(
    ("crs", "unit", "metres"),
    [
        ("EPSG:32633", None, 1),
        ("EPSG:32633", "Foot", FOOT),
        ("EPSG:32633", "US survey foot", SURVEY_FOOT),
        ("EPSG:32633", "us-ft", SURVEY_FOOT),
        ("EPSG:32633", "U.S. Survey Feet", SURVEY_FOOT),
        ("EPSG:32633", "Foot_US", SURVEY_FOOT),
        ("EPSG:32633", "dm", 0.1),
        ("EPSG:32633", "Clarke's foot", 0.3047972654),
        ("EPSG:32633", "dn", 1),
        ("EPSG:2994", None, FOOT),
        ("EPSG:2994", "metre", 1),
        ("EPSG:2994+5703", None, 1),
        ("EPSG:2994+5703", "ft", FOOT),
        ("EPSG:32633+6360", None, SURVEY_FOOT),
    ],
)
def test_the_unit_of_heights(tmp_path, crs, unit, metres):
    path = write_raster(tmp_path / "a.tif", numbers(), crs=crs, origin=(600000, 900000))
    if unit is not None:
        with rasterio.open(path, "r+") as dataset:
            dataset.units = (unit,)
    assert open_raster([path]).geometry.height_metres == pytest.approx(metres, rel=1e-12)
    array = rioxarray.open_rasterio(path)
    assert open_raster([array]).geometry.height_metres == pytest.approx(metres, rel=1e-12)


def test_pipelines_take_heights_in_metres(tmp_path):
    from tests.parameters import object_parameters, street_parameters
    from tilepipe.engine.request import AlignedRaster
    from tilepipe.engine.tiles.state import StateArray
    from tilepipe.pipelines.objects.pass_leaves import LeafContext, find_leaves
    from tilepipe.pipelines.streets.pass_segment import SegmentContext, _is_raised
    from tilepipe.tiling.grid import TileGrid

    path = write_raster(tmp_path / "a.tif", np.where(np.arange(900).reshape(30, 30) == 465, 8, 0).astype(np.float32))
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("ft",)
    raster, grid = open_raster([path]), TileGrid((30, 30), (30, 30))
    (tile,) = grid.tiles(0)
    labels = StateArray(tmp_path / "labels.zarr", grid, "int32")
    labels.create()
    facts = find_leaves(LeafContext(raster, object_parameters({}), grid, labels), tile)
    assert facts["highest"].max() == round(8 * FOOT * 1000)
    heights = AlignedRaster(raster, Window(0, 0, 30, 30))
    for most, raised in ((2.0, True), (3.0, False)):
        parameters = street_parameters({"maximum_height": most})
        context = SegmentContext(raster, heights, None, parameters, grid, labels, labels)
        assert _is_raised(context, tile).any() == raised


def test_a_named_crs_may_add_the_unit_of_heights(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    assert open_raster([path], crs="EPSG:32633+6360").geometry.height_metres == pytest.approx(SURVEY_FOOT)


def test_heights_in_an_unknown_unit_are_refused_and_greys_are_not(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("dBZ",)
    raster = open_raster([path])
    with pytest.raises(
        InputError, match=r"a\.tif: its heights are in 'dBZ', .*: m, dm, cm, mm, km, foot, US survey foot"
    ):
        raster.check_heights()
    named = open_raster([path], crs="EPSG:32633+6360")
    named.check_heights()
    assert named.geometry.height_metres == pytest.approx(SURVEY_FOOT)
    with pytest.raises(InputError, match="'dBZ'"):
        tilepipe.plan_objects(path)
    with pytest.raises(InputError, match="'dBZ'"):
        tilepipe.plan_streets(path, height=path)
    assert tilepipe.plan_streets(path).shape == tilepipe.plan_edges(path).shape == (7, 9)


def test_a_mosaic_has_one_unit_of_heights(tmp_path):
    a, b = part(tmp_path, numbers(), 0, 0), part(tmp_path, numbers(), 0, 9)
    with rasterio.open(b, "r+") as dataset:
        dataset.units = ("ft",)
    with pytest.raises(InputError, match=r"part1\.tif: its heights count in units of 0\.3048 m, those of .*part0"):
        open_raster([a, b])


@pytest.mark.parametrize("crs", ["EPSG:4978", "EPSG:5703"])
def test_systems_without_a_map_projection_are_refused(tmp_path, crs):
    bare = write_raster(tmp_path / "a.tif", numbers(), crs=None)
    with pytest.raises(InputError, match="no map projection"):
        open_raster([bare], crs=crs)


# --- arrays and Zarr


def grid_array(values: np.ndarray, *, ascending: bool = False, crs: str = "EPSG:32633", pixel: float = 1.0) -> Any:
    """An xarray array on the grid of `write_raster`, with y up when ``ascending``."""
    rows, columns = values.shape
    y = TOP - pixel * (np.arange(rows) + 0.5)
    array = xr.DataArray(values, dims=("y", "x"), coords={"y": y, "x": LEFT + pixel * (np.arange(columns) + 0.5)})
    return (array.isel(y=slice(None, None, -1)) if ascending else array).rio.write_crs(crs)


ARRANGEMENTS = {
    "plain": lambda a: a,
    "ascending": lambda a: a.isel(y=slice(None, None, -1)),
    "transposed": lambda a: a.transpose("x", "y"),
    "both": lambda a: a.isel(y=slice(None, None, -1)).transpose("x", "y"),
    "band": lambda a: a.expand_dims(band=[1]),
    "band last": lambda a: a.expand_dims(band=[1]).transpose("y", "x", "band"),
    "projection coordinates": lambda a: a.rename(y="northing", x="easting").assign_coords(
        northing=("northing", a.y.values, {"axis": "Y"}), easting=("easting", a.x.values, {"axis": "X"})
    ),
}


@pytest.mark.parametrize("dask", [False, True])
@pytest.mark.parametrize("name", ARRANGEMENTS)
def test_arrays_of_any_arrangement(name, dask):
    array = ARRANGEMENTS[name](grid_array(numbers()))
    raster = open_raster([array.chunk() if dask else array])
    assert raster.geometry.transform == (1, 0, LEFT, 0, -1, TOP)
    assert raster.geometry.crs == "EPSG:32633"
    assert same(whole(raster), numbers())
    assert same(raster.read(Window(2, 3, 6, 9)), numbers()[2:6, 3:9])


@pytest.mark.parametrize("name", ["plain", "ascending", "transposed", "band"])
@pytest.mark.parametrize("consolidated", [False, True])
def test_zarr_stores(tmp_path, name, consolidated):
    values = numbers().astype(np.int16)
    array = ARRANGEMENTS[name](grid_array(values)).rio.write_nodata(7)
    path = tmp_path / "store.zarr"
    array.to_dataset(name="intensity").to_zarr(path, consolidated=consolidated, zarr_format=2)
    raster = open_raster([path])
    assert raster.geometry.transform == (1, 0, LEFT, 0, -1, TOP)
    assert raster.geometry.crs == "EPSG:32633"
    assert same(whole(raster), np.where(values == 7, np.nan, values))


def test_zarr_format_3(tmp_path):
    grid_array(numbers()).rio.write_nodata(7).to_dataset(name="a").to_zarr(
        tmp_path / "a.zarr", zarr_format=3, consolidated=False
    )
    raster = open_raster([tmp_path / "a.zarr"])
    assert same(whole(raster), np.where(numbers() == 7, np.nan, numbers()))
    before = raster.members[0].source.stamp
    assert open_raster([tmp_path / "a.zarr"]).members[0].source.stamp == before
    next(p for p in (tmp_path / "a.zarr" / "a" / "c").rglob("*") if p.is_file()).write_bytes(b"")
    assert open_raster([tmp_path / "a.zarr"]).members[0].source.stamp != before


def test_a_damaged_chunk_of_a_store_is_named(tmp_path):
    grid_array(numbers()).to_dataset(name="a").to_zarr(tmp_path / "a.zarr", zarr_format=3, consolidated=False)
    next(p for p in (tmp_path / "a.zarr" / "a" / "c").rglob("*") if p.is_file()).write_bytes(b"no chunk")
    raster = open_raster([tmp_path / "a.zarr"])
    with pytest.raises(InputError, match=r"a\.zarr: is damaged, its rows 0:7, columns 0:9 cannot be read \(.+\); copy"):
        whole(raster)


def test_zarr_stores_of_several_rasters_are_refused(tmp_path):
    xr.Dataset({"a": grid_array(numbers()), "b": grid_array(numbers())}).to_zarr(tmp_path / "a.zarr", zarr_format=2)
    with pytest.raises(InputError, match="must hold one raster variable, it holds a, b"):
        open_raster([tmp_path / "a.zarr"])


def test_an_array_may_have_a_geotransform_instead_of_coordinates():
    bare = xr.DataArray(numbers(), dims=("y", "x"))
    with pytest.raises(InputError, match="has no coordinates"):
        open_raster([bare.rio.write_crs("EPSG:32633")])
    placed = bare.rio.write_crs("EPSG:32633").rio.write_transform(from_origin(LEFT, TOP, 1, 1))
    assert open_raster([placed]).geometry.transform == (1, 0, LEFT, 0, -1, TOP)


def test_arrays_that_cannot_be_used_are_refused():
    good = grid_array(numbers())
    refused = {
        "not evenly spaced": good.isel(y=[0, 1, 2, 5, 6]),
        "no spatial dimensions": good.rename(y="a", x="b"),
        "no coordinate reference system": good.drop_vars("spatial_ref"),
        "real numbers": good.astype(complex),
        "several|choose one": good.expand_dims(band=2),
        "dimensions": good.expand_dims(band=1, time=1),
        "not square": good.isel(x=slice(None, None, 2)),
    }
    for words, array in refused.items():
        with pytest.raises(InputError, match=words):
            open_raster([array])


def test_a_nodata_value_that_the_dtype_cannot_hold_is_no_value():
    array = grid_array(numbers().astype(np.uint8))
    array.attrs["_FillValue"] = -9999
    assert same(whole(open_raster([array])), numbers())


def test_files_and_arrays_make_one_mosaic(tmp_path):
    path = part(tmp_path, numbers(), 0, 9)
    raster = open_raster([path, grid_array(numbers())])
    assert same(whole(raster), np.hstack([numbers(), numbers()]))


def test_the_stamp_of_an_array_tells_its_values():
    def stamp(array: Any) -> str:
        return open_raster([array]).members[0].source.stamp

    changed = numbers()
    changed[3, 3] = 0
    assert stamp(grid_array(numbers())) == stamp(grid_array(numbers()))
    assert stamp(grid_array(changed)) != stamp(grid_array(numbers()))
    assert stamp(grid_array(numbers()).chunk(4)) != stamp(grid_array(changed).chunk(4))


# --- the mosaic as a lazy array


class Counting:
    """A source that counts its reads."""

    def __init__(self, raster: Raster) -> None:
        self.inner = raster.members[0].source
        self.geometry = raster.geometry
        self.reads = 0

    def read_bands(self, window: Window) -> Iterator[np.ndarray]:
        self.reads += 1
        return self.inner.read_bands(window)


def test_the_lazy_array_reads_nothing_before_it_is_due(tmp_path):
    raster = open_raster([write_raster(tmp_path / "a.tif", numbers(20, 30))])
    source = Counting(raster)
    lazy = as_dataarray(Raster(raster.geometry, (Member(source, Window(0, 0, 20, 30)),)), chunks=8)
    assert lazy.chunks == ((8, 8, 4), (8, 8, 8, 6))
    doubled = 2 * lazy + 1
    assert source.reads == 0
    assert same(doubled[:8, :8].compute(), 2 * numbers(20, 30)[:8, :8] + 1)
    assert source.reads == 1
    assert same(lazy.compute(), whole(raster))


def test_the_lazy_array_is_placed_as_the_mosaic(tmp_path):
    origin = 600000, 900000
    raster = open_raster([write_raster(tmp_path / "a.tif", numbers(), crs="EPSG:2994", pixel=3.0, origin=origin)])
    lazy = as_dataarray(raster, chunks=4)
    assert CRS(lazy.rio.crs) == CRS("EPSG:2994")
    assert tuple(lazy.rio.transform(recalc=True))[:6] == pytest.approx(raster.geometry.transform)
    assert np.isnan(lazy.rio.nodata)
    again = open_raster([lazy])
    assert again.geometry == raster.geometry
    assert same(whole(again), whole(raster))


def test_lazy_arrays_of_different_rasters_do_not_mix(tmp_path):
    a = as_dataarray(open_raster([write_raster(tmp_path / "a.tif", numbers())]))
    b = as_dataarray(open_raster([write_raster(tmp_path / "b.tif", -numbers())]))
    assert same((a + b).compute(), np.zeros((7, 9)))


# --- anywhere


def test_threads_share_a_raster(tmp_path):
    values = np.random.default_rng(0).integers(1, 255, (300, 300)).astype(np.uint8)
    tiles = [part(tmp_path, values[:150], 0, 0), part(tmp_path, values[150:], 150, 0)]
    raster = open_raster(tiles)
    windows = [Window(r, c, r + 40, c + 40) for r in range(0, 260, 20) for c in range(0, 260, 20)]
    with ThreadPoolExecutor(2) as pool:
        blocks = list(pool.map(raster.read, windows))
    assert all(same(block, values[window.slices]) for block, window in zip(blocks, windows, strict=True))


def test_a_thread_keeps_few_files_open(tmp_path, monkeypatch):
    from tilepipe.io.rasters.sources import source

    monkeypatch.setattr(source, "_OPEN_FILES", 2)
    tiles = [part(tmp_path, numbers() + i, 0, 9 * i) for i in range(5)]
    raster = open_raster(tiles)

    def read_twice() -> list[str]:
        for _ in range(2):
            assert same(whole(raster), np.hstack([numbers() + i for i in range(5)]))
        return [path for path, _ in source._local.datasets]

    with ThreadPoolExecutor(1) as fresh_thread:
        assert fresh_thread.submit(read_twice).result() == [str(path) for path in tiles[-2:]]


def test_a_raster_can_be_sent(tmp_path):
    lazy = grid_array(numbers()).assign_coords(x=lambda a: a.x + 18)
    lazy = lazy.copy(data=da.from_array(numbers(), chunks=4))
    inputs = [part(tmp_path, numbers(), 0, 0), grid_array(numbers()).assign_coords(x=lambda a: a.x + 9), lazy]
    raster = open_raster(inputs)
    whole(raster)
    again = pickle.loads(pickle.dumps(raster))
    assert isinstance(again.members[0].source, FileSource)
    assert again.geometry == raster.geometry
    assert same(whole(again), whole(raster))
    assert same(whole(again), np.hstack([numbers()] * 3))


@pytest.mark.parametrize(
    ("path", "advice"),
    [
        ("a.tif", "copy the file anew"),
        ("/vsizip/a.zip/b.tif", "pack the file anew"),
        ("/vsizip//zones/a.zip/b.tif", "pack the file anew"),
        ("/vsizip//data/a.zip/b.tif", "pack the file anew"),
        ("/vsicurl/https://host/a.tif", "check the network and run the same command again"),
    ],
)
def test_what_can_be_done_about_a_damaged_file(path, advice):
    assert _unreadable(path, "rows 0:7", RuntimeError("why")).endswith(advice)
