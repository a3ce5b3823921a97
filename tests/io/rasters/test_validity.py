"""What GDAL calls invalid is invalid here: nodata values, masks, alpha and palettes, in files and in arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rioxarray
import xarray as xr
import zarr
from rasterio.enums import ColorInterp
from rasterio.errors import NodataShadowWarning
from rasterio.transform import from_origin
from rasterio.windows import Window as FileWindow

from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.io.rasters.bands import Bands, Choice
from tilepipe.io.rasters.raster import Raster, open_bands, open_raster
from tilepipe.io.rasters.validity import is_nodata
from tilepipe.pipelines.edges.pass_bands import LUMINANCE, open_photograph
from tilepipe.tiling.grid import Window

SHAPE = (12, 14)
WHOLE = Window(0, 0, *SHAPE)
RED, GREEN, BLUE, ALPHA, GRAY, OTHER = (
    getattr(ColorInterp, name) for name in ("red", "green", "blue", "alpha", "gray", "undefined")
)


def write(path: Path, bands: Any, meanings: Any = None, tags: Any = None, mask: Any = None, **profile: Any) -> Path:
    """A GeoTIFF of several bands."""
    bands = np.asarray(bands)
    profile = {"transform": from_origin(500000, 5000000, 1, 1), "crs": "EPSG:32633", "dtype": bands.dtype} | profile
    with rasterio.open(
        path, "w", driver="GTiff", count=len(bands), height=bands.shape[1], width=bands.shape[2], **profile
    ) as file:
        if meanings is not None:
            file.colorinterp = meanings
        file.write(bands)
        file.update_tags(**(tags or {}))
        if mask is not None:
            file.write_mask(mask)
    return path


def image(count: int, dtype: str = "uint8") -> np.ndarray:
    """Bands without any 0."""
    return np.random.default_rng(count).integers(1, 120, (count, *SHAPE)).astype(dtype)


def void(raster: Raster) -> np.ndarray:
    """Void pixels, the same in all bands."""
    found = [np.isnan(band) for band in raster.read_bands(WHOLE)]
    assert len(found) == raster.bands
    assert all(np.array_equal(found[0], other) for other in found[1:])
    return found[0]


def grey_void(path: Any) -> np.ndarray:
    photograph = open_photograph([path], crs=None, band=None, grey="automatic")
    if photograph.weights is None:
        return void(photograph.raster)
    return np.isnan(photograph.read(WHOLE))


def masked(path: Path, band: int = 1) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read_masks(band) == 0


def masked_together(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.dataset_mask() == 0


# --- nodata values

LOWEST = float(np.finfo(np.float32).min)
NODATA = [
    ("float32", -3.40282346639e38, LOWEST, True),  # written with 12 digits
    ("float32", -3.40282306074e38, LOWEST, True),  # and otherwise rounded
    ("float32", -9999.9, np.float32(-9999.9), True),
    ("float32", np.inf, np.inf, True),
    ("float32", np.nan, np.nan, True),
    ("float64", -1.7976931348623e308, -1.7976931348623157e308, True),
    ("float64", -9999.9, -9999.9, True),
    ("float32", -9999, -9999.001, True),
    ("float32", -9999, -9999.01, False),
    ("float64", -9999.9, float(np.float32(-9999.9)), True),
    ("float64", 0.1, 0.1 + 1e-6, False),
    ("int64", -9999, -9999, True),
    ("int64", 2**53, 2**53 + 2, False),
    ("int32", -(2**31), -(2**31), True),
    ("int8", -128, -128, True),
    ("uint16", 65535, 65535, True),
    ("uint8", 0, 0, True),
]


@pytest.mark.parametrize(("dtype", "nodata", "stored", "expected"), NODATA)
def test_a_nodata_value_is_compared_as_gdal_does(tmp_path, dtype, nodata, stored, expected):
    values = image(1)[0].astype(dtype)
    values[3, 4] = stored
    path = write_raster(tmp_path / "a.tif", values, nodata=nodata)
    assert masked(path)[3, 4] == expected
    found = open_raster([path]).read(WHOLE)
    assert np.isnan(found)[3, 4] == expected
    assert np.isnan(found).sum() == expected
    array = rioxarray.open_rasterio(path).assign_attrs(_FillValue=nodata)
    assert np.array_equal(open_raster([array]).read(WHOLE), found, equal_nan=True)
    assert np.array_equal(is_nodata(values, nodata) | np.isinf(values), np.isnan(found))


@pytest.mark.parametrize("dtype", ["int64", "uint64"])
def test_whole_numbers_of_64_bits_are_compared_exactly(dtype):
    largest = int(np.iinfo(dtype).max)
    values = np.array([largest, largest - 1, 2**53, 2**53 + 1], dtype)
    assert is_nodata(values, largest).tolist() == [True, False, False, False]
    assert is_nodata(values, 2**53 + 1).tolist() == [False, False, False, True]
    array = xr.DataArray(np.full(SHAPE, 7, dtype), {"y": -np.arange(12.0), "x": np.arange(14.0)}, ("y", "x"))
    array[2, 3], array[2, 4] = largest, largest - 1
    array.attrs["_FillValue"] = np.dtype(dtype).type(largest)
    assert np.argwhere(np.isnan(open_raster([array], crs="EPSG:32633").read(WHOLE))).tolist() == [[2, 3]]


@pytest.mark.parametrize("zarr_format", [2, 3])
@pytest.mark.parametrize(("stored", "said", "nodata"), [("int8", "true", 255), ("uint8", "false", -1)])
def test_integers_have_the_sign_that_their_attribute_says(tmp_path, zarr_format, stored, said, nodata):
    values = np.arange(168, dtype=np.uint8).view(stored).reshape(SHAPE)
    values[3] = np.array(nodata).astype(stored)
    array = xr.DataArray(values, {"y": -np.arange(12.0), "x": np.arange(14.0)}, ("y", "x"))
    array = array.assign_attrs(_Unsigned=said, _FillValue=np.dtype(stored).type(values[3, 0]))
    array.to_dataset(name="a").to_zarr(tmp_path / "a.zarr", zarr_format=zarr_format, consolidated=False)
    expected = np.arange(168, dtype=np.uint8).view("uint8" if said == "true" else "int8").reshape(SHAPE).astype(float)
    expected[3] = np.nan
    expected[expected == nodata] = np.nan
    undecoded = xr.open_zarr(tmp_path / "a.zarr", mask_and_scale=False, consolidated=False)["a"]
    for raster in (array, undecoded, tmp_path / "a.zarr"):
        assert np.array_equal(open_raster([raster], crs="EPSG:32633").read(WHOLE), expected, equal_nan=True)


@pytest.mark.parametrize("nodata", [-9999, 256, 0.5, np.nan])
def test_a_nodata_value_that_no_value_can_be_is_none(nodata):
    assert not is_nodata(np.arange(256, dtype=np.uint8), nodata).any()


def test_nodata_is_a_stored_value(tmp_path):
    path = write_raster(tmp_path / "a.tif", np.arange(168, dtype=np.int32).reshape(SHAPE) + 2_000_000_000, nodata=2e9)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (1e-3,), (-2e6,)
    expected = (np.arange(168) / 1e3).reshape(SHAPE)
    expected[0, 0] = np.nan
    # 2,000,000,100 · 0.001 - 2,000,000 = 0.1, although float32 knows no 2,000,000,100
    assert np.allclose(open_raster([path]).read(WHOLE), expected, rtol=0, atol=1e-8, equal_nan=True)
    assert np.allclose(
        open_raster([rioxarray.open_rasterio(path)]).read(WHOLE), expected, rtol=0, atol=1e-8, equal_nan=True
    )


# --- photographs


@pytest.fixture
def photograph() -> np.ndarray:
    """Red, green and blue with a black collar and a roof without blue."""
    values = image(3)
    values[:, :, :3] = 0
    values[2, 5:8, 6:10] = 0
    return values


COLLAR = np.zeros(SHAPE, bool)
COLLAR[:, :3] = True


@pytest.mark.parametrize("meanings", [(RED, GREEN, BLUE), (GRAY, OTHER, OTHER)])
def test_a_pixel_of_a_photograph_is_void_where_all_bands_are(tmp_path, photograph, meanings):
    for options in ({"nodata": 0}, {"tags": {"NODATA_VALUES": "0 0 0"}}):
        path = write(tmp_path / "a.tif", photograph, meanings, **options)
        assert np.array_equal(masked_together(path), COLLAR)
        assert np.array_equal(grey_void(path), COLLAR)
    values = open_photograph([path], crs=None, band=None, grey="automatic").read(WHOLE)
    expected = np.tensordot(np.float32(LUMINANCE), photograph, 1)
    assert np.allclose(values[~COLLAR], expected[~COLLAR])
    array = xr.DataArray(photograph, {"y": -np.arange(12.0), "x": np.arange(14.0)}, ("band", "y", "x"))
    array = array.rio.write_crs("EPSG:32633").assign_attrs(_FillValue=0)
    assert np.array_equal(grey_void(array), COLLAR)
    assert np.array_equal(grey_void(array.chunk(y=5)), COLLAR)


def test_the_near_infrared_tells_that_a_black_pixel_is_none(tmp_path, photograph):
    values = np.concatenate([photograph, image(1)])
    values[3, 0] = 0
    path = write(tmp_path / "a.tif", values, (RED, GREEN, BLUE, OTHER), nodata=0, photometric="RGB", alpha="no")
    expected = COLLAR.copy()
    expected[1:] = False
    assert np.array_equal(grey_void(path), expected)


def test_one_band_of_a_photograph_is_void_as_gdal_says(tmp_path, photograph):
    path = write(tmp_path / "a.tif", photograph, (RED, GREEN, BLUE), nodata=0)
    assert np.array_equal(np.isnan(open_raster([path], band=3).read(WHOLE)), masked(path, 3))
    assert masked(path, 3).sum() == COLLAR.sum() + 12
    path = write(tmp_path / "b.tif", photograph, (RED, GREEN, BLUE), tags={"NODATA_VALUES": "0 0 0"})
    assert np.array_equal(np.isnan(open_raster([path], band=3).read(WHOLE)), COLLAR)


def test_each_band_has_a_type_a_scale_and_a_nodata_value_of_its_own(tmp_path):
    """GDAL's VRT may hold bands that have nothing in common."""
    kinds, nodata, scales, offsets = ("uint8", "int16", "float32"), (3, -7, 0.5), (1, 2, 0.25), (0, 10, -5)
    bands, stored = [], []
    for number, kind in enumerate(kinds):
        values = image(number + 1)[0].astype(kind)
        values[number, : number + 2] = nodata[number]
        write(tmp_path / f"{number}.tif", values[None])
        stored.append(values.astype(np.float64))
        gdal = ("Byte", "Int16", "Float32")[number]
        bands.append(
            f'<VRTRasterBand dataType="{gdal}" band="{number + 1}"><NoDataValue>{nodata[number]}</NoDataValue>'
            f"<Scale>{scales[number]}</Scale><Offset>{offsets[number]}</Offset><SimpleSource>"
            f'<SourceFilename relativeToVRT="1">{number}.tif</SourceFilename><SourceBand>1</SourceBand>'
            "</SimpleSource></VRTRasterBand>"
        )
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}"><SRS>EPSG:32633</SRS>'
        f"<GeoTransform>500000, 1, 0, 5000000, 0, -1</GeoTransform>{''.join(bands)}</VRTDataset>"
    )
    for number in range(3):
        void = stored[number] == nodata[number]
        expected = np.where(void, np.nan, stored[number] * scales[number] + offsets[number])
        read = next(iter(open_raster([tmp_path / "a.vrt"], band=number + 1).read_bands(WHOLE)))
        assert np.array_equal(read, expected.astype(np.float32), equal_nan=True), kinds[number]


