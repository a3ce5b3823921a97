"""The buffer method: figures known by hand, a brute-force oracle, and the laws of the scores."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiLineString, Point, Polygon

from tests.naive.evaluate.lines import sampled_match
from tilepipe.errors import InputError
from tilepipe.evaluate.lines import evaluate, evaluate_lines
from tilepipe.io.vectors.formats import write_table

coordinate = st.integers(0, 40).map(float)
polyline = (
    st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=5).map(LineString).filter(lambda s: s.length)
)
network = st.lists(polyline, min_size=1, max_size=4)


def test_parallel_line_matches_with_round_ends() -> None:
    score = evaluate_lines([LineString([(0, 1), (100, 1)])], [LineString([(0, 0), (200, 0)])], buffer=3)
    assert score.correctness == 1
    assert score.matched_truth_length == pytest.approx(100 + math.sqrt(8), rel=1e-12)
    assert score.completeness == pytest.approx((100 + math.sqrt(8)) / 200, rel=1e-12)
    assert score.quality == pytest.approx(100 / (100 + 100 - math.sqrt(8)), rel=1e-12)
    assert score.redundancy == pytest.approx(-math.sqrt(8) / 100, rel=1e-12)
    assert score.rms_distance == pytest.approx(1, rel=1e-12)


def test_slanted_line_has_the_rms_of_a_wedge() -> None:
    result = [LineString([(20, 0), (80, 3)])]
    score = evaluate_lines(result, [LineString([(0, 0), (100, 0)])], buffer=2)
    assert score.correctness == pytest.approx(2 / 3, rel=1e-12)
    assert score.rms_distance == pytest.approx(2 / math.sqrt(3), rel=1e-12)


def test_every_copy_of_a_line_counts_as_redundant() -> None:
    line = LineString([(0, 0), (50, 0)])
    score = evaluate_lines([line, line], [line], buffer=1)
    assert (score.completeness, score.correctness, score.redundancy) == (1, 1, 0.5)


def test_overlapping_buffers_are_counted_once() -> None:
    truth = [LineString([(0, 0), (10, 0), (20, 0), (30, 0)])]
    score = evaluate_lines([LineString([(0, 1), (30, 1)])], truth, buffer=5)
    assert score.matched_result_length == pytest.approx(30, rel=1e-12)


def test_direction_tolerance_refuses_a_crossing() -> None:
    result, truth = [LineString([(0, -50), (0, 50)])], [LineString([(-50, 0), (50, 0)])]
    assert evaluate_lines(result, truth, buffer=5).matched_result_length == pytest.approx(10)
    assert evaluate_lines(result, truth, buffer=5, direction_tolerance=30).matched_result_length == 0
    backwards = [LineString([(50, 1), (-50, 1)])]
    assert evaluate_lines(backwards, truth, buffer=5, direction_tolerance=1).correctness == 1


def test_area_clips_both_sets() -> None:
    area = Polygon([(0, -10), (50, -10), (50, 10), (0, 10)])
    result, truth = (
        [LineString([(-20, 1), (100, 1)])],
        [MultiLineString([[(0, 0), (25, 0)], [(25, 0), (90, 0)]])],
    )
    score = evaluate_lines(result, truth, buffer=3, area=area)
    assert (score.result_length, score.truth_length) == pytest.approx((50, 50))
    assert (score.completeness, score.correctness) == (1, 1)


def test_nothing_extracted_scores_zero_and_undefined() -> None:
    score = evaluate_lines([], [LineString([(0, 0), (1, 0)])], buffer=1)
    assert (score.completeness, score.quality) == (0, 0)
    assert math.isnan(score.correctness)
    assert json.loads(json.dumps(score.as_dict()))["correctness"] is None
    assert "undefined" in score.summary()


def test_bad_arguments_are_refused() -> None:
    line = [LineString([(0, 0), (1, 0)])]
    with pytest.raises(InputError, match="positive"):
        evaluate_lines(line, line, buffer=0)
    with pytest.raises(InputError, match="90"):
        evaluate_lines(line, line, buffer=1, direction_tolerance=120)
    with pytest.raises(InputError, match="no lines"):
        evaluate_lines(line, [], buffer=1)
    with pytest.raises(InputError, match="inside the area"):
        evaluate_lines(line, line, buffer=1, area=Point(50, 50).buffer(1))


@settings(deadline=None, max_examples=40)
@given(network, network, st.floats(0.5, 9))
def test_agrees_with_dense_sampling(result: list[LineString], truth: list[LineString], buffer: float) -> None:
    step = 0.02
    score = evaluate_lines(result, truth, buffer=buffer)
    total, matched, distances = sampled_match(result, truth, buffer, step)
    # Each end of a matched part is off by a step at most; a polyline has few such ends.
    assert score.result_length == pytest.approx(total, rel=1e-9)
    assert score.matched_result_length == pytest.approx(matched, abs=60 * step)
    if score.matched_result_length > 5:
        assert score.rms_distance == pytest.approx(math.sqrt((distances**2).mean()), abs=0.05)


@settings(deadline=None, max_examples=40)
@given(network, network, st.floats(0.5, 9), st.sampled_from([None, 0.0, 30.0, 90.0]))
def test_swapping_the_sets_swaps_the_scores(
    a: list[LineString], b: list[LineString], buffer: float, tolerance: float | None
) -> None:
    forth = evaluate_lines(a, b, buffer=buffer, direction_tolerance=tolerance)
    back = evaluate_lines(b, a, buffer=buffer, direction_tolerance=tolerance)
    assert forth.completeness == pytest.approx(back.correctness, abs=1e-9)
    assert forth.correctness == pytest.approx(back.completeness, abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(network, network, st.floats(0.5, 9), st.floats(1, 2))
def test_a_wider_buffer_matches_no_less(
    result: list[LineString], truth: list[LineString], buffer: float, factor: float
) -> None:
    narrow = evaluate_lines(result, truth, buffer=buffer)
    wide = evaluate_lines(result, truth, buffer=buffer * factor)
    assert wide.completeness >= narrow.completeness - 1e-9
    assert wide.correctness >= narrow.correctness - 1e-9
    assert narrow.rms_distance <= buffer + 1e-9 or math.isnan(narrow.rms_distance)


def test_large_coordinates_lose_nothing() -> None:
    near, far = [(0.0, 0.7), (60.0, 2.1), (90.0, 8.0)], [(0.0, 0.0), (40.0, 1.0), (95.0, -1.0)]
    here = evaluate_lines([LineString(near)], [LineString(far)], buffer=3)
    moved = [np.add(near, (7.1e5, 5.6e6)), np.add(far, (7.1e5, 5.6e6))]
    there = evaluate_lines([LineString(moved[0])], [LineString(moved[1])], buffer=3)
    assert there.completeness == pytest.approx(here.completeness, abs=1e-8)
    assert there.rms_distance == pytest.approx(here.rms_distance, abs=1e-7)


def _write(path: Path, lines: list[LineString], crs: str | None, format: str = "parquet") -> Path:
    return write_table(path, {"line_id": np.arange(len(lines))}, lines, crs, format, geometry_type="LineString")


def test_files_in_feet_are_scored_in_metres(tmp_path: Path) -> None:
    foot = 0.3048
    result = _write(
        tmp_path / "centerlines.parquet", [LineString([(6e5, 8e5 + 9), (6e5 + 1000, 8e5 + 9)])], "EPSG:2994"
    )
    truth = _write(tmp_path / "truth.gpkg", [LineString([(6e5, 8e5), (6e5 + 1000, 8e5)])], "EPSG:2994", "gpkg")
    score = evaluate(result, truth, 3.0)
    assert (score.completeness, score.correctness) == pytest.approx((1, 1), abs=1e-2)
    assert score.result_length == pytest.approx(1000 * foot)
    assert score.rms_distance == pytest.approx(9 * foot)
    assert evaluate(result, truth, 2.7).correctness == 0
    assert evaluate(tmp_path, truth, 3.0) == score


def test_truth_and_area_are_reprojected(tmp_path: Path) -> None:
    lines = [LineString([(6e5, 8e5), (6e5 + 1000, 8e5)])]
    result = _write(tmp_path / "result.parquet", lines, "EPSG:2994")
    truth = _write(tmp_path / "truth.geojson", lines, "EPSG:2994", "geojson")
    box = shapely.box(6e5 - 100, 8e5 - 100, 6e5 + 500, 8e5 + 100)
    area = write_table(tmp_path / "area.geojson", {}, [box], "EPSG:2994", "geojson")
    score = evaluate(result, truth, 0.1, area)
    assert score.completeness == pytest.approx(1, abs=1e-4)
    assert score.result_length == pytest.approx(500 * 0.3048, abs=0.05)


def test_unusable_files_are_refused(tmp_path: Path) -> None:
    line = [LineString([(0, 0), (1, 1)])]
    good = _write(tmp_path / "good.parquet", line, "EPSG:32633")
    degrees = _write(tmp_path / "degrees.geojson", line, "EPSG:4326", "geojson")
    nowhere = _write(tmp_path / "nowhere.parquet", line, None)
    empty = _write(tmp_path / "empty.parquet", [], "EPSG:32633")
    polygons = write_table(tmp_path / "polygons.parquet", {}, [Point(0, 0).buffer(1)], "EPSG:32633")
    garbage = tmp_path / "garbage.gpkg"
    garbage.write_bytes(b"no table")
    for result, truth, message in [
        (tmp_path / "missing.gpkg", good, "does not exist"),
        (tmp_path, good, "no centerlines"),
        (degrees, good, "longitude and latitude"),
        (nowhere, good, "names no CRS"),
        (polygons, good, "Polygon"),
        (garbage, good, r"garbage\.gpkg cannot be read as lines or polygons; give a layer of a run"),
        (good, tmp_path, "is a folder"),
        (good, empty, "no lines"),
    ]:
        with pytest.raises(InputError, match=message):
            evaluate(result, truth, 3.0)
    with pytest.raises(InputError, match="give Polygon"):
        evaluate(good, good, 3.0, good)
    assert evaluate(empty, good, 3.0).completeness == 0
