"""The laws of `objects`: tiling, workers and interruption do not show; the tables are a planar coverage."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from tests.laws import assert_invisible, assert_resumes, layer_bytes
from tests.scenes import write_raster
from tilepipe import InputError, RunOptions, objects, plan_objects

LAYERS = ("regions.tif", "objects.parquet", "boundaries.parquet", "buildings.parquet", "convergence.json")
FEW = {"burn_in": 10, "draws": 30, "largest_building": 40.0}


def roofs(side: int = 200) -> NDArray[np.float32]:
    """Houses on a slope with a canal, noise and voids; pixels of 1 m."""
    random = np.random.default_rng(4)
    row, column = np.mgrid[:side, :side].astype(float)
    heights = 2 + 0.01 * column
    for k in range(14):
        top, left = random.integers(0, side - 40, 2)
        heights[top : top + 30, left : left + 24] = 8 + k
    heights[(row - column > 60) & (row - column < 70)] = -1
    heights += random.normal(0, 0.05, heights.shape)
    heights[random.random(heights.shape) < 0.002] = np.nan
    heights[90:130, 100:106] = np.nan
    return heights.astype(np.float32)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_raster(tmp_path_factory.mktemp("scene") / "dsm.tif", roofs())


def run(scene: Path, out: Path, options: RunOptions) -> None:
    objects(scene, out=out, params=FEW, options=options)


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole") / "run"
    run(scene, folder, RunOptions(tile=256, workers=1))
    assert sorted(layer_bytes(folder)) == sorted(LAYERS)
    return layer_bytes(folder)


@pytest.mark.parametrize(
    ("tile", "workers", "executor"), [(64, 2, "threads"), (128, 3, "threads"), (100, 2, "processes")]
)
def test_tiling_and_workers_do_not_show(
    scene: Path, whole: dict[str, bytes], tmp_path: Path, tile: int, workers: int, executor: str
) -> None:
    options = RunOptions(tile=tile, workers=workers, executor=executor)
    assert_invisible(partial(run, scene), tmp_path, whole, [options])


@pytest.mark.parametrize("failing", ["leaves", "borders"])
def test_a_failed_run_resumes(scene: Path, whole: dict[str, bytes], tmp_path: Path, failing: str) -> None:
    assert_resumes(partial(run, scene), tmp_path / "run", whole, RunOptions(tile=64, workers=1), failing)


def test_the_tables_are_a_planar_coverage(scene: Path, tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    objects(scene, out=tmp_path / "exact", params=FEW | {"simplification": 0.0})
    table = geopandas.read_parquet(tmp_path / "exact" / "objects.parquet")
    assert table.area.sum() == np.isfinite(roofs()).sum()
    objects(scene, out=tmp_path / "run", params=FEW)
    table = geopandas.read_parquet(tmp_path / "run" / "objects.parquet")
    assert table.is_valid.all()
    assert shapely.coverage_is_valid(table.geometry.to_numpy())
    assert table.region_id.is_monotonic_increasing
    borders = geopandas.read_parquet(tmp_path / "run" / "boundaries.parquet")
    inner = (borders.left_id > 0) & (borders.right_id > 0)
    assert borders.probability_one_object[inner].between(0, 0.5).all()
    assert borders.probability_one_object[~inner].isna().all()
    assert (borders.height_step_m[inner].abs() > 0.2).all()
    outline = shapely.unary_union(table.boundary.to_numpy())
    assert outline.symmetric_difference(shapely.unary_union(borders.geometry.to_numpy())).length < 1e-6


def test_houses_are_found(scene: Path, tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    objects(scene, out=tmp_path / "run")
    table = geopandas.read_parquet(tmp_path / "run" / "objects.parquet")
    # the last house drawn lies on top of all others
    last = table[(table.height_mean - 21).abs() < 0.05]
    assert last.area_m2.max() == pytest.approx(30 * 24, rel=0.05)


def test_refusals(scene: Path, tmp_path: Path) -> None:
    empty = write_raster(tmp_path / "empty.tif", np.full((40, 40), np.nan, np.float32))
    with pytest.raises(InputError, match="nothing but nodata"):
        objects(empty, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match="did you mean 'merge_height'"):
        objects(scene, out=tmp_path / "run", params={"merge_heigth": 1})
    with pytest.raises(InputError, match="largest_leaf"):
        objects(scene, out=tmp_path / "run", params={"largest_leaf": 10_000})
    with pytest.raises(InputError, match="seed -1"):
        RunOptions(seed=-1)
    assert "leaves" in plan_objects(scene).text()


def test_what_is_no_height_is_said(tmp_path: Path) -> None:
    heights = roofs()
    heights[5:9, 5:9] = 1e9
    scene = write_raster(tmp_path / "dsm.tif", heights)
    with pytest.warns(UserWarning, match="16 pixels hold no possible height"):
        objects(scene, out=tmp_path / "run", params={"draws": 4, "variance": 0.01})
    heights[5:9, 5:9] = -9999
    scene = write_raster(tmp_path / "dsm.tif", heights)
    with pytest.warns(UserWarning, match="heights from -9,999 to"):
        objects(scene, out=tmp_path / "other", params=FEW)


def test_pictures_are_drawn(scene: Path, tmp_path: Path) -> None:
    from PIL import Image

    from tilepipe.pipelines.objects.pictures import pictures

    objects(scene, out=tmp_path / "run", params=FEW)
    for path in pictures(tmp_path / "run")[:-1]:
        with Image.open(path) as picture:
            assert min(picture.size) >= 900
            assert len(picture.convert("RGB").getcolors(1 << 24)) > 20
    with pytest.raises(InputError, match=r"regions\.tif"):
        pictures(tmp_path)