@pytest.mark.parametrize("wrong", [-9999, np.nan, np.inf])
def test_what_is_no_colour_in_one_band_makes_the_pixel_void(tmp_path, wrong):
    values = image(3, "float32")
    values[1, 4, 5] = wrong
    path = write(tmp_path / "a.tif", values, nodata=None if wrong == np.inf else wrong)
    assert np.argwhere(grey_void(path)).tolist() == [[4, 5]]
    array = rioxarray.open_rasterio(path)
    assert np.argwhere(grey_void(array)).tolist() == [[4, 5]]


def test_a_pixel_comes_from_one_photograph_of_a_mosaic(tmp_path):
    first, second = image(3, "float32"), 200 + image(3, "float32")
    first[1, 4, 5] = np.nan
    paths = [write(tmp_path / f"{name}.tif", values) for name, values in (("a", first), ("b", second))]
    found = np.stack(list(open_bands(paths, Choice((1, 2, 3))).read_bands(WHOLE)))
    first[:, 4, 5] = second[:, 4, 5]
    assert np.array_equal(found, first)


def test_the_colours_of_a_mosaic_are_those_that_each_file_names(tmp_path):
    values = image(3)
    paths = [
        write(tmp_path / "rgb.tif", values, (RED, GREEN, BLUE)),
        write(tmp_path / "bgr.tif", values[::-1], (BLUE, GREEN, RED), transform=from_origin(500014, 5000000, 1, 1)),
    ]
    grey = open_photograph(paths, crs=None, band=None, grey="automatic").read(Window(0, 0, 12, 28))
    assert np.array_equal(grey[:, :14], grey[:, 14:])


