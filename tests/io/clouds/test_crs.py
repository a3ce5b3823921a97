"""What clouds say of their CRS: by WKT or by GeoTIFF keys, in records or extended ones, agreeing or not."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from laspy.vlrs.known import GeoAsciiParamsVlr, GeoDoubleParamsVlr, GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from laspy.vlrs.vlrlist import VLRList
from pyproj import CRS

from tests.io.crs.test_systems import BESSEL, BOUND, SITE, derived
from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import read_cloud
from tilepipe.io.clouds.crs import common_crs, crs_of_header
from tilepipe.io.crs.systems import crs_of_dataset, same_crs
from tilepipe.io.rasters.raster import open_raster
from tilepipe.pipelines.points.recipe import grid_clouds

SURVEY_FOOT = 1200 / 3937


def keys_vlr(keys: dict[int, int]) -> GeoKeyDirectoryVlr:
    """GeoTIFF keys that hold their values themselves."""
    record = GeoKeyDirectoryVlr()
    entries = b"".join(struct.pack("<4H", key, 0, 1, value) for key, value in sorted(keys.items()))
    record.parse_record_data(struct.pack("<4H", 1, 1, 0, len(keys)) + entries)
    return record


def header_with(*records: laspy.VLR, wkt_bit: bool) -> laspy.LasHeader:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.vlrs.extend(records)
    # laspy before 2.6 sets the bit and never clears it
    header.global_encoding.value = header.global_encoding.value & ~16 | wkt_bit << 4
    return header


def projected(code: int, **more: int) -> dict[int, int]:
    return {1024: 1, 3072: code} | {int(key.removeprefix("k")): value for key, value in more.items()}


def cloud(path: Path, header: laspy.LasHeader, at: tuple[float, float] = (500000, 5000000)) -> Path:
    """Two points, one metre or foot above the other."""
    header.scales, header.offsets = [0.01] * 3, [*at, 0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = at[0] + np.array([0.5, 3.5]), at[1] + np.array([0.5, 3.5]), np.array([1.0, 2.0])
    las.write(path)
    return path


@pytest.mark.parametrize(("wkt_bit", "code"), [(True, 25832), (False, 32633)])
def test_of_two_crs_the_one_counts_that_the_header_names(wkt_bit: bool, code: int) -> None:
    wkt = WktCoordinateSystemVlr(CRS("EPSG:25832").to_wkt())
    header = header_with(keys_vlr(projected(32633, k4099=9003)), wkt, wkt_bit=wkt_bit)
    crs, unit = crs_of_header(header, "a.las")
    assert crs is not None and crs.to_epsg() == code
    # a unit that stands with the wrong CRS is no better than that
    assert unit == (None if wkt_bit else "US survey foot")


def test_the_only_crs_counts_whatever_the_bit() -> None:
    wkt, keys = WktCoordinateSystemVlr(CRS("EPSG:25832").to_wkt()), keys_vlr(projected(25832))
    for record in (wkt, keys):
        for bit in (True, False):
            crs, _ = crs_of_header(header_with(record, wkt_bit=bit), "a.las")
            assert crs is not None and crs.to_epsg() == 25832
    other = header_with(wkt, WktCoordinateSystemVlr(CRS("EPSG:32633").to_wkt()), wkt_bit=True)
    with pytest.raises(InputError, match=r"a\.las: names two CRS, ETRS89 / UTM zone 32N and WGS 84"):
        crs_of_header(other, "a.las")


def test_wkt_of_an_extended_record_counts(tmp_path: Path) -> None:
    header = header_with(wkt_bit=True)
    header.scales, header.offsets = [0.01] * 3, [500000, 5000000, 0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.array([[500000.5], [5000000.5], [1.0]])
    las.evlrs = VLRList([WktCoordinateSystemVlr(CRS("EPSG:25832+6360").to_wkt())])
    las.write(tmp_path / "a.las")
    found = read_cloud(tmp_path / "a.las")
    assert found.crs is not None and found.crs.to_epsg() == 25832 and found.vertical_unit == "US survey foot"


def test_keys_that_describe_a_crs_are_read() -> None:
    keys = keys_vlr(projected(32767, k1025=1, k2048=4326, k3074=32767, k3075=1, k3076=9003))
    numbers = GeoDoubleParamsVlr()
    numbers.parse_record_data(struct.pack("<5d", 9.0, 0.0, 0.9996, 1640416.667, 0.0))
    entries = {3080: 0, 3081: 1, 3092: 2, 3082: 3, 3083: 4}
    for key, place in entries.items():
        entry = laspy.vlrs.known.GeoKeyEntryStruct()
        entry.id, entry.tiff_tag_location, entry.count, entry.value_offset = key, 34736, 1, place
        keys.geo_keys.append(entry)
    keys.geo_keys.sort(key=lambda entry: entry.id)
    keys.geo_keys_header.number_of_keys = len(keys.geo_keys)
    crs, _ = crs_of_header(header_with(keys, numbers, GeoAsciiParamsVlr(), wkt_bit=False), "a.las")
    assert crs is not None and crs.is_projected
    assert crs.axis_info[0].unit_conversion_factor == pytest.approx(SURVEY_FOOT)
    given = "+proj=tmerc +lon_0=9 +k=0.9996 +x_0=500000.0001016 +datum=WGS84 +units=us-ft"
    assert same_crs(crs, CRS(given)) or crs.to_dict()["lon_0"] == 9


@pytest.mark.parametrize(
    ("keys", "unit"),
    [
        ({4099: 9001}, "metre"),
        ({4099: 9002}, "foot"),
        ({4099: 9003}, "US survey foot"),
        ({4099: 9005}, "Clarke's foot"),
        ({4096: 5703}, "metre"),
        ({4096: 6360}, "US survey foot"),
        ({4096: 5703, 4099: 9003}, "US survey foot"),
        ({4096: 5103}, "the unit of vertical CRS 5103"),
        ({4099: 32767}, "EPSG unit 32767"),
        ({4099: 9102}, "EPSG unit 9102"),
        ({}, None),
    ],
)
def test_the_unit_of_heights_by_keys(keys: dict[int, int], unit: str | None) -> None:
    assert crs_of_header(header_with(keys_vlr(projected(25832) | keys), wkt_bit=False), "a.las")[1] == unit


def test_heights_in_an_unknown_unit_are_refused_unless_the_user_names_it(tmp_path: Path) -> None:
    path = cloud(tmp_path / "a.las", header_with(keys_vlr(projected(25832, k4099=32767)), wkt_bit=False))
    with pytest.raises(InputError, match=r"a\.las: its heights are in 'EPSG unit 32767', .*m, dm, cm, .*EPSG:n\+m"):
        grid_clouds([path], tmp_path / "a.tif")
    assert not (tmp_path / "a.tif").exists()
    grid_clouds([path], tmp_path / "intensity.tif", value="intensity")
    with rasterio.open(grid_clouds([path], tmp_path / "a.tif", crs="EPSG:25832+6360")) as dataset:
        assert dataset.units == ("US survey foot",)
    named = WktCoordinateSystemVlr(CRS("EPSG:25832+6360").to_wkt().replace('"US survey foot",0.30480', '"ell",0.6858'))
    other = cloud(tmp_path / "b.las", header_with(named, wkt_bit=True))
    unit = read_cloud(other).vertical_unit
    path = grid_clouds([other], tmp_path / "b.tif")
    assert unit is not None and open_raster([path]).geometry.height_metres == pytest.approx(0.6858, rel=1e-3)


@pytest.mark.parametrize("crs", [BOUND, BESSEL, derived(), SITE], ids=["bound", "no datum", "derived", "site"])
def test_a_raster_has_the_crs_of_its_clouds(tmp_path: Path, crs: str) -> None:
    at = (3500000.0, 5400000.0) if crs in (BOUND, BESSEL) else (1000.0, 2000.0)
    named = cloud(tmp_path / "a.las", header_with(WktCoordinateSystemVlr(CRS(crs).to_wkt()), wkt_bit=True), at)
    bare = cloud(tmp_path / "b.las", header_with(wkt_bit=False), at)
    for path, given in ((named, None), (bare, crs)):
        with rasterio.open(grid_clouds([path], tmp_path / "o.tif", crs=given, overwrite=True)) as dataset:
            assert same_crs(crs_of_dataset(dataset), CRS(crs))


def test_cells_are_metres_on_the_ground(tmp_path: Path) -> None:
    wkt = WktCoordinateSystemVlr(CRS("EPSG:3857").to_wkt())
    path = cloud(tmp_path / "a.las", header_with(wkt, wkt_bit=True), (545466.0, 6867314.0))
    with pytest.warns(UserWarning, match=r"a\.las: a metre of its map .* is 0\.6111 m on the ground"):
        grid_clouds([path], tmp_path / "o.tif", resolution=0.5)
    with rasterio.open(tmp_path / "o.tif") as dataset:
        assert dataset.transform.a == pytest.approx(0.5 / 0.611, rel=1e-3)
    wkt = WktCoordinateSystemVlr(CRS("EPSG:6933").to_wkt())
    path = cloud(tmp_path / "b.las", header_with(wkt, wkt_bit=True), (1254000.0, 5800000.0))
    with pytest.raises(InputError, match=r"pdal translate IN OUT reprojection .*out_srs=EPSG:32633"):
        grid_clouds([path], tmp_path / "p.tif")


def test_clouds_share_a_crs_by_what_it_is(tmp_path: Path) -> None:
    wkt = header_with(WktCoordinateSystemVlr(CRS("EPSG:25832").to_wkt("WKT1_GDAL")), wkt_bit=True)
    keys = header_with(keys_vlr(projected(25832)), wkt_bit=False)
    clouds = [read_cloud(cloud(tmp_path / f"{n}.las", header)) for n, header in enumerate((wkt, keys))]
    assert common_crs(clouds)[0].to_epsg() == 25832
    plain = header_with(WktCoordinateSystemVlr(CRS("+proj=utm +zone=32 +ellps=GRS80").to_wkt()), wkt_bit=True)
    with pytest.raises(InputError, match="reproject the clouds to one CRS first"):
        common_crs([*clouds, read_cloud(cloud(tmp_path / "c.las", plain))])
