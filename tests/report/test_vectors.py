"""Lines and polygons for pictures."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import shapely

from tests.report.fabricated import CRS, LEFT, PIXEL, TOP, make_run
from tilepipe.report.finished_run import open_folder
from tilepipe.report.vectors import busiest_window, coordinates, longest


def test_coordinates_of_lines_and_rings() -> None:
    line = shapely.LineString([(0, 0), (1, 0), (1, 1)])
    ring = shapely.box(0, 0, 9, 9).difference(shapely.box(3, 3, 4, 4))
    assert [len(part) for part in coordinates([line, ring, shapely.MultiLineString([line, line])])] == [3, 3, 3, 5, 5]
    np.testing.assert_array_equal(coordinates([line])[0], [(0, 0), (1, 0), (1, 1)])
    assert coordinates([]) == []


def test_the_longest_keep_their_order() -> None:
    lines = geopandas.GeoSeries([shapely.LineString([(0, 0), (length, 0)]) for length in (3, 1, 4, 2)])
    table = geopandas.GeoDataFrame(geometry=lines)
    assert longest(table, 2).length.tolist() == [3, 4]
    assert longest(table, 4) is table


def test_the_busiest_window_holds_most_line(tmp_path: Path) -> None:
    run = open_folder(make_run(tmp_path / "run", 1300, 3000), "streets.tif")
    x, y = LEFT + 1200 * PIXEL, TOP - 1100 * PIXEL
    knot = [shapely.LineString([(x, y + k), (x + 300, y + 200 + k)]) for k in range(0, 100, 2)]
    far = [shapely.LineString([(LEFT + 5000 + k, TOP - 2500), (LEFT + 5900, TOP - 2400 + k)]) for k in range(5)]
    table = geopandas.GeoDataFrame(geometry=knot + far, crs=CRS)
    window = busiest_window(table, run, 1000)
    assert window is not None
    assert shapely.box(*window).covers(shapely.MultiLineString(knot))
    assert (window[2] - window[0], window[3] - window[1]) == (1000 * PIXEL, 1000 * PIXEL)
    assert shapely.box(*run.bounds).covers(shapely.box(*window))
    assert busiest_window(table, run, 2600) is None