# --- masks and alpha


@pytest.mark.parametrize("internal", [True, False])
@pytest.mark.parametrize("nodata", [None, 0])
def test_the_mask_of_a_file_takes_the_place_of_nodata(tmp_path, photograph, internal, nodata):
    mask = np.full(SHAPE, 255, np.uint8)
    mask[:, 9:] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal):
        path = write(tmp_path / "a.tif", photograph, (RED, GREEN, BLUE), nodata=nodata, mask=mask)
    assert (tmp_path / "a.tif.msk").exists() != internal
    assert np.array_equal(masked(path), mask == 0)
    assert np.array_equal(np.isnan(open_raster([path], band=3).read(WHOLE)), mask == 0)
    assert np.array_equal(grey_void(path), mask == 0)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize(
    "meanings",
    [
        (RED, GREEN, BLUE, ALPHA),
        (ALPHA, RED, GREEN, BLUE),
        (RED, GREEN, BLUE, OTHER, ALPHA),
        (BLUE, ALPHA, GREEN, RED),
        (GRAY, ALPHA),
        (ALPHA, GRAY),
    ],
)
def test_alpha_is_a_mask_wherever_it_lies(tmp_path, dtype, meanings):
    values = image(len(meanings), dtype)
    opacity = values[meanings.index(ALPHA)]
    opacity[:4], opacity[4:8], opacity[8:] = 0, 1, 255  # partly transparent counts
    path = write(tmp_path / "a.tif", values, meanings, photometric="MINISBLACK")
    with rasterio.open(path) as file:
        assert file.colorinterp == meanings
    assert np.array_equal(grey_void(path), opacity == 0)
    data = next(number for number, meaning in enumerate(meanings, 1) if meaning != ALPHA)
    assert np.array_equal(np.isnan(open_raster([path], band=data).read(WHOLE)), opacity == 0)
    if len(meanings) == 2:
        # the only band of data needs no choice
        assert np.array_equal(open_raster([path]).read(WHOLE)[4:], values[data - 1, 4:])
    with pytest.raises(InputError, match=f"band {meanings.index(ALPHA) + 1} is alpha"):
        open_raster([path], band=meanings.index(ALPHA) + 1)


