"""Streets of real lidar, with defaults: measured against what others have drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tilepipe.pipelines.points.recipe import grid_clouds
from tilepipe.pipelines.streets.pipeline import streets

shapely = pytest.importorskip("shapely")
geopandas = pytest.importorskip("geopandas")


def test_autzen_boulevard(shared_data: Path, tmp_path: Path) -> None:
    """The boulevard traced by hand on an orthophoto; west of x = 636175 ft that lies 3 m beside the lidar's road."""
    scene = shared_data / "autzen_north"
    streets(scene / "intensity_mean_2ft.tif", out=tmp_path / "run")
    traced = geopandas.read_file(scene / "handtraced_MLK_part.geojson").geometry.iloc[1]
    places = traced.interpolate(np.arange(0.0, traced.length, 5.0))
    for layer, least in (("centerlines", 0.8), ("skeleton", 0.75)):
        lines = geopandas.read_parquet(tmp_path / "run" / f"{layer}.parquet").geometry.union_all()
        near = shapely.distance(lines, places) * 0.3048 <= 3
        agreeing = shapely.get_x(places) > 636_175
        assert near.mean() >= least
        assert near[agreeing].mean() >= (0.97 if layer == "centerlines" else 0.85)


def test_amsterdam_streets_leave_out_the_houses(shared_data: Path, tmp_path: Path) -> None:
    """With heights, hardly a metre of street runs through a house of the cadastre."""
    scene = shared_data / "amsterdam_ahn3_bag"
    clouds = sorted(scene.glob("*.laz"))
    for value, method, reach in (("intensity", "mean", 0.0), ("height", "max", 3.0)):
        grid_clouds(clouds, tmp_path / f"{value}.tif", value=value, method=method, void_reach=reach, crs="EPSG:28992")  # type: ignore[arg-type]
    streets(tmp_path / "intensity.tif", height=[tmp_path / "height.tif"], out=tmp_path / "run")
    houses = geopandas.read_file(scene / "pandactueelbestaand.gpkg").geometry.union_all()
    for layer in ("centerlines", "skeleton"):
        lines = geopandas.read_parquet(tmp_path / "run" / f"{layer}.parquet").geometry
        assert lines.length.sum() > 2500
        assert lines.intersection(houses).length.sum() < 0.01 * lines.length.sum()
