"""CRS are kept as they were given: in rasters, tables and arrays, whatever a format makes of them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
import rioxarray  # noqa: F401
import shapely
from pyproj import CRS, Transformer

import tilepipe
from tests.parameters import street_parameters
from tilepipe.engine.options import RunOptions
from tilepipe.errors import InputError
from tilepipe.evaluate.extent import data_extent
from tilepipe.io.crs.systems import (
    agreed_crs,
    crs_of_dataset,
    crs_text,
    same_crs,
    split_crs,
    unbound_crs,
    understood_crs,
)
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.files.paths import side_file
from tilepipe.io.rasters import raster_crs
from tilepipe.io.rasters.cog import cog_from_tiled, write_cog
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.rasters.raster import as_dataarray, open_raster
from tilepipe.io.rasters.raster_crs import check_raster_crs
from tilepipe.io.vectors.formats import convert, write_table
from tilepipe.io.vectors.gdal_tables import check_format

SITE = 'ENGCRS["Site",EDATUM["peg"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
BESSEL = "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=3500000 +y_0=0 +ellps=bessel +units=m"
BOUND = f"{BESSEL} +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7"
GRIDS = f"{BESSEL} +nadgrids=BETA2007.gsb"
PARIS = "+proj=lcc +lat_1=49.5 +lat_0=49.5 +k_0=0.999877341 +x_0=600000 +y_0=200000 +ellps=clrk80ign +pm=paris +units=m"
BALL = "+proj=tmerc +R=6371000"
KILOMETRES = "+proj=utm +zone=31 +datum=WGS84 +units=km"


def derived() -> str:
    """The grid of a building site, derived from UTM."""
    base = CRS("EPSG:25832").to_wkt("WKT2_2019").replace("PROJCRS[", "BASEPROJCRS[", 1)
    base = base[: base.index("CS[Cartesian")].rstrip().rstrip(",") + "]"
    shift = 'METHOD["Cartesian Grid Offsets",ID["EPSG",9656]],PARAMETER["Easting offset",-500000,LENGTHUNIT["metre",1]]'
    shift += ',PARAMETER["Northing offset",-5000000,LENGTHUNIT["metre",1]]'
    axes = 'CS[Cartesian,2],AXIS["site east",east],AXIS["site north",north],LENGTHUNIT["metre",1]'
    return f'DERIVEDPROJCRS["Site grid",{base},DERIVINGCONVERSION["shift",{shift}],{axes}]'


DESCRIBED = {
    "site": SITE,
    "local": 'LOCAL_CS["arbitrary",UNIT["foot",0.3048]]',
    "derived": derived(),
    "bound": BOUND,
    "no datum": BESSEL,
    "paris": PARIS,
    "kilometres": KILOMETRES,
    "oblique": "+proj=omerc +lat_0=40 +lonc=-75 +alpha=30 +gamma=20 +k=0.9999 +x_0=1000 +ellps=GRS80 +units=m",
    "north first": "EPSG:31467",
    "of ESRI": "ESRI:102003",
    "compound": "EPSG:7415",
    "high": CRS("EPSG:32631").to_3d().to_wkt(),
    "bound with heights": f"{BOUND} +vunits=us-ft",
}


@pytest.mark.parametrize("given", DESCRIBED.values(), ids=list(DESCRIBED))
def test_rasters_and_tables_are_read_back_with_their_crs(tmp_path: Path, given: str) -> None:
    text = crs_text(split_crs(understood_crs(given, "given"))[0])
    crs = understood_crs(text, "text")
    assert same_crs(understood_crs(crs_text(crs), "text"), crs)
    geometry = Geometry(text, 1000, 2000, 1, (8, 8), 1, 1)
    path = tmp_path / "a.tif"
    write_cog(path, lambda window: np.ones(window.shape, np.uint8), "uint8", geometry, nodata=0)
    with rasterio.open(path) as dataset:
        assert same_crs(crs_of_dataset(dataset), crs)
    assert {item.name for item in tmp_path.iterdir()} <= {"a.tif", "a.tif.aux.xml"}
    copy = cog_from_tiled(path, tmp_path / "b.tif")
    with rasterio.open(copy) as dataset:
        assert same_crs(crs_of_dataset(dataset), crs)
    table = write_table(tmp_path / "a.parquet", {}, [shapely.Point(1000, 2000)], text)
    assert same_crs(geopandas.read_parquet(table).crs, crs)
    for form in ("gpkg", "fgb"):
        try:
            check_format(form, text, "a.tif")
        except InputError:
            assert given == KILOMETRES
            continue
        assert same_crs(geopandas.read_file(convert(table, form)).crs, crs)


def test_only_what_a_geotiff_cannot_hold_lies_beside_it(tmp_path: Path) -> None:
    for name, crs in (("plain", "EPSG:28992"), ("site", SITE)):
        geometry = Geometry(crs, 1000, 2000, 1, (8, 8), 1, 1)
        write_cog(tmp_path / f"{name}.tif", lambda window: np.ones(window.shape, "uint8"), "uint8", geometry, nodata=0)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["plain.tif", "site.tif", "site.tif.aux.xml"]


def test_no_raster_stands_beside_the_crs_of_another(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    for crs in (SITE, "EPSG:28992", BOUND):
        geometry = Geometry(crs, 1000, 2000, 1, (8, 8), 1, 1)
        write_cog(path, lambda window: np.ones(window.shape, "uint8"), "uint8", geometry, nodata=0)
        with rasterio.open(path) as dataset:
            assert same_crs(crs_of_dataset(dataset), CRS(crs))
    side_file(path).write_text("of the old one")
    with atomic_write(path) as aside:
        aside.write_bytes(b"new")
    assert [item.name for item in tmp_path.iterdir()] == ["a.tif"]


def test_a_likely_crs_is_no_other_one() -> None:
    assert crs_text(CRS(BESSEL)) != "EPSG:5683" and crs_text(CRS("EPSG:31467")) == "EPSG:31467"
    assert agreed_crs(CRS(BESSEL), CRS("EPSG:31467")) is None
    assert agreed_crs(CRS(KILOMETRES), CRS("EPSG:32631")) is None
    without_axes = re.sub(r',AXIS\["[^"]*",[A-Z]+\]', "", CRS("EPSG:2180").to_wkt("WKT1_GDAL"))
    assert same_crs(CRS(without_axes), CRS("EPSG:2180"))


@pytest.mark.parametrize("order", [1, -1])
def test_a_mosaic_keeps_the_way_to_wgs84(tmp_path: Path, order: int) -> None:
    paths = [tmp_path / "a.tif", tmp_path / "b.tif", tmp_path / "c.tif"]
    plain = CRS("EPSG:31467").to_wkt("WKT1_GDAL")
    bound, other = (
        plain.replace("],PRIMEM", f",TOWGS84[{way}]],PRIMEM")
        for way in ("598.1,73.7,418.2,0.202,0.045,-2.455,6.7", "582,105,414,0,0,0,0")
    )
    for number, (path, crs) in enumerate(zip(paths, (plain, bound, other), strict=True)):
        geometry = Geometry(crs, 3500000 + 8 * number, 5400000, 1, (8, 8), 1, 1)
        write_cog(path, lambda window: np.ones(window.shape, "uint8"), "uint8", geometry, nodata=0)
    assert same_crs(CRS(open_raster(paths[:2][::order]).geometry.crs), CRS(bound))
    with pytest.raises(InputError, match="TOWGS84"):
        open_raster(paths[::order])
    assert same_crs(CRS(open_raster(paths[:1], crs=bound).geometry.crs), CRS(bound))
    with pytest.raises(InputError, match=r"b\.tif: is in DHDN .* but --crs names DHDN .* otherwise defined"):
        open_raster(paths[1:2], crs=other)


def test_arrays_keep_their_crs(tmp_path: Path) -> None:
    for crs in (BOUND, SITE, derived(), "EPSG:28992"):
        geometry = Geometry(crs, 1000, 2000, 1, (8, 8), 1, 1)
        write_cog(tmp_path / "a.tif", lambda window: np.ones(window.shape, "uint8"), "uint8", geometry, nodata=0)
        array = as_dataarray(open_raster([tmp_path / "a.tif"]))
        assert same_crs(CRS(open_raster([array]).geometry.crs), CRS(crs))


def test_a_name_stands_for_no_likely_crs() -> None:
    assert understood_crs("Amersfoort / RD New", "--crs").to_epsg() == 28992
    assert understood_crs("32633", "--crs").to_epsg() == 32633
    assert understood_crs("wgs 84 / utm zone 33n", "--crs").to_epsg() == 32633
    for text in ("RD New", "WGS 84 / UTM zone", "/tmp/a.prj", ""):
        with pytest.raises(InputError, match="pass --crs EPSG:n"):
            understood_crs(text, "--crs")


# --- runs


def street(crs: str, folder: Path, left: float = 1000, top: float = 2000) -> Path:
    """A dark street between bright yards."""
    greys = np.full((200, 200), 150, np.float32) + np.random.default_rng(1).normal(0, 4, (200, 200)).astype(np.float32)
    greys[90:110] -= 100
    geometry = Geometry(crs, left, top, 0.5, (200, 200), 1, 1)
    write_cog(folder / "greys.tif", lambda window: greys[window.slices], "float32", geometry, nodata=float("nan"))
    return folder / "greys.tif"


OPTIONS = {"tile": 256, "workers": 1}


def test_a_run_publishes_and_removes_what_lies_beside_its_rasters(tmp_path: Path) -> None:
    from tilepipe.report.finished_run import open_folder

    raster, out = street(derived(), tmp_path), tmp_path / "run"
    layers = tilepipe.streets(raster, out, params=street_parameters({}), options=RunOptions(**OPTIONS))
    assert out / "streets.tif.aux.xml" in layers and all(layer.is_file() for layer in layers)
    run = open_folder(out, "streets.tif")
    assert same_crs(run.crs, CRS(derived())) and len(run.table("centerlines"))
    extent = data_extent(out)
    assert extent is not None and same_crs(extent.table.crs, CRS(derived()))
    plain = street("EPSG:25832", tmp_path, 500000, 5000000)
    options = RunOptions(**OPTIONS, overwrite=True)
    tilepipe.streets(plain, out, params=street_parameters({}), options=options)
    assert not (out / "streets.tif.aux.xml").exists()
    with rasterio.open(out / "streets.tif") as dataset:
        assert dataset.crs.to_epsg() == 25832


def test_geojson_of_a_bound_crs_lies_where_it_should(tmp_path: Path) -> None:
    point = shapely.Point(3500100, 5400200)
    table = write_table(tmp_path / "a.geojson", {}, [point], BOUND, "geojson")
    expected = Transformer.from_crs(CRS(BOUND), 4326, always_xy=True).transform(point.x, point.y)
    found = geopandas.read_file(table).geometry[0]
    assert (found.x, found.y) == pytest.approx(expected, abs=2e-7)


@pytest.mark.parametrize("crs", [SITE, BESSEL, BALL], ids=["local", "no datum", "ball"])
def test_geojson_without_a_way_to_degrees_is_refused_before_work(tmp_path: Path, crs: str) -> None:
    raster = street(crs, tmp_path, *((3500000, 5400000) if crs == BESSEL else (1000, 2000)))
    options: Any = RunOptions(**OPTIONS, format="geojson")
    with pytest.raises(InputError, match=r"greys\.tif: no way leads from its CRS .*; use --format parquet"):
        tilepipe.streets(raster, tmp_path / "run", options=options)
    assert not (tmp_path / "run").exists()


def test_a_format_that_takes_kilometres_for_metres_is_refused_before_work(tmp_path: Path) -> None:
    raster = street("EPSG:32631", tmp_path, 500000, 5000000)
    with rasterio.open(raster) as dataset:
        values = dataset.read(1)
    geometry = Geometry(KILOMETRES, 500, 5000, 0.0005, (200, 200), 1, 1)
    write_cog(raster, lambda window: values[window.slices], "float32", geometry, nodata=float("nan"))
    with pytest.raises(InputError, match=r"gpkg files cannot hold its CRS .* GDAL reads WGS 84 / UTM zone 31N"):
        tilepipe.plan_streets(raster, options=RunOptions(**OPTIONS, format="gpkg"))
    assert tilepipe.plan_streets(raster, options=RunOptions(**OPTIONS)).resolution == 0.5


def test_a_crs_that_no_raster_holds_is_refused_before_work(monkeypatch: pytest.MonkeyPatch) -> None:
    # which those are differs from one GDAL to the next
    monkeypatch.setattr(raster_crs, "_names", lambda *_: False)
    with pytest.raises(InputError, match=r"^a\.tif: GDAL keeps its CRS \(unknown\) in no raster"):
        check_raster_crs(GRIDS, "a.tif")


def test_no_advice_on_disks_for_what_is_no_matter_of_them(tmp_path: Path) -> None:
    from rasterio.errors import RasterioIOError

    with (
        pytest.raises(InputError, match=r"GDAL refuses it \(no such driver\); the disk has space and can be written"),
        atomic_write(tmp_path / "a.tif"),
    ):
        raise RasterioIOError("no such driver")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("code", ["EPSG:3067", "EPSG:3879", "EPSG:5129", "EPSG:25833"])
def test_a_code_is_a_code_though_rasterio_and_pyproj_describe_it_differently(tmp_path, code):
    """Finland and Norway: releases of the registry differ in names of datums, and each package brings its own."""
    left, top = (6600000, 500000) if code == "EPSG:5129" else (500000, 6600000)
    profile = {"driver": "GTiff", "width": 4, "height": 4, "count": 1, "dtype": "float32", "crs": code}
    with rasterio.open(tmp_path / "a.tif", "w", transform=rasterio.Affine(1, 0, left, 0, -1, top), **profile) as file:
        file.write(np.ones((1, 4, 4), np.float32))
    assert open_raster([tmp_path / "a.tif"]).geometry.crs == code
    assert open_raster([tmp_path / "a.tif"], crs=code).geometry.crs == code
    wkt = rasterio.crs.CRS.from_string(code).to_wkt(version="WKT2_2019")
    assert crs_text(understood_crs(wkt, "--crs")) == code
    for kind in ("gpkg", "fgb", "geojson"):
        check_format(kind, code, "a.tif")
    check_raster_crs(code, "a.tif")
    # a map that says it is that of a code, and is another, is not taken for it
    other = re.sub(r'("False easting",)', r"\g<1>1", wkt)
    assert other != wkt and crs_text(understood_crs(other, "--crs")) != code


def test_only_the_way_to_another_system_is_taken_away():
    plain = CRS("EPSG:25831")
    assert unbound_crs(plain) is plain
    bound = CRS("+proj=utm +zone=31 +ellps=intl +towgs84=-87,-98,-121")
    assert bound.is_bound and unbound_crs(bound) == bound.source_crs