@pytest.mark.filterwarnings("error::rasterio.errors.NodataShadowWarning")
def test_alpha_takes_the_place_of_the_nodata_values_of_a_photograph(tmp_path, photograph):
    opacity = np.full((1, *SHAPE), 255, np.uint8)
    opacity[0, :2] = 0
    path = write(tmp_path / "a.tif", np.concatenate([photograph, opacity]), (RED, GREEN, BLUE, ALPHA), nodata=0)
    with pytest.warns(NodataShadowWarning):
        together, alone = masked_together(path), masked(path)
    assert np.array_equal(together, opacity[0] == 0)
    assert np.array_equal(grey_void(path), together)
    # of one band, both count
    assert np.array_equal(np.isnan(open_raster([path], band=1).read(WHOLE)), alone | together)


def test_bands_are_counted_without_alpha(tmp_path):
    path = write(tmp_path / "a.tif", image(4), (RED, GREEN, BLUE, ALPHA))
    with pytest.raises(InputError, match="has 3 bands; choose one with --band"):
        open_raster([path])
    path = write(tmp_path / "b.tif", image(1), (ALPHA,))
    with pytest.raises(InputError, match="no band but alpha"):
        open_raster([path])
    assert Bands.of(["alpha", "gray"]).image == (2,)


def test_bands_of_arrays_have_names(tmp_path):
    values = image(4)
    values[0, :4] = 0
    coordinates = {"band": ["alpha", "Red", "Green", "Blue"], "y": -np.arange(12.0), "x": np.arange(14.0)}
    array = xr.DataArray(values, coordinates, ("band", "y", "x")).rio.write_crs("EPSG:32633")
    opened = open_photograph([array], crs=None, band=None, grey="automatic")
    assert opened.conversion == "luminance"
    assert np.array_equal(np.isnan(opened.read(WHOLE)), values[0] == 0)
    assert np.allclose(opened.read(WHOLE)[4:], np.tensordot(np.float32(LUMINANCE), values[1:], 1)[4:])


