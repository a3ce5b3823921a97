"""The benchmark of `edges`: its instances, peers and scores on made-up data, its rivals, its page."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from benchmarks.edges import accuracy, cuts, instances, rivals
from benchmarks.edges import lines as edge_lines
from benchmarks.edges.instances import Grey, Instance, aerial, of_model, segmentation
from benchmarks.edges.optimisers import EXACT, ICM, PARALLEL, optimiser_table, run_instance
from benchmarks.edges.page import run_edges
from benchmarks.edges.pipeline import OURS, EdgeScene, Outcome, prepare, speed_table
from benchmarks.measure.commands import stage_table
from benchmarks.measure.contest import Unsuitable
from benchmarks.measure.machine import Machine
from benchmarks.measure.watch import Watched
from tests.commands_here import run_commands_here
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.mrf.edge_energy import energy
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.search import Method, Search

MACHINE = Machine("a processor", 2, 8 << 30, "3.11", {"numpy": "2"}, "2026-01-01", 0.0, 1e9)


def small(count: int = 3, size: int = 4) -> Instance:
    """A problem with a weight for each pair."""
    random = np.random.default_rng(count)
    down, right = random.random((size - 1, size)), random.random((size, size - 1))
    unary = random.random((size, size, count)).astype(np.float32)
    return Instance("small", unary, 1 - np.eye(count), down=down, right=right)


def two_halves(size: int = 24) -> Grey:
    values = np.random.default_rng(0).integers(58, 63, (size, size)).astype(np.float32)
    values[:, size // 2 :] += 120
    return Grey(values, "two halves")


def test_energy_of_an_instance_is_the_models() -> None:
    random = np.random.default_rng(0)
    y = random.uniform(0, 3, (12, 15)).astype(np.float32)
    labels = random.integers(0, 4, y.shape).astype(np.uint8)
    for potential in ("reciprocal", "quadratic"):
        model = EdgeModel(4, potential)  # type: ignore[arg-type]
        assert of_model("x", y, model).energy(labels) == pytest.approx(energy(y, labels, None, None, model), rel=1e-6)


def test_energy_with_weights_is_its_definition() -> None:
    instance = small()
    assert instance.down is not None and instance.right is not None
    labels = np.random.default_rng(1).integers(0, 3, (4, 4))
    expected = 0.0
    for i, j in itertools.product(range(4), range(4)):
        expected += instance.unary[i, j, labels[i, j]]
        expected += instance.down[i, j] * (labels[i, j] != labels[i + 1, j]) if i < 3 else 0
        expected += instance.right[i, j] * (labels[i, j] != labels[i, j + 1]) if j < 3 else 0
    assert instance.energy(labels) == pytest.approx(expected)


def test_ours_is_told_the_weights_of_pairs() -> None:
    # weights so strong that all labels agree, but where one row of pairs weighs nothing
    unary = np.zeros((6, 5, 2), np.float32)
    unary[:3, :, 1] = unary[3:, :, 0] = 0.1
    down, right = np.full((5, 5), 9.0), np.full((6, 4), 9.0)
    down[2] = 0
    instance = Instance("x", unary, 1 - np.eye(2), down=down, right=right)
    labels = instance.solve(slice(0, 6), Search("messages")).labels
    assert (labels[:3] == 0).all() and (labels[3:] == 1).all()


def test_graph_cuts_find_the_minimum() -> None:
    pytest.importorskip("maxflow")
    pytest.importorskip("gco")
    instance = small(2, 3)
    least = min(instance.energy(np.reshape(x, (3, 3))) for x in itertools.product((0, 1), repeat=9))
    assert instance.energy(cuts.expansion(instance, -1)(1)) == pytest.approx(least, abs=1e-5)
    y = np.random.default_rng(2).uniform(0, 1, (3, 3)).astype(np.float32)
    for potential in ("reciprocal", "quadratic"):
        model = of_model("x", y, EdgeModel(2, potential, sigma=1.0))  # type: ignore[arg-type]
        least = min(model.energy(np.reshape(x, (3, 3))) for x in itertools.product((0, 1), repeat=9))
        for found in (cuts.minimum_cut(model), cuts.expansion(model, -1)):
            assert model.energy(found(1)) == pytest.approx(least, abs=1e-4)


def test_a_cut_of_layers_finds_the_minimum_of_a_convex_potential() -> None:
    pytest.importorskip("maxflow")
    random = np.random.default_rng(3)
    distance = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    # second differences: one everywhere; none at first; none after; equal labels that cost something
    for steps in ([0, 1, 4, 9], [0, 1, 2, 5], [0, 2, 4, 6], [-1, 0, 2, 5]):
        instance = Instance("x", random.uniform(0, 9, (2, 3, 4)).astype(np.float32), np.array(steps, float)[distance])
        least = min(instance.energy(np.reshape(x, (2, 3))) for x in itertools.product(range(4), repeat=6))
        assert instance.energy(cuts.minimum_cut(instance)(1)) == pytest.approx(least, abs=1e-5)


def test_no_optimiser_is_below_the_exact_minimum() -> None:
    pytest.importorskip("maxflow")
    instance = of_model("K = 4", aerial(48, Path("nowhere")).observed(4), EdgeModel(4, "quadratic"))
    least = instance.energy(cuts.minimum_cut(instance)(1))
    for method in get_args(Method):
        found = instance.energy(instance.solve(slice(0, 48), Search(method)).labels)
        assert least - 1e-3 <= found < 1.05 * least, method


def test_a_corner_is_a_problem_of_its_own() -> None:
    instance = small(3, 6)
    labels = np.random.default_rng(0).integers(0, 3, (6, 6))
    corner = instance.corner(2)
    assert instance.down is not None and instance.right is not None
    pairs = [((0, 0), (1, 0), instance.down[0, 0]), ((0, 1), (1, 1), instance.down[0, 1])]
    pairs += [((0, 0), (0, 1), instance.right[0, 0]), ((1, 0), (1, 1), instance.right[1, 0])]
    expected = sum(instance.unary[place][labels[place]] for place in np.ndindex(2, 2))
    expected += sum(weight * (labels[one] != labels[other]) for one, other, weight in pairs)
    assert corner.energy(labels[:2, :2]) == pytest.approx(expected)
    observed = of_model("x", np.zeros((5, 4), np.float32), EdgeModel(2)).corner(3)
    assert observed.observed is not None and observed.observed.shape == (3, 3)


def test_graph_cuts_are_not_asked_for_what_they_cannot_do() -> None:
    pytest.importorskip("maxflow")
    pytest.importorskip("gco")
    y = np.zeros((3, 3), np.float32)
    with pytest.raises(Unsuitable, match="not convex"):
        cuts.minimum_cut(of_model("x", y, EdgeModel(3)))
    with pytest.raises(Unsuitable, match="one potential"):
        cuts.minimum_cut(small())
    with pytest.raises(Unsuitable, match="no metric"):
        cuts.expansion(of_model("x", y, EdgeModel(3, "quadratic")), -1)
    for instance in (instances.truncated(y), of_model("x", y, EdgeModel(16))):
        cuts.expansion(instance, -1)


def test_optimisers_and_their_table() -> None:
    grey = aerial(40, Path("nowhere"))
    assert grey.values.shape == (40, 40) and "synthetic" in grey.source
    instance = of_model("K = 2", grey.observed(2), EdgeModel(2))
    solved = run_instance(instance, workers=2, repetitions=1, peers=True, sweeps=[2])
    found = {each.name: each for each in solved}
    if not found[EXACT].measurement.skipped:
        assert min(each.energy for each in solved) >= found[EXACT].energy - 1e-3
    # tiles do not show
    whole = instance.solve(slice(0, 40)).labels
    assert found[PARALLEL].energy == instance.energy(whole)
    table = optimiser_table([solved], MACHINE)
    assert all(len(row) == len(table.columns) for row in table.rows)
    assert table.rows[0][:2] == ["K = 2, 0.0016 Mpx", f"**{PARALLEL}**"] and "aim 20 Mpx/s" in table.rows[0][-1]
    assert [row[9] for row in table.rows if row[1] == f"**{ICM}**"] in (["0%"], ["–"])


def test_points_of_edges() -> None:
    h, v = np.zeros((2, 3, 3), np.uint8)
    h[0, 1] = v[2, 0] = 1
    np.testing.assert_array_equal(accuracy.of_cracks(h, v), [[1, 1.5], [2.5, 1]])
    segment = accuracy.of_detected(np.array([[1, 0, 1, 2]], np.float32))
    np.testing.assert_allclose(segment, [[0.75, 1.5], [1.25, 1.5], [1.75, 1.5], [2.25, 1.5]])
    lines = accuracy.of_polylines(Polylines(np.array([0, 2, 4]), np.array([[0, 0], [0, 1], [5, 5], [6, 5]])))
    np.testing.assert_allclose(lines, [[0.5, 0.75], [0.5, 1.25], [5.75, 5.5], [6.25, 5.5]])
    assert accuracy.of_polylines(Polylines(np.array([0]), np.empty((0, 2)))).shape == (0, 2)


def test_scores_of_edges() -> None:
    truth = np.array([[5.0, 5.0], [5.0, 9.0]])
    found = np.array([[6.0, 5.0], [7.0, 5.0], [9.0, 9.0]])
    scores = accuracy.score(found, truth, (12, 12))
    assert scores[1.0] == pytest.approx((1 / 3, 1 / 2)) and scores[2.0] == pytest.approx((2 / 3, 1 / 2))
    nothing = accuracy.score(np.empty((0, 2)), truth, (12, 12))[1.0]
    assert np.isnan(nothing[0]) and nothing[1] == 0


def test_every_detector_finds_the_edge_between_two_halves() -> None:
    grey = two_halves(64)
    truth = np.stack([np.arange(64) + 0.5, np.full(64, 32.0)], axis=1)
    # four levels would part the noise
    contestants = [each for each in accuracy._ours(grey, 2) if "4 levels" not in each[0]]
    try:
        import cv2  # noqa: F401

        contestants += accuracy._peers(grey)
    except ImportError:
        pass
    for name, find in contestants:
        try:
            precision, recall = accuracy.score(find(), truth, (64, 64))[1.0]
        except Unsuitable:
            continue
        assert precision > 0.9 and recall > 0.8, name


def test_tiles_do_not_show_in_lines() -> None:
    grey = aerial(150, Path("nowhere"))
    observed, model = grey.observed(4), EdgeModel(4)
    for way in (edge_lines.sequential, edge_lines.integrated):
        for one, two in zip(way(observed, model, 1), way(observed, model, 2), strict=True):
            np.testing.assert_array_equal(one, two)
    threshold = edge_lines.babu_threshold(grey.values)
    for a, b in zip(*(edge_lines.babu_lines(grey.values, threshold, n) for n in (1, 2)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("way", ["opencv", "skimage"])
def test_rivals_write_a_mask_and_lines(way: str, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    import geopandas
    import rasterio
    from affine import Affine

    bands = np.repeat(two_halves(40).values[None].astype(np.uint8), 3, axis=0)
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 3, "height": 40, "width": 40, "crs": "EPSG:32631"}
    with rasterio.open(tmp_path / "image.tif", "w", transform=Affine(0.5, 0, 100, 0, -0.5, 200), **profile) as file:
        file.write(bands)
    rivals.main(str(tmp_path / "image.tif"), str(tmp_path / "out"), way)
    with rasterio.open(tmp_path / "out" / rivals.MASK) as file:
        rows, columns = np.nonzero(file.read(1))
    assert set(columns) <= {19, 20} and len(set(rows)) > 30
    lines = geopandas.read_parquet(tmp_path / "out" / rivals.LINES)
    assert len(lines) == 1 and abs(lines.geometry.iloc[0].centroid.x - 110) <= 0.5


def test_what_is_not_here_is_named(tmp_path: Path) -> None:
    with pytest.raises(Unsuitable, match="no file"):
        prepare("photograph", tmp_path, size=0, workers=1, data=tmp_path)
    with pytest.raises(Unsuitable, match="no file"):
        segmentation(tmp_path)


def test_table_of_the_pipeline() -> None:
    scene = EdgeScene("a scene", Path("x.tif"), (1000, 1000), None, "nowhere")
    outcomes = [
        Outcome(OURS, scene, [Watched(0.25, 1 << 30)], Watched(0.5, 1), [{"fields": 0.1}], lines=7),
        Outcome("rival", scene, [Watched(1.0, 1 << 30)], precision=0.5, recall=1.0),
        Outcome("other", scene, skipped="too large"),
    ]
    rows = speed_table(outcomes, MACHINE).rows
    assert rows[0][2:6] == ["4", "2", "2", "4 ×"] and rows[0][-1] == "aim 3: reached"
    assert rows[1][10:13] == ["50.0 %", "100.0 %", "66.7 %"] and rows[2][-1] == "skipped: too large"
    assert all(len(row) == len(rows[0]) for row in rows)
    assert stage_table(outcomes).rows[0][2].startswith("fields 0.1 s (40%)")


@pytest.mark.slow
def test_ours_run_on_a_tiny_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.edges.page.describe_machine", lambda: MACHINE)
    run_commands_here(monkeypatch, "benchmarks.edges.page", "benchmarks.measure.commands")
    found = run_edges(
        sizes=[128], image_size=48, accuracy_size=64, sweeps=[2], repetitions=1, peers=False, data=tmp_path,
        scratch=tmp_path, results=tmp_path / "results",
    )  # fmt: skip
    page = (tmp_path / "results" / "edges.md").read_text()
    assert len(found.solved) == 6 and len(found.lines) == 3 and len(found.outcomes) == 1
    assert found.outcomes[0].lines > 0 and found.outcomes[0].precision > 0
    assert "Skipped: scene photograph" in page and "Skipped: the Potts energy" in page
    assert "Aims, on all cores" in page and "| city 128², 0.016 Mpx | **tilepipe edges** |" in page
    assert "](edges-optimisers.png)" in page and (tmp_path / "results" / "edges-optimisers.png").stat().st_size > 10_000
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
