"""Pictures and page of a small fabricated run."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely
from PIL import Image

from tests.report.fabricated import CRS, LEFT, TOP, make_run, pixels_of
from tilepipe.errors import InputError
from tilepipe.io.vectors.formats import write_table
from tilepipe.pipelines.streets.pictures import JUNCTION_COLOUR, LINE_COLOUR, junctions, pictures, region_mask
from tilepipe.report.finished_run import open_folder


def test_the_pictures_show_lines_junction_and_regions(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    paths = pictures(run)
    assert paths == [run / name for name in ("quicklook.png", "quicklook_detail.png", "report.html")]
    for path in paths[:2]:
        assert max(Image.open(path).size) <= 2000
        assert pixels_of(path, LINE_COLOUR) > 1500
        assert pixels_of(path, JUNCTION_COLOUR) > 20
    without = make_run(tmp_path / "without")
    lines = geopandas.read_parquet(without / "centerlines.parquet")
    write_table(without / "centerlines.parquet", {}, lines.geometry[:0], CRS, geometry_type="LineString")
    assert pixels_of(pictures(without)[0], LINE_COLOUR) == 0


@pytest.mark.parametrize("shape", [(3000, 40), (40, 3000), (30, 30)])
def test_pictures_of_any_shape_stay_small(tmp_path: Path, shape: tuple[int, int]) -> None:
    path, *_ = pictures(make_run(tmp_path / "run", *shape))
    assert max(Image.open(path).size) <= 2000


def test_pictures_repeat_in_bytes(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert pictures(run)[0].read_bytes() == pictures(run)[0].read_bytes()


def test_regions_are_where_they_belong(tmp_path: Path) -> None:
    run = open_folder(make_run(tmp_path / "run"), "streets.tif")
    mask = region_mask(run, run.bounds, (60, 100))
    assert [mask[30, 5], mask[5, 50], mask[55, 5]] == [True, True, False]
    east = (LEFT + 200, run.bounds[1], run.bounds[2], run.bounds[3])
    np.testing.assert_array_equal(region_mask(run, east, (120, 100)), region_mask(run, run.bounds, (120, 200))[:, 100:])


def test_junctions_by_node_and_by_coordinate(tmp_path: Path) -> None:
    table = open_folder(make_run(tmp_path / "run"), "streets.tif").table("centerlines")
    # A line that goes on from a free end makes no junction there.
    onward = table.iloc[[1]].assign(from_node=table["to_node"].iloc[1], to_node=9)
    end = shapely.get_point(table.geometry.iloc[1], -1)
    onward = onward.set_geometry([shapely.LineString([end, (end.x + 10, end.y)])], crs=CRS)
    table = geopandas.GeoDataFrame(pd.concat([table, onward], ignore_index=True))
    expected = [[LEFT + 200, TOP - 120]]
    np.testing.assert_array_equal(junctions(table), expected)
    np.testing.assert_array_equal(junctions(table[["geometry"]]), expected)


@pytest.mark.parametrize("format", ["gpkg", "geojson"])
def test_runs_in_other_formats_are_drawn(tmp_path: Path, format: str) -> None:
    run = make_run(tmp_path / "run", format=format)
    assert [path.name for path in pictures(run)] == ["quicklook.png", "quicklook_detail.png", "report.html"]
    assert pixels_of(run / "quicklook.png", LINE_COLOUR) > 1500


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finished streets run"):
        pictures(tmp_path)