# --- palettes


def test_a_palette_stands_for_its_colours(tmp_path):
    indices = np.random.default_rng(0).integers(0, 40, SHAPE).astype(np.uint8)
    indices[0] = 39
    colours = np.random.default_rng(1).integers(0, 256, (40, 3))
    path = write(tmp_path / "a.tif", indices[None], photometric="palette", nodata=39)
    with rasterio.open(path, "r+") as file:
        file.write_colormap(1, {index: (*colour, 255) for index, colour in enumerate(colours.tolist())})
    for band in (None, 1):
        opened = open_photograph([path], crs=None, band=band, grey="automatic")
        assert opened.conversion == "luminance"
        expected = np.tensordot(colours[indices].astype(np.float32), np.float32(LUMINANCE), 1)
        expected[indices == 39] = np.nan
        assert np.allclose(opened.read(WHOLE), expected, equal_nan=True)
    rgb = write(tmp_path / "rgb.tif", np.moveaxis(colours[indices], 2, 0).astype(np.uint8), (RED, GREEN, BLUE))
    whole = open_photograph([rgb], crs=None, band=None, grey="automatic").read(WHOLE)
    assert np.allclose(opened.read(WHOLE)[1:], whole[1:], equal_nan=True) == (39 not in indices[1:])
    assert open_photograph([path], crs=None, band=None, grey="principal").weights is None
    # a mosaic may have some tiles with a palette
    mixed = open_photograph([rgb, path], crs=None, band=None, grey="automatic").read(WHOLE)
    assert np.array_equal(mixed, whole)
    with pytest.raises(InputError, match="indices of a palette of colours, which measure nothing"):
        open_raster([path])


# --- ranges of valid values (CF)

RANGES = [
    # stored dtype, attributes, valid values
    ("float32", {"valid_range": [20, 100]}, (20, 100)),
    ("float32", {"valid_max": 0.1}, (-np.inf, np.float32(0.1))),  # in the precision of the values
    ("int16", {"valid_min": 20}, (20, np.inf)),
    ("int16", {"valid_min": 20, "valid_max": 100, "_FillValue": 50}, (20, 100)),
    ("int8", {"valid_range": [10, -56], "_Unsigned": "true"}, (10, 200)),
    ("int16", {"valid_range": [20, 100], "scale_factor": 0.5, "add_offset": 7.0}, (17, 57)),
    ("int16", {"valid_range": [20.0, 50.0], "scale_factor": 0.5, "add_offset": 7.0}, (20, 50)),
]


@pytest.mark.parametrize("opened", ["array", "lazy", "store", "decoded"])
@pytest.mark.parametrize(("dtype", "attributes", "valid"), RANGES)
def test_what_lies_outside_the_valid_range_is_void(tmp_path, opened, dtype, attributes, valid):
    stored = (np.arange(168).reshape(SHAPE) / (10 if dtype == "float32" and "valid_max" in attributes else 1)).astype(
        dtype
    )
    meant = stored.view("uint8") if "_Unsigned" in attributes else stored
    expected = (meant * attributes.get("scale_factor", 1.0) + attributes.get("add_offset", 0.0)).astype(np.float32)
    outside = (expected < valid[0]) | (expected > valid[1])
    expected[outside | (meant == attributes.get("_FillValue", np.inf))] = np.nan
    array = xr.DataArray(stored, {"y": -np.arange(12.0), "x": np.arange(14.0)}, ("y", "x"), name="a", attrs=attributes)
    if opened != "array":
        array.attrs.update({k: np.dtype(dtype).type(v) for k, v in attributes.items() if k == "_FillValue"})
        array.to_zarr(tmp_path / "a.zarr", zarr_format=2, consolidated=False)
        lazy = xr.open_zarr(tmp_path / "a.zarr", mask_and_scale=opened == "decoded", consolidated=False)["a"]
        array = tmp_path / "a.zarr" if opened == "store" else lazy
    assert np.array_equal(open_raster([array], crs="EPSG:32633").read(WHOLE), expected, equal_nan=True)


@pytest.mark.parametrize("given", [{"valid_range": 3}, {"valid_range": [1, 2, 3]}, {"valid_min": "low"}])
def test_a_valid_range_is_two_numbers(given):
    array = xr.DataArray(np.zeros(SHAPE), {"y": -np.arange(12.0), "x": np.arange(14.0)}, ("y", "x"), attrs=given)
    with pytest.raises(InputError, match="its attribute valid_range must be two numbers, not"):
        open_raster([array], crs="EPSG:32633")


