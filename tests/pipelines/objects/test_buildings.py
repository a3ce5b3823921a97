"""Buildings of small drawn scenes: roofs and crowns told apart, the table, and what happens without any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.scenes import write_raster
from tilepipe import InputError, objects, plan_objects
from tilepipe.pipelines.objects.building_table import without_holes
from tilepipe.pipelines.objects.layers import BUILDINGS

geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")

SIDE = 300
HOUSES = [(20, 30, 30, 40), (20, 110, 24, 24), (100, 30, 44, 20), (110, 200, 50, 50), (200, 60, 26, 60)]
"""Top, left, height and width in pixels of 0.5 m; the fourth has a court."""


def village(*, houses: bool = True, trees: bool = True) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Gabled houses and trees on a slope, and which pixels are houses."""
    random = np.random.default_rng(7)
    row, column = np.mgrid[:SIDE, :SIDE].astype(float)
    heights = 10 + 0.03 * column
    house = np.zeros(heights.shape, np.bool_)
    for top, left, high, wide in HOUSES if houses else ():
        part = np.s_[top : top + high, left : left + wide]
        slope = 0.15 * np.minimum(row[part] - top, top + high - 1 - row[part])
        heights[part] = heights[part].mean() + 5 + slope
        house[part] = True
    if houses:
        heights[124:136, 224:236], house[124:136, 224:236] = 10 + 0.03 * 230, False
    for _ in range(22 if trees else 0):
        y, x, radius = *random.integers(12, SIDE - 12, 2), random.integers(6, 11)
        crown = (np.hypot(row - y, column - x) < radius) & ~house
        heights[crown] += random.uniform(2.5, 9, np.count_nonzero(crown))
    heights += random.normal(0, 0.03, heights.shape)
    return heights.astype(np.float32), house


def run(heights: NDArray[np.float32], folder: Path, **parameters: object) -> Path:
    scene = write_raster(folder / "dsm.tif", heights, pixel=0.5)
    objects(scene, out=folder / "run", params={"burn_in": 10, "draws": 20, **parameters})
    return folder / "run"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(village()[0], tmp_path_factory.mktemp("village"))


def test_houses_are_found_and_trees_are_not(found: Path) -> None:
    table = geopandas.read_parquet(found / "buildings.parquet")
    house = village()[1]
    assert len(table) == len(HOUSES)
    assert table.area_m2.sum() == pytest.approx(0.25 * np.count_nonzero(house), rel=0.05)
    assert (table.probability > 0.8).all()
    assert sum(len(part.interiors) for shape in table.geometry for part in shape.geoms) == 1


def test_columns_say_what_the_scene_has(found: Path) -> None:
    table = geopandas.read_parquet(found / "buildings.parquet")
    assert list(table.columns) == [*BUILDINGS.columns, "geometry"]
    assert table.geometry.is_valid.all() and (table.geom_type == "MultiPolygon").all()
    np.testing.assert_allclose(table.area_m2, table.geometry.area)
    np.testing.assert_allclose(table.perimeter_m, table.geometry.length)
    assert table.height_above_ground.between(5, 8).all()
    ground = 10 + 0.03 * (table.geometry.centroid.x - 500_000) / 0.5
    np.testing.assert_allclose(table.ground_height, ground, atol=0.6)
    np.testing.assert_allclose(table.height_mean, table.ground_height + table.height_above_ground)
    assert (table.height_above_ground_max > table.height_above_ground).all()
    assert (table.height_max > table.height_mean).all()


def test_buildings_are_regions_dissolved(found: Path) -> None:
    table = geopandas.read_parquet(found / "buildings.parquet")
    regions = geopandas.read_parquet(found / "objects.parquet").set_index("region_id")
    assert table.building_id.is_monotonic_increasing
    inside = regions.geometry.representative_point()
    for building in table.itertuples():
        members = regions[shapely.covers(building.geometry, inside.to_numpy())]
        assert members.index.min() == building.building_id
        assert len(members) == building.regions
        assert (members.building_probability > 0.5).all()
        assert shapely.equals(shapely.union_all(members.geometry.to_numpy()), building.geometry)
    low = regions[regions.height_above_ground < 2.5]
    assert len(low) and (low.building_probability == 0).all()


