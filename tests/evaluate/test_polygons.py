"""Scores of polygons: figures known by hand, the laws of the scores, files and units."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiPolygon, Point, Polygon, box
from typer.testing import CliRunner

from tilepipe import cli
from tilepipe.errors import InputError
from tilepipe.evaluate.polygons import AreaScore, evaluate_areas, evaluate_polygons
from tilepipe.io.vectors.formats import write_table
from tilepipe.io.vectors.tables import are_polygons, read_layer

side = st.integers(1, 12)
place = st.integers(0, 30)
rectangle = st.builds(lambda x, y, w, h: box(x, y, x + w, y + h), place, place, side, side)
triangle = st.builds(lambda x, y, w, h: Polygon([(x, y), (x + w, y), (x, y + h)]), place, place, side, side)
bow = st.builds(lambda x, y, w, h: Polygon([(x, y), (x + w, y + h), (x + w, y), (x, y + h)]), place, place, side, side)
layer = st.lists(rectangle | triangle | bow, min_size=1, max_size=8)


def test_shifted_square() -> None:
    score = evaluate_polygons([box(2, 0, 12, 10)], [box(0, 0, 10, 10)], minimum_area=100)
    assert (score.common_area, score.result_area, score.truth_area) == (80, 100, 100)
    assert (score.completeness, score.correctness) == (0.8, 0.8)
    assert score.quality == score.iou == pytest.approx(80 / 120, rel=1e-12)
    assert (score.objects.completeness, score.objects.correctness, score.objects.quality) == (1, 1, 1)
    assert score.result_to_truth.near == 1
    assert score.result_to_truth.length == 40
    # Horizontal sides: 8 m coincide, 2 m run away. The right side is 2 m outside; the left side is 2 m inside,
    # but its ends are nearer to the truth's horizontal sides.
    inside = _integral(lambda t: np.minimum(2, np.minimum(t, 10 - t)), 10)
    total = 2 * (2 * 2 / 2) + 2 * 10 + inside
    assert score.result_to_truth.mean == pytest.approx(total / 40, rel=1e-3)
    squares = 2 * 2**3 / 3 + 4 * 10 + _integral(lambda t: np.minimum(2, np.minimum(t, 10 - t)) ** 2, 10)
    assert score.result_to_truth.rms == pytest.approx(math.sqrt(squares / 40), rel=1e-2)
    # One sample in the middle of each side.
    coarse = evaluate_polygons([box(2, 0, 12, 10)], [box(0, 0, 10, 10)], step=10)
    assert coarse.result_to_truth.rms == pytest.approx(math.sqrt((0 + 4 + 0 + 4) / 4), rel=1e-12)
    fine = evaluate_polygons([box(2, 0, 12, 10)], [box(0, 0, 10, 10)], step=0.01)
    assert fine.result_to_truth.rms == pytest.approx(math.sqrt(squares / 40), rel=1e-5)


def _integral(function, length: float) -> float:
    t = (np.arange(100_000) + 0.5) * length / 100_000
    return float(function(t).mean() * length)


def test_objects_are_matched_by_their_covered_share() -> None:
    truth = [box(0, 0, 10, 10), box(20, 0, 30, 10), box(40, 0, 45, 5)]
    # Half of the first, in two pieces; less than half of the second; all of the small third, by a large object.
    result = [box(0, 0, 2, 10), box(2, 0, 5, 10), box(20, 0, 24.9, 10), box(38, -5, 50, 10)]
    score = evaluate_polygons(result, truth)
    assert (score.objects.truth_count, score.objects.result_count) == (3, 4)
    assert score.objects.completeness == pytest.approx(2 / 3)
    assert score.objects.correctness == pytest.approx(3 / 4)
    assert score.objects.quality == pytest.approx(1 / (3 / 2 + 4 / 3 - 1))
    large = evaluate_polygons(result, truth, minimum_area=26).large_objects
    assert (large.truth_count, large.result_count) == (2, 3)
    assert (large.completeness, large.correctness) == pytest.approx((1 / 2, 2 / 3))
    assert evaluate_polygons(result, truth, overlap=0.51).objects.completeness == pytest.approx(1 / 3)
    assert math.isnan(evaluate_polygons(result, truth, minimum_area=1000).large_objects.quality)


def test_overlapping_polygons_count_once() -> None:
    truth = [box(0, 0, 10, 10)]
    score = evaluate_polygons([box(0, 0, 6, 10), box(4, 0, 10, 10)], truth)
    assert (score.result_area, score.common_area, score.quality) == pytest.approx((100, 100, 1))
    assert score.objects.result_count == 2
    # Copies of a sixth do not add up to half.
    assert evaluate_polygons([box(0, 0, 2, 10)] * 3, truth).objects.completeness == 0


def test_dissolving_makes_a_terrace_one_object() -> None:
    houses = [box(5 * k, 0, 5 * k + 5, 10) for k in range(6)]
    corner, apart = box(30, 10, 35, 15), box(100, 0, 110, 10)
    score = evaluate_polygons([box(0, 0, 30, 10)], [*houses, corner, apart], dissolve=True)
    assert (score.objects.truth_count, score.objects.result_count) == (3, 1)
    assert score.result_to_truth.rms == pytest.approx(0, abs=1e-9)
    assert score.truth_to_result.length == pytest.approx(80 + 20 + 40)
    split = evaluate_polygons([box(0, 0, 30, 10)], [*houses, corner, apart])
    assert (split.objects.truth_count, split.common_area) == (8, score.common_area)
    assert split.truth_to_result.length == pytest.approx(6 * 30 + 20 + 40)


def test_a_partition_is_not_dissolved() -> None:
    ground = [box(x, y, x + 10, y + 10) for x in range(0, 80, 10) for y in range(0, 80, 10)]
    # Two rows of houses back to back: each has a front of its own.
    terraces = [box(x, y, x + 5, y + 10) for x in range(0, 80, 5) for y in (0, 10)]
    for result, truth, role in ((ground, terraces, "result"), (terraces, ground, "truth")):
        with pytest.raises(InputError, match=f"36 of the 64 polygons of the {role} are shut in.*buildings.parquet"):
            evaluate_polygons(result, truth, dissolve=True)
        evaluate_polygons(result, truth)
    assert evaluate_polygons(terraces, terraces, dissolve=True).objects.result_count == 1


def test_a_multipolygon_is_one_object_unless_dissolved() -> None:
    two = MultiPolygon([box(0, 0, 4, 4), box(10, 0, 14, 4)])
    assert evaluate_polygons([two], [two]).objects.truth_count == 1
    assert evaluate_polygons([two], [two], dissolve=True).objects.truth_count == 2


def test_holes_and_distance_beyond_the_cutoff() -> None:
    ring = box(0, 0, 20, 20).difference(box(5, 5, 15, 15))
    score = evaluate_polygons([box(0, 0, 20, 20)], [ring])
    assert score.correctness == pytest.approx(300 / 400)
    assert (score.result_to_truth.near, score.result_to_truth.rms) == pytest.approx((1, 0), abs=1e-9)
    assert score.truth_to_result.near == pytest.approx(80 / 120)
    far = evaluate_polygons([box(50, 0, 60, 10)], [box(0, 0, 10, 10)])
    assert (far.quality, far.result_to_truth.near) == (0, 0)
    assert math.isnan(far.result_to_truth.rms)
    assert evaluate_polygons([box(3, 3, 7, 7)], [box(0, 0, 10, 10)]).result_to_truth.mean == pytest.approx(3)


@pytest.mark.parametrize("dissolve", [False, True])
def test_area_clips_and_its_border_is_no_boundary(dissolve: bool) -> None:
    area = box(0, -100, 50, 100)
    score = evaluate_polygons(
        [box(-20, 1, 30, 11), box(60, 0, 70, 9)], [box(-40, 0, 30, 10)], area=area, dissolve=dissolve
    )
    assert (score.result_area, score.truth_area, score.common_area) == pytest.approx((300, 300, 270))
    assert score.objects.result_count == 1
    assert score.result_to_truth.length == pytest.approx(30 + 10 + 30)
    with pytest.raises(InputError, match="inside the area"):
        evaluate_polygons([box(0, 0, 1, 1)], [box(60, 0, 70, 9)], area=area)


def test_nothing_extracted_scores_zero_and_undefined() -> None:
    score = evaluate_polygons([], [box(0, 0, 10, 10), None, Polygon()])
    assert (score.completeness, score.quality, score.objects.completeness, score.objects.quality) == (0, 0, 0, 0)
    assert math.isnan(score.correctness)
    assert math.isnan(score.truth_to_result.rms)
    values = json.loads(json.dumps(score.as_dict()))
    assert values["correctness"] is values["objects"]["correctness"] is values["result_to_truth"]["near"] is None
    assert "undefined" in score.summary()


def test_invalid_polygons_are_repaired_and_counted() -> None:
    bow_tie = Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    score = evaluate_polygons([bow_tie], [box(0, 0, 10, 10)])
    assert (score.repaired_result, score.repaired_truth, score.result_area) == (1, 0, 50)
    assert score.objects.result_count == 1
    assert "1 invalid of result" in score.summary()


def test_a_polygon_of_many_vertices_equals_its_intersection() -> None:
    star = Point(0, 0).buffer(60, quad_segs=2000).difference(Point(5, 0).buffer(30, quad_segs=900))
    squares = [box(x, y, x + 3.3, y + 3.3) for x in range(-70, 70, 9) for y in range(-70, 70, 9)]
    score = evaluate_polygons(squares, [star])
    assert score.truth_area == pytest.approx(star.area, rel=1e-12)
    assert score.common_area == pytest.approx(shapely.union_all(squares).intersection(star).area, rel=1e-9)
    shares = shapely.area(shapely.intersection(squares, star)) / shapely.area(squares)
    assert score.objects.correctness == pytest.approx((shares >= 0.5).mean())


def test_bad_arguments_are_refused() -> None:
    square = [box(0, 0, 1, 1)]
    with pytest.raises(InputError, match="overlap"):
        evaluate_polygons(square, square, overlap=0)
    with pytest.raises(InputError, match="minimum area"):
        evaluate_polygons(square, square, minimum_area=-1)
    for name in ("cutoff", "step"):
        with pytest.raises(InputError, match=f"{name} is 0; give a positive"):
            evaluate_polygons(square, square, **{name: 0})
    with pytest.raises(InputError, match="no polygons"):
        evaluate_polygons(square, [])


def _ratios(score: AreaScore) -> list[float]:
    parts = (score, score.objects, score.large_objects)
    ratios = [ratio for part in parts for ratio in (part.completeness, part.correctness, part.quality)]
    return [*ratios, score.result_to_truth.near, score.truth_to_result.near]


@settings(deadline=None, max_examples=40)
@given(layer, layer, st.booleans(), st.sampled_from([None, box(3, 3, 22, 25)]))
def test_scores_are_those_of_the_unions(
    a: list[Polygon], b: list[Polygon], dissolve: bool, area: Polygon | None
) -> None:
    one, other = (shapely.union_all(shapely.make_valid(part)) for part in (a, b))
    if area is not None:
        # without the lines and points in which a layer only touches the area
        one, other = (part.intersection(area).buffer(0) for part in (one, other))
    if other.area == 0:
        return
    score = evaluate_polygons(a, b, dissolve=dissolve, area=area, step=2)
    assert score.result_area == pytest.approx(one.area, abs=1e-6)
    assert score.common_area == pytest.approx(one.intersection(other).area, abs=1e-6)
    assert score.quality == pytest.approx(one.intersection(other).area / one.union(other).area, abs=1e-6)
    assert all(0 <= ratio <= 1 or math.isnan(ratio) for ratio in _ratios(score))


@settings(deadline=None, max_examples=30)
@given(layer, layer, st.booleans())
def test_swapping_the_layers_swaps_the_scores(a: list[Polygon], b: list[Polygon], dissolve: bool) -> None:
    forth = evaluate_polygons(a, b, dissolve=dissolve, step=2, minimum_area=9)
    back = evaluate_polygons(b, a, dissolve=dissolve, step=2, minimum_area=9)
    same = {"abs": 1e-9, "nan_ok": True}
    for one, other in ((forth, back), (forth.objects, back.objects), (forth.large_objects, back.large_objects)):
        assert one.completeness == pytest.approx(other.correctness, **same)
        assert one.correctness == pytest.approx(other.completeness, **same)
        assert one.quality == pytest.approx(other.quality, **same)
    assert forth.result_to_truth.rms == pytest.approx(back.truth_to_result.rms, **same)


@settings(deadline=None, max_examples=30)
@given(layer, st.booleans())
def test_a_layer_agrees_with_itself(a: list[Polygon], dissolve: bool) -> None:
    score = evaluate_polygons(a, a, dissolve=dissolve, overlap=1, minimum_area=0)
    assert _ratios(score) == pytest.approx([1] * 11)
    assert score.result_to_truth.rms == pytest.approx(0, abs=1e-7)


@settings(deadline=None, max_examples=25)
@given(layer, layer)
def test_distances_are_those_to_the_nearest_boundary(a: list[Polygon], b: list[Polygon]) -> None:
    score = evaluate_polygons(a, b, step=0.5, cutoff=4).result_to_truth
    boundary = shapely.boundary(shapely.make_valid(a))
    target = shapely.union_all(shapely.boundary(shapely.make_valid(b)))
    samples = [line.interpolate(t) for line in boundary for t in np.arange(0.025, line.length, 0.05)]
    distance = shapely.distance(samples, target)
    near = distance[distance <= 4]
    assert score.near == pytest.approx(len(near) / len(distance), abs=0.05)
    if len(near) > 400:
        assert score.mean == pytest.approx(near.mean(), abs=0.1)
        assert score.rms == pytest.approx(math.sqrt((near**2).mean()), abs=0.1)


# --- files and the command line


def _write(path: Path, polygons: list[Polygon], crs: str | None, format: str = "parquet") -> Path:
    return write_table(path, {"id": np.arange(len(polygons))}, polygons, crs, format, geometry_type="Polygon")


def test_files_in_feet_are_scored_in_metres(tmp_path: Path) -> None:
    foot = 0.3048
    result = _write(tmp_path / "objects.parquet", [box(6e5, 8e5 + 9, 6e5 + 100, 8e5 + 109)], "EPSG:2994")
    truth = _write(tmp_path / "truth.gpkg", [box(6e5, 8e5, 6e5 + 100, 8e5 + 100)], "EPSG:2994", "gpkg")
    score = evaluate_areas(result, truth)
    assert score.truth_area == pytest.approx(1e4 * foot**2)
    assert score.quality == pytest.approx(91 / 109)
    assert score.truth_to_result.length == pytest.approx(400 * foot)
    assert score.result_to_truth.near == 1
    assert evaluate_areas(result, truth, cutoff=2.7).result_to_truth.near < 1
    assert evaluate_areas(tmp_path, truth) == score
    area = _write(tmp_path / "area.parquet", [box(6e5, 8e5, 6e5 + 50, 8e5 + 200)], "EPSG:2994")
    assert evaluate_areas(result, truth, area).truth_area == pytest.approx(5e3 * foot**2)


def test_unusable_files_are_refused(tmp_path: Path) -> None:
    square = [box(5e5, 0, 5e5 + 9, 9)]
    good = _write(tmp_path / "good.parquet", square, "EPSG:32633")
    degrees = _write(tmp_path / "degrees.parquet", [box(0, 0, 1, 1)], "EPSG:4326")
    other = _write(tmp_path / "other.parquet", square, "EPSG:32632")
    nowhere = _write(tmp_path / "nowhere.parquet", square, None)
    empty = _write(tmp_path / "empty.parquet", [], "EPSG:32633")
    lines = write_table(tmp_path / "lines.parquet", {}, [LineString([(0, 0), (1, 1)])], "EPSG:32633")
    for result, truth, message in [
        (tmp_path / "missing.gpkg", good, "does not exist"),
        (tmp_path, good, "no objects"),
        (degrees, degrees, "longitude and latitude"),
        (good, degrees, "longitude and latitude"),
        (good, other, "reproject"),
        (nowhere, good, "names no CRS"),
        (lines, good, "give Polygon"),
        (good, empty, "no polygons"),
    ]:
        with pytest.raises(InputError, match=message):
            evaluate_areas(result, truth)
    assert evaluate_areas(empty, good).completeness == 0
    none, polygons, network = (read_layer(path, "result") for path in (empty, good, lines))
    assert are_polygons(none, polygons)
    assert are_polygons(polygons, none)
    assert not are_polygons(network, none)
    with pytest.raises(InputError, match="two layers"):
        are_polygons(network, polygons)


def test_one_plane_with_and_without_heights(tmp_path: Path) -> None:
    square = [box(1.2e5, 4.8e5, 1.2e5 + 10, 4.8e5 + 10)]
    plane = _write(tmp_path / "plane.parquet", square, "EPSG:28992")
    heights = _write(tmp_path / "heights.parquet", square, "EPSG:7415")
    assert evaluate_areas(plane, heights).quality == pytest.approx(1)


def test_the_command_scores_polygons(tmp_path: Path) -> None:
    result = _write(tmp_path / "result.parquet", [box(0, 0, 9, 9), box(9, 0, 18, 9)], "EPSG:32633")
    lines = write_table(tmp_path / "lines.parquet", {}, [LineString([(0, 0), (1, 1)])], "EPSG:32633")

    def tell(*words: object) -> object:
        return CliRunner().invoke(cli.app, ["evaluate", *map(str, words)])

    text = tell(result, result).stdout
    assert "100.0 % (IoU)" in text and "100.0 %  of 2 of truth" in text
    values = json.loads(tell(result, result, "--dissolve", "--buffer", 2, "--minimum-area", 20, "--json").stdout)
    assert (values["objects"]["truth_count"], values["cutoff"], values["large_objects"]["minimum_area"]) == (1, 2, 20)
    assert isinstance(tell(result, result, "--direction", 10).exception, InputError)
    assert isinstance(tell(lines, lines, "--dissolve").exception, InputError)


# --- real buildings


def test_real_buildings_against_themselves_shifted(shared_data: Path) -> None:
    import geopandas

    path = shared_data / "amsterdam_ahn3_bag" / "pandactueelbestaand.gpkg"
    if not path.is_file():
        pytest.skip(f"{path.name} is not here")
    buildings = shapely.force_2d(geopandas.read_file(path).geometry.to_numpy())
    moved = shapely.transform(buildings, lambda points: points + np.array([1.0, 0.0]))
    union, other = shapely.union_all(buildings), shapely.union_all(moved)
    for dissolve in (False, True):
        score = evaluate_polygons(moved, buildings, dissolve=dissolve)
        assert score.quality == pytest.approx(union.intersection(other).area / union.union(other).area, rel=1e-6)
        assert score.completeness == pytest.approx(score.correctness, rel=1e-6)
        assert score.objects.truth_count == (108 if dissolve else len(buildings))
        assert score.large_objects.completeness == 1
        # Every boundary has moved by 1 m, so none is farther from where it was.
        assert score.result_to_truth.near == 1
        assert 0.3 < score.result_to_truth.mean < score.result_to_truth.rms < 1