def test_the_valid_range_of_heights_is_not_that_of_their_ground():
    import tilepipe.accessor  # noqa: F401

    heights = xr.DataArray(np.full((80, 80), 900, np.int16), dims=("y", "x"))
    packed = heights.assign_attrs(scale_factor=0.1, valid_range=[500, 1000])
    ground = packed.tilepipe.ground(resolution=1.0, largest_object=10)
    assert "valid_range" not in ground.attrs
    assert np.allclose(ground, 90)


# --- Zarr


@pytest.mark.parametrize(
    ("zarr_format", "fill", "attributes", "nodata"),
    [
        (2, 0, {}, [0]),
        (2, None, {}, []),
        (2, 0, {"missing_value": 5}, [0, 5]),
        (3, 0, {}, []),  # only what an unwritten chunk holds
        (3, 0, {"_FillValue": 5}, [5]),
        (3, 0, {"missing_value": 5}, [5]),
        (3, 5, {"_FillValue": 5, "missing_value": [6, 7]}, [5, 6, 7]),
    ],
)
def test_zarr_says_what_is_nodata_as_its_format_has_it(tmp_path, zarr_format, fill, attributes, nodata):
    values = np.arange(64, dtype=np.int16).reshape(8, 8)
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=zarr_format)
    named = {"dimension_names": ("y", "x")} if zarr_format == 3 else {}
    stored = group.create_array("a", shape=(8, 8), chunks=(4, 4), dtype="int16", fill_value=fill, **named)
    stored[:4] = values[:4]  # the lower half is not written
    transform = "500000 1 0 5000000 0 -1"
    stored.attrs.update({"_ARRAY_DIMENSIONS": ["y", "x"], "grid_mapping": "spatial_ref"} | attributes)
    reference = group.create_array("spatial_ref", shape=(), dtype="int32", **({"dimension_names": ()} if named else {}))
    reference.attrs.update({"_ARRAY_DIMENSIONS": [], "crs_wkt": _wkt(), "GeoTransform": transform})
    expected = np.where(np.arange(8)[:, None] < 4, values, fill or 0).astype(np.float32)
    expected[np.isin(expected, nodata)] = np.nan
    found = open_raster([tmp_path / "a.zarr"]).read(Window(0, 0, 8, 8))
    assert np.array_equal(found, expected, equal_nan=True)
    if len(nodata) < 2:
        decoded = xr.open_zarr(tmp_path / "a.zarr", consolidated=False)["a"]
        assert np.array_equal(found, decoded.values.astype(np.float32), equal_nan=True)


def _wkt() -> str:
    from pyproj import CRS

    return CRS("EPSG:32633").to_wkt()


# --- windows


def test_any_window_is_a_slice_of_the_whole(tmp_path, photograph):
    photograph[:, 4, 9] = 0
    path = write(tmp_path / "a.tif", photograph, (RED, GREEN, BLUE), nodata=0)
    raster = open_bands([path], Choice((1, 2, 3), colours=True))
    whole = np.stack(list(raster.read_bands(WHOLE)))
    part = np.stack(list(raster.read_bands(Window(3, 2, 9, 12))))
    assert np.array_equal(part, whole[:, 3:9, 2:12], equal_nan=True)
    with rasterio.open(path) as file:
        mask = file.dataset_mask(window=FileWindow(2, 3, 10, 6))
    assert np.array_equal(np.isnan(part[0]), mask == 0)


@pytest.mark.parametrize("entries", [1, 2, 3])
def test_an_index_beyond_a_palette_has_no_colour(tmp_path, entries):
    write(tmp_path / "a.tif", (np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) % 5).astype(np.uint8)[None])
    table = "".join(f'<Entry c1="{10 + entry}" c2="20" c3="30" c4="255"/>' for entry in range(entries))
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}"><SRS>EPSG:32633</SRS>'
        "<GeoTransform>500000, 1, 0, 5000000, 0, -1</GeoTransform>"
        f'<VRTRasterBand dataType="Byte" band="1"><ColorInterp>Palette</ColorInterp><ColorTable>{table}</ColorTable>'
        '<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    indices = np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) % 5
    raster = open_photograph([tmp_path / "a.vrt"], crs=None, band=None, grey="automatic").raster
    red = next(iter(raster.read_bands(WHOLE)))
    assert np.array_equal(red, np.where(indices < entries, 10 + indices, np.nan), equal_nan=True)