def test_small_holes_are_filled_and_courts_are_not(tmp_path: Path) -> None:
    heights, house = village()
    heights[np.random.default_rng(1).random(heights.shape) < 0.005] = np.nan
    table = geopandas.read_parquet(run(heights, tmp_path) / "buildings.parquet")
    assert table.is_valid.all()
    holes = shapely.get_num_interior_rings(shapely.get_parts(table.geometry.to_numpy()))
    assert holes.sum() == 1
    assert table.area_m2.sum() == pytest.approx(0.25 * np.count_nonzero(house), rel=0.05)


def test_what_stands_in_a_filled_hole_is_part_of_the_whole() -> None:
    ring = shapely.box(0, 0, 20, 20) - shapely.box(4, 4, 7, 7) - shapely.box(10, 10, 18, 18)
    found = without_holes(np.array([shapely.MultiPolygon([ring, shapely.box(5, 5, 6, 6)])]), 10.0)
    assert shapely.is_valid(found).all()
    assert shapely.equals(found[0], shapely.box(0, 0, 20, 20) - shapely.box(10, 10, 18, 18))
    assert without_holes(np.array([], object), 10.0).size == 0


def test_a_scene_without_houses_has_an_empty_table(tmp_path: Path) -> None:
    table = geopandas.read_parquet(run(village(houses=False)[0], tmp_path) / "buildings.parquet")
    assert len(table) == 0 and list(table.columns) == [*BUILDINGS.columns, "geometry"]


def test_a_scene_without_trees_keeps_its_houses(tmp_path: Path) -> None:
    table = geopandas.read_parquet(run(village(trees=False)[0], tmp_path) / "buildings.parquet")
    assert len(table) == len(HOUSES)


def test_small_and_low_ones_are_left_out(tmp_path: Path) -> None:
    sheds = np.zeros((120, 120), np.float32)
    sheds[10:16, 10:16], sheds[40:70, 40:70], sheds[90:110, 20:60] = 3, 2, 3
    assert len(geopandas.read_parquet(run(sheds, tmp_path) / "buildings.parquet")) == 1
    (tmp_path / "all").mkdir()
    folder = run(sheds, tmp_path / "all", minimum_building_height=1.5, minimum_building_area=5)
    assert len(geopandas.read_parquet(folder / "buildings.parquet")) == 3


def test_without_buildings_there_is_neither_halo_nor_layer(tmp_path: Path) -> None:
    scene = write_raster(tmp_path / "dsm.tif", village()[0], pixel=0.5)
    halos = [plan_objects(scene, params={"buildings": wanted}).passes[0].halo for wanted in (True, False)]
    assert halos[0] > 100 and halos[1] == 0
    folder = run(village()[0], tmp_path, buildings=False)
    assert not (folder / "buildings.parquet").exists()
    table = geopandas.read_parquet(folder / "objects.parquet")
    assert table.building_probability.isna().all() and table.height_above_ground.isna().all()


def test_other_formats_have_the_same_buildings(found: Path, tmp_path: Path) -> None:
    from tilepipe import RunOptions

    scene = write_raster(tmp_path / "dsm.tif", village()[0], pixel=0.5)
    objects(scene, out=tmp_path / "run", params={"burn_in": 10, "draws": 20}, options=RunOptions(format="gpkg"))
    table = geopandas.read_file(tmp_path / "run" / "buildings.gpkg")
    assert set(table.building_id) == set(geopandas.read_parquet(found / "buildings.parquet").building_id)


def test_parameters_are_checked(tmp_path: Path) -> None:
    scene = write_raster(tmp_path / "dsm.tif", village()[0], pixel=0.5)
    with pytest.raises(InputError, match="largest_building"):
        plan_objects(scene, params={"largest_building": 0})
