"""Metres of a map that are no metres on the ground."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from pyproj import CRS, Geod, Transformer

from tests.io.crs.test_systems import SITE, derived
from tilepipe.errors import InputError
from tilepipe.evaluate.polygons import evaluate_areas
from tilepipe.io.crs.ground import Bounds, ground_metres
from tilepipe.io.crs.systems import map_unit
from tilepipe.io.rasters.cog import write_cog
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.rasters.raster import open_raster
from tilepipe.io.vectors.formats import write_table


def around(crs: str, longitude: float, latitude: float, half: float = 1000.0) -> Bounds:
    """Square around a place, ``half`` CRS units to each side."""
    x, y = Transformer.from_crs(CRS(crs).geodetic_crs, crs, always_xy=True).transform(longitude, latitude)
    return x - half, y - half, x + half, y + half


SURVEY_GRIDS = {
    "UTM": ("EPSG:32633", 13.4, 52.5),
    "far from the middle of UTM": ("EPSG:32633", 21, 0),
    "Lambert-93 in Corsica": ("EPSG:2154", 9.2, 41.4),
    "LAEA Europe in Berlin": ("EPSG:3035", 13.4, 52.5),
    "LAEA Europe in Madrid": ("EPSG:3035", -3.7, 40.4),
    "US feet in New York": ("EPSG:2263", -74, 40.7),
    "feet in Oregon": ("EPSG:2994", -122, 45),
    "Krovak": ("EPSG:5514", 14.4, 50),
    "Switzerland": ("EPSG:2056", 7.4, 47),
    "Sweden": ("EPSG:3006", 24, 65),
    "Albers in British Columbia": ("EPSG:3005", -123, 49.2),
    "Web Mercator at the equator": ("EPSG:3857", 9.5, 0.5),
    "bound": ("+proj=tmerc +lon_0=9 +x_0=3500000 +ellps=bessel +towgs84=598.1,73.7,418.2", 9.2, 48.8),
}


@pytest.mark.parametrize(("crs", "longitude", "latitude"), SURVEY_GRIDS.values(), ids=list(SURVEY_GRIDS))
def test_survey_grids_count_in_their_own_unit(crs: str, longitude: float, latitude: float) -> None:
    assert ground_metres(CRS(crs), around(crs, longitude, latitude), "a.tif") == map_unit(CRS(crs))


@pytest.mark.parametrize("crs", [SITE, derived(), 'LOCAL_CS["site",UNIT["foot",0.3048]]'])
def test_what_cannot_be_known_counts_in_its_own_unit(crs: str) -> None:
    assert ground_metres(CRS(crs), (0, 0, 1000, 1000), "a.tif") == map_unit(CRS(crs))


@pytest.mark.parametrize(
    ("crs", "longitude", "latitude"),
    [("EPSG:3857", 4.9, 52.37), ("EPSG:3395", 13, 52), ("EPSG:3979", -79.4, 43.7), ("EPSG:32631", 23, 10)],
)
def test_an_even_stretch_is_corrected_and_said(crs: str, longitude: float, latitude: float) -> None:
    bounds = around(crs, longitude, latitude)
    with pytest.warns(UserWarning, match=r"a\.tif: a metre of its map .* m on the ground"):
        metres = ground_metres(CRS(crs), bounds, "a.tif")
    square = Transformer.from_crs(crs, CRS(crs).geodetic_crs, always_xy=True).transform(
        *np.array([(bounds[i], bounds[j]) for i, j in ((0, 1), (2, 1), (2, 3), (0, 3))]).T
    )
    area = abs(Geod(ellps="WGS84").polygon_area_perimeter(*square)[0])
    assert (2000 * metres) ** 2 == pytest.approx(area, rel=5e-3)


@pytest.mark.parametrize(
    ("crs", "longitude", "latitude", "half", "zone"),
    [
        ("EPSG:6933", 13, 52, 1000, "EPSG:32633"),  # of equal areas, not of equal lengths
        ("EPSG:3035", -9.1, 38.7, 1000, "EPSG:32629"),
        ("+proj=eqearth +lon_0=10 +datum=WGS84", 10, 50, 1000, "EPSG:32632"),
        ("EPSG:3857", 4.9, 52.37, 200_000, "EPSG:32631"),  # too large for one scale
    ],
)
def test_an_uneven_stretch_is_refused_with_a_way_out(
    crs: str, longitude: float, latitude: float, half: float, zone: str
) -> None:
    with pytest.raises(InputError, match=rf"a\.tif: a metre of its map .*gdalwarp -t_srs {zone} IN OUT"):
        ground_metres(CRS(crs), around(crs, longitude, latitude, half), "a.tif")


def test_a_mosaic_has_one_scale(tmp_path: Path) -> None:
    left, bottom, _, _ = around("EPSG:3857", 4.9, 52.37)
    paths = [tmp_path / "a.tif", tmp_path / "b.tif"]
    for number, path in enumerate(paths):
        geometry = Geometry("EPSG:3857", left, bottom + 4 * number, 0.5, (8, 8), 1, 1)
        write_cog(path, lambda window: np.ones(window.shape, "uint8"), "uint8", geometry, nodata=0)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        raster = open_raster(paths)
    assert len(told) == 1
    assert raster.geometry.resolution == pytest.approx(0.5 * 0.6111, rel=1e-3)
    assert raster.geometry.height_metres == 1


def test_scores_count_on_the_ground(tmp_path: Path) -> None:
    left, bottom, _, _ = around("EPSG:3857", 4.9, 52.37)
    houses = shapely.box(left + np.array([0, 40]), bottom, left + np.array([20, 60]), bottom + 20)
    found = write_table(tmp_path / "found.parquet", {}, houses, "EPSG:3857")
    truth = write_table(
        tmp_path / "truth.gpkg", {}, [shapely.transform(houses[0], lambda xy: xy + 2)], "EPSG:3857", "gpkg"
    )
    with pytest.warns(UserWarning, match="on the ground"):
        score = evaluate_areas(found, truth)
    assert json.dumps(score.as_dict())
    assert score.truth_area == pytest.approx(400 * 0.6111**2, rel=2e-3)
