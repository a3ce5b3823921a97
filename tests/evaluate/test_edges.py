"""Edges against true lines and polygons: figures known by hand; the extent of the data; borders of streets."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from rasterio.transform import from_origin
from shapely import LineString, Polygon, box
from typer.testing import CliRunner

from tilepipe import cli
from tilepipe.errors import InputError
from tilepipe.evaluate.chance import OFFSETS
from tilepipe.evaluate.edges import evaluate_edge_lines, evaluate_edges, true_edges
from tilepipe.evaluate.extent import data_extent
from tilepipe.evaluate.lines import evaluate
from tilepipe.evaluate.polygons import evaluate_areas
from tilepipe.evaluate.street_borders import width_errors
from tilepipe.io.vectors.formats import write_table

CRS = "EPSG:32633"
X, Y = 5e5, 4e6


def moved(geometry):
    return shapely.transform(geometry, lambda points: points + np.array([X, Y]))


def edge_table(path: Path, lines: list[LineString], partners: list[int] | None = None, width: float = 8.0) -> Path:
    """A table with the columns of ``edges.parquet``."""
    count = len(lines)
    values = np.ones(count)
    streets = np.array(partners if partners is not None else [0] * count)
    columns = {
        "line_id": np.arange(1, count + 1),
        **dict.fromkeys(("contrast", "length_m", "straightness", "sinuosity"), values),
        "street_border": streets > 0,
        "street_width_m": np.where(streets > 0, width, np.nan),
        "street_partner": streets,
    }
    return write_table(path, columns, [moved(line) for line in lines], CRS)


def raster(path: Path, known: np.ndarray, pixel: float = 1.0) -> None:
    rows, columns = known.shape
    profile = {"driver": "GTiff", "dtype": "uint8", "nodata": 255, "count": 1, "height": rows, "width": columns}
    transform = from_origin(X, Y + rows * pixel, pixel, pixel)
    with rasterio.open(path, "w", crs=CRS, transform=transform, **profile) as file:
        file.write(np.where(known, 1, 255).astype(np.uint8), 1)
    (path.parent / "run.toml").write_text("")


def test_polygons_contribute_their_boundaries() -> None:
    score = evaluate_edge_lines([LineString([(0, 0.5), (10, 0.5)])], [box(0, 0, 10, 10)], tolerance=0.5)
    assert score.precision == 1
    # the lower side, and the metre of the two beside it that lies within reach
    assert score.recall == pytest.approx(12 / 40)
    assert score.truth_length == 40
    assert score.f_score == pytest.approx(2 * score.recall / (1 + score.recall))
    inner = [box(4, 4, 6, 6).boundary]
    assert evaluate_edge_lines(inner, [box(0, 0, 10, 10)]).precision == 0
    assert evaluate_edge_lines(inner, [box(0, 0, 10, 10), *inner]).precision == 1


def test_a_shared_boundary_counts_once_and_dissolves() -> None:
    houses = [box(0, 0, 5, 5), box(5, 0, 10, 5), None, Polygon()]
    assert shapely.length(true_edges(houses)).sum() == 35
    assert shapely.length(true_edges(houses, dissolve=True)).sum() == 30
    bow = Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])
    assert shapely.length(true_edges([bow])).sum() == pytest.approx(4 + 4 * math.sqrt(2))


def test_nothing_found_and_bad_tolerances() -> None:
    score = evaluate_edge_lines([], [box(0, 0, 1, 1)])
    assert math.isnan(score.precision) and (score.recall, score.f_score) == (0, 0)
    assert json.loads(json.dumps(score.as_dict()))["precision"] is None
    for tolerance in (0, -1, math.inf, math.nan):
        with pytest.raises(InputError, match="tolerance"):
            evaluate_edge_lines([], [box(0, 0, 1, 1)], tolerance=tolerance)


def test_the_extent_of_the_data_fills_holes_but_not_corners(tmp_path: Path) -> None:
    known = np.ones((40, 60), bool)
    known[10:14, 10:14] = False
    known[:, 50:] = False
    raster(tmp_path / "segments.tif", known)
    extent = data_extent(tmp_path)
    assert extent is not None
    assert extent.table.geometry.iloc[0].equals(moved(box(0, 0, 50, 40)))
    assert data_extent(tmp_path / "edges.parquet").table.equals(extent.table)
    (tmp_path / "run.toml").unlink()
    assert data_extent(tmp_path) is None


def test_large_rasters_are_reduced(tmp_path: Path) -> None:
    known = np.ones((6, 5001), bool)
    known[:, :1000] = False
    raster(tmp_path / "streets.tif", known, pixel=0.5)
    left, bottom, right, top = data_extent(tmp_path).table.total_bounds - [X, Y, X, Y]
    assert (bottom, right, top) == (0, 2500.5, 3)
    assert left == pytest.approx(500, abs=1.25)


def test_truth_beyond_the_data_is_not_held_against_the_result(tmp_path: Path) -> None:
    raster(tmp_path / "segments.tif", np.ones((100, 100), bool))
    edge_table(tmp_path / "edges.parquet", [LineString([(0, 50), (100, 50)])])
    truth = write_table(tmp_path / "truth.parquet", {}, [moved(LineString([(0, 50), (400, 50)]))], CRS)
    score = evaluate_edges(tmp_path, truth)
    assert (score.recall, score.truth_length) == pytest.approx((1, 100))
    assert "segments.tif" in score.summary()
    everywhere = write_table(tmp_path / "all.parquet", {}, [moved(box(-1000, -1000, 1000, 1000))], CRS)
    assert evaluate_edges(tmp_path, truth, area_path=everywhere).recall == pytest.approx(101 / 400)
    # centerlines and polygons likewise
    centerlines = edge_table(tmp_path / "centerlines.parquet", [LineString([(0, 50), (100, 50)])])
    assert evaluate(centerlines, truth, 1.0).completeness == 1
    houses = write_table(tmp_path / "objects.parquet", {}, [moved(box(0, 0, 100, 10))], CRS)
    larger = write_table(tmp_path / "larger.parquet", {}, [moved(box(0, 0, 200, 10))], CRS)
    assert evaluate_areas(houses, larger).quality == 1
    assert evaluate_areas(houses, larger, everywhere).quality == 0.5
    elsewhere = write_table(tmp_path / "elsewhere.parquet", {}, [moved(LineString([(300, 0), (400, 0)]))], CRS)
    with pytest.raises(InputError, match="extent of the run's data"):
        evaluate_edges(tmp_path, elsewhere)


BORDERS = [LineString([(0, 0.4), (100, 0.4)]), LineString([(100, 10.2), (0, 10.2)]), LineString([(0, 30), (100, 30)])]


def test_borders_of_streets_and_their_widths(tmp_path: Path) -> None:
    result = edge_table(tmp_path / "edges.parquet", BORDERS, [2, 1, 2], width=9.8)
    parts = [moved(box(-20, 0, 50, 10)), moved(box(50, 0, 120, 10))]
    truth = write_table(tmp_path / "roads.parquet", {}, parts, CRS)
    streets = evaluate_edges(result, truth, road_surface=True).street_borders
    assert streets is not None
    assert (streets.count, streets.length) == (3, 300)
    assert streets.precision == pytest.approx(2 / 3)
    # the seam of the two parts is no boundary
    assert streets.recall == pytest.approx(200 / 300, abs=0.02)
    assert 0 <= streets.precision_by_chance < streets.precision
    assert 0 <= streets.recall_by_chance < streets.recall
    assert streets.width_length == pytest.approx(200)
    assert (streets.width_bias, streets.width_rms) == pytest.approx((-0.2, 0.2))
    assert evaluate_edges(result, truth).street_borders is None
    lines = write_table(tmp_path / "lines.parquet", {}, [part.boundary for part in parts], CRS)
    with pytest.raises(InputError, match="give Polygon"):
        evaluate_edges(result, lines, road_surface=True)
    with pytest.raises(InputError, match="street_border"):
        evaluate_edges(lines, truth, road_surface=True)


def test_a_block_between_two_streets_has_no_width() -> None:
    road = shapely.union_all([box(0, -10, 100, 0), box(0, 10, 100, 20)])
    borders = np.array([LineString([(0, 0), (100, 0)]), LineString([(0, 10), (100, 10)])])
    assert not width_errors(borders, borders[::-1], np.array([10.0, 10.0]), road, 1.0).size
    # a partner that has ended is no border beside the point
    short = np.array([LineString([(0, -10), (40, -10)])])
    assert len(width_errors(borders[:1], short, np.array([10.0]), road, 1.0)) == pytest.approx(40, abs=8)


def test_the_command_scores_edges(tmp_path: Path) -> None:
    edges = edge_table(tmp_path / "edges.parquet", BORDERS, [2, 1, 2])
    truth = write_table(tmp_path / "roads.gpkg", {}, [moved(box(0, 0, 100, 10))], CRS, "gpkg")
    lines = write_table(tmp_path / "lines.parquet", {}, [moved(BORDERS[0])], CRS)

    def tell(*words: object):
        return CliRunner().invoke(cli.app, ["evaluate", *map(str, words)])

    text = tell(edges, truth).stdout
    assert "edges within 1 m" in text and "66.7 %  of 300 m of result" in text
    assert "street borders" in tell(tmp_path, truth, "--road-surface").stdout
    assert json.loads(tell(edges, truth, "--tolerance", 0.1, "--json").stdout)["precision"] < 0.01
    assert json.loads(tell(lines, truth, "--tolerance", 1, "--json").stdout)["precision"] == 1
    assert "completeness" in tell(lines, lines).stdout
    assert isinstance(tell(lines, truth).exception, InputError)
    for words, told in [
        ((edges, truth, "--buffer", 1), "--buffer is for lines and polygons.* --tolerance"),
        ((edges, truth, "--overlap", 0.5, "--step", 1), "--overlap is for polygons, --step is .* them out for edges"),
        ((edges, truth, "--minimum-area", 50), "--minimum-area is for polygons; leave it out for edges"),
        ((edges, lines, "--dissolve"), "--dissolve is for polygons and the truth"),
        ((lines, lines, "--road-surface"), "--road-surface is for edges; leave it out for lines"),
        ((lines, lines, "--dissolve"), "--dissolve .* for lines"),
        ((lines, lines, "--overlap", 0.1), "--overlap .* for lines"),
        ((truth, truth, "--direction", 10), "--direction is for lines and edges; leave it out for polygons"),
        ((truth, truth, "--tolerance", 1), "--tolerance is for edges; leave it out for polygons"),
    ]:
        error = tell(*words).exception
        assert isinstance(error, InputError)
        assert re.search(told, str(error)), error
    assert tell(edges, truth, "--dissolve").exit_code == 0
    assert json.loads(tell(truth, truth, "--overlap", 0.25, "--json").stdout)["overlap"] == 0.25
    assert json.loads(tell(truth, truth, "--json").stdout)["overlap"] == 0.5


def test_chance_is_the_score_of_a_truth_moved_aside() -> None:
    truth = [LineString([(0, 0), (1000, 0)])]
    alone = evaluate_edge_lines(truth, truth)
    assert (alone.precision, alone.precision_by_chance, alone.recall_by_chance) == (1, 0, 0)
    # some line of a hatching of 2 m is within 1 m of any place
    hatching = [LineString([(-100, y), (1100, y)]) for y in range(-100, 101, 2)]
    dense = evaluate_edge_lines(hatching, truth)
    assert (dense.recall, dense.recall_by_chance) == pytest.approx((1, 1))
    assert dense.precision_by_chance == pytest.approx(1000 / (101 * 1200), rel=0.01)
    # a line where one of the four moves takes the truth
    second = [*truth, LineString([(0, 1.5 * OFFSETS[0, 1]), (1000, 1.5 * OFFSETS[0, 1])])]
    moved_once = evaluate_edge_lines(second, truth, tolerance=1.5)
    assert moved_once.recall_by_chance == pytest.approx((1000 - 1.5 * OFFSETS[0, 0] + 1) / 4000, abs=2e-3)
    clipped = evaluate_edge_lines(truth, truth, area=box(0, -1, 1000, 1))
    assert clipped.precision_by_chance == 0 and math.isnan(clipped.recall_by_chance)
    assert clipped.as_dict()["recall_by_chance"] is None
    assert math.isnan(evaluate_edge_lines([], truth).precision_by_chance)
    assert "of 1,000 m of truth, by chance 100.0 %" in dense.summary()


def test_no_direction_and_no_width_of_streets_decides_over_chance() -> None:
    for angle in np.radians(range(0, 180, 3)):
        along = 1000 * np.array([np.cos(angle), np.sin(angle)])
        street = [LineString([-along, along])]
        assert evaluate_edge_lines(street, street).recall_by_chance <= 0.26
    across = np.sort(np.abs(OFFSETS).ravel())
    assert (np.diff(across) > 0.5).all()


def test_truth_in_another_crs_is_reprojected(tmp_path: Path) -> None:
    edges = edge_table(tmp_path / "edges.parquet", [box(0, 0, 50, 50).boundary])
    house = geopandas.GeoDataFrame(geometry=[moved(box(0, 0, 50, 50))], crs=CRS).to_crs("EPSG:4326")
    house.to_file(tmp_path / "house.geojson")
    score = evaluate_edges(edges, tmp_path / "house.geojson", 0.2)
    assert (score.precision, score.recall) == pytest.approx((1, 1))
