"""Rasters as GDAL writes them: Zarr stores, files of several rasters, what is tied to the map by points only."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import rasterio
import zarr
from pyproj import CRS
from rasterio.control import GroundControlPoint
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import from_origin

from tilepipe.errors import InputError
from tilepipe.io.rasters.raster import open_raster
from tilepipe.tiling.grid import Window

VALUES = np.add.outer(np.arange(12), np.arange(20)).astype(np.float32)
PLACE = {"crs": "EPSG:32631", "transform": from_origin(500000, 5000000, 0.5, 0.5)}


def write(path, values, driver="GTiff", **options):
    bands = values if values.ndim == 3 else values[None]
    count, height, width = bands.shape
    profile = {"driver": driver, "count": count, "height": height, "width": width, "dtype": bands.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile, **options) as dataset:
            dataset.write(bands)
    return path


def read(path, **how):
    raster = open_raster([path], **how)
    return raster, raster.read(Window(0, 0, *raster.shape))


# --- Zarr


@pytest.mark.parametrize("nodata", [None, 7.0])
def test_a_zarr_store_of_gdal(tmp_path, nodata):
    path = write(tmp_path / "a.zarr", VALUES, "Zarr", nodata=nodata, BLOCKSIZE="5,8", **PLACE)
    raster, found = read(path)
    geometry = raster.geometry
    assert (geometry.crs, geometry.left, geometry.top, geometry.pixel) == ("EPSG:32631", 500000, 5000000, 0.5)
    assert np.array_equal(found, np.where(nodata == VALUES, np.nan, VALUES), equal_nan=True)


def test_bands_and_scales_of_a_zarr_store_of_gdal(tmp_path):
    bands = np.stack([VALUES, 2 * VALUES]).astype(np.int16)
    path = write(tmp_path / "a.zarr", bands, "Zarr", **PLACE)
    for name, more in ((".zattrs", {"scale_factor": 0.1, "add_offset": 5.0}), (".zarray", {"fill_value": 7})):
        described = path / "a" / name
        described.write_text(json.dumps(json.loads(described.read_text()) | more))
    expected = np.where(bands[1] == 7, np.nan, np.float32(bands[1] * 0.1 + 5))
    # of a store of several bands GDAL writes no CRS
    assert np.allclose(read(path, crs="EPSG:32631", band=2)[1], expected, equal_nan=True)


def test_a_zarr_store_of_gdal_without_crs_or_in_degrees(tmp_path):
    path = write(tmp_path / "a.zarr", VALUES, "Zarr", transform=PLACE["transform"])
    with pytest.raises(InputError, match="no coordinate reference system; pass --crs"):
        open_raster([path])
    assert np.array_equal(read(path, crs="EPSG:32631")[1], VALUES)
    degrees = write(tmp_path / "b.zarr", VALUES, "Zarr", crs="EPSG:4326", transform=from_origin(3, 45, 1e-3, 1e-3))
    with pytest.raises(InputError, match=r"b\.zarr: is in degrees \(WGS 84\); reproject it"):
        open_raster([degrees])


def test_a_zarr_store_of_format_3_that_only_gdal_reads(tmp_path, capfd):
    """GDAL before 3.11 leaves out what the format asks for."""
    path = write(tmp_path / "a.zarr", VALUES, "Zarr", FORMAT="ZARR_V3", **PLACE)
    for described in path.rglob("zarr.json"):
        text = json.loads(described.read_text())
        text.pop("codecs", None)
        described.write_text(json.dumps(text))
    with pytest.raises(InputError, match=r"a\.zarr: is no Zarr raster .*zarr\.json has no codecs\); write it anew"):
        open_raster([path])
    assert capfd.readouterr().err == ""


def zarr_3(path, fill, dims=("Y", "X"), **attributes):
    """A store of format 3 as GDAL means it, written by zarr; its lower half is not written."""
    group = zarr.open_group(path, mode="w", zarr_format=3)
    for dim, centres in zip(dims, (5000000 - 0.25 - 0.5 * np.arange(12), 500000.25 + 0.5 * np.arange(20)), strict=True):
        axis = group.create_array(dim, shape=centres.shape, dtype="float64", dimension_names=(dim,))
        axis[:] = centres
    stored = group.create_array(
        "a", shape=(12, 20), chunks=(6, 20), dtype="int16", fill_value=fill, dimension_names=dims
    )
    stored[:6] = VALUES[:6].astype(np.int16)
    stored.attrs.update(attributes)
    return path


@pytest.mark.parametrize(("fill", "is_nodata"), [(5, True), (0, False)])
def test_the_fill_value_of_format_3_is_nodata_unless_it_is_the_default(tmp_path, fill, is_nodata):
    named = {"_CRS": {"url": "http://www.opengis.net/def/crs/EPSG/0/32631"}}
    raster, found = read(zarr_3(tmp_path / "a.zarr", fill, **named))
    expected = np.where(np.arange(12)[:, None] < 6, VALUES, fill).astype(np.float32)
    if is_nodata:
        expected[expected == fill] = np.nan
    assert raster.geometry.crs == "EPSG:32631"
    assert np.array_equal(found, expected, equal_nan=True)


@pytest.mark.parametrize("form", ["url", "wkt", "projjson"])
def test_any_form_of_the_crs_that_gdal_writes(tmp_path, form):
    crs = CRS("EPSG:2056")
    named = {"url": "http://www.opengis.net/def/crs/EPSG/0/2056", "wkt": crs.to_wkt(), "projjson": crs.to_json_dict()}
    path = zarr_3(tmp_path / "a.zarr", 0, _CRS={form: named[form]})
    assert open_raster([path]).geometry.crs == "EPSG:2056"
    zarr_3(path, 0, _CRS={form: "nowhere"})
    with pytest.raises(InputError, match=r"a\.zarr: CRS 'nowhere' is not understood|no CRS is named 'nowhere'"):
        open_raster([path])


@pytest.mark.parametrize("dims", [("lat", "lon"), ("Latitude", "Longitude")])
def test_longitude_and_latitude_without_a_crs_are_degrees(tmp_path, dims):
    with pytest.raises(InputError, match=r"is in degrees \(WGS 84\)"):
        open_raster([zarr_3(tmp_path / "a.zarr", 0, dims)])


# --- other files


def test_pages_of_a_tiff_are_several_rasters(tmp_path):
    path = write(tmp_path / "a.tif", VALUES, **PLACE)
    write(path, -VALUES, append_subdataset=True, **PLACE)
    with pytest.raises(InputError, match=r"a\.tif: holds 2 rasters; write one out first: gdal_translate GTIFF_DIR:1:"):
        open_raster([path])


def test_overviews_and_a_mask_are_no_rasters(tmp_path):
    path = write(tmp_path / "a.tif", VALUES, **PLACE)
    mask = np.where(VALUES > 9, 255, 0).astype(np.uint8)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
        dataset.build_overviews([2, 4])
    assert np.array_equal(read(path)[1], np.where(mask > 0, VALUES, np.nan), equal_nan=True)


@pytest.mark.parametrize("crs", [None, "EPSG:32631"])
def test_what_only_points_tie_to_the_map_is_to_be_warped(tmp_path, crs):
    corners = [(0, 0, 5e5, 5e6), (0, 20, 500010, 5e6), (12, 0, 5e5, 4999994), (12, 20, 500010, 4999994)]
    path = write(tmp_path / "a.tif", VALUES)
    with rasterio.open(path, "r+") as dataset:
        dataset.gcps = [GroundControlPoint(*each) for each in corners], rasterio.crs.CRS.from_epsg(32631)
    with pytest.raises(InputError, match=r"tied to the map by ground control points only; warp it first: gdalwarp"):
        open_raster([path], crs=crs)


@pytest.mark.parametrize("crs", [None, "EPSG:32631"])
def test_a_raster_without_origin_has_no_georeferencing(tmp_path, crs):
    path = write(tmp_path / "a.tif", VALUES, crs=crs)
    with pytest.raises(InputError, match=r"a\.tif: has no georeferencing; give it an origin and a pixel size"):
        open_raster([path])


@pytest.mark.parametrize("bits", [2, 4])
def test_integers_of_few_bits(tmp_path, bits):
    values = (VALUES % 2**bits).astype(np.uint8)
    assert np.array_equal(read(write(tmp_path / "a.tif", values, nbits=bits, **PLACE))[1], values)


@pytest.mark.parametrize("dtype", ["int64", "uint64", "int8"])
def test_integers_of_any_size(tmp_path, dtype):
    path = write(tmp_path / "a.tif", VALUES.astype(dtype), nodata=7, **PLACE)
    assert np.array_equal(read(path)[1], np.where(VALUES == 7, np.nan, VALUES), equal_nan=True)


@pytest.mark.parametrize(("driver", "name", "world"), [("PNG", "a.png", "a.pgw"), ("JP2OpenJPEG", "a.jp2", "a.j2w")])
def test_pictures_with_a_world_file(tmp_path, driver, name, world):
    lossless = {"QUALITY": "100", "REVERSIBLE": "YES"} if driver == "JP2OpenJPEG" else {}
    path = write(tmp_path / name, VALUES.astype(np.uint8), driver, **lossless)
    (tmp_path / f"{name}.aux.xml").unlink(missing_ok=True)
    (tmp_path / world).write_text("0.5\n0\n0\n-0.5\n500000.25\n4999999.75\n")
    raster, found = read(path, crs="EPSG:32631")
    assert (raster.geometry.left, raster.geometry.top, raster.geometry.pixel) == (500000, 5000000, 0.5)
    assert np.array_equal(found, VALUES)
