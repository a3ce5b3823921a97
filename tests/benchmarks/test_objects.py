"""The benchmark of `objects`: its measures on made-up partitions, its rivals on tiny data, its page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from benchmarks.measure.commands import stage_table
from benchmarks.measure.contest import Unsuitable
from benchmarks.measure.machine import Machine
from benchmarks.measure.watch import Watched
from benchmarks.objects.chains import LARGEST_JAGS, Chains, jags, plain_loop, rows_of
from benchmarks.objects.page import run_objects
from benchmarks.objects.pipeline import OURS, Outcome
from benchmarks.objects.quality import blocks_of, score_partition
from benchmarks.objects.rivals import components, polygons_of
from benchmarks.objects.samplers import COUNTING, LOOP, Sampled, effective_draws, sampler_table
from benchmarks.objects.scenes import ObjectScene, prepare
from benchmarks.objects.tables import building_table, partition_table, speed_table, verdict
from tests.commands_here import run_commands_here
from tilepipe_kernels.car_model.model import CarModel
from tilepipe_kernels.car_model.sampler import sample

MACHINE = Machine("a processor", 2, 8 << 30, "3.11", {"numpy": "2"}, "2026-01-01", 0.0, 1e9)


def boxes(*bounds: tuple[float, float, float, float]) -> np.ndarray:
    return np.array([shapely.box(*b) for b in bounds], dtype=object)


def scene(truth: np.ndarray, area: object = None) -> ObjectScene:
    return ObjectScene("a scene", Path("height.tif"), truth, area, (100, 100), "nowhere")


def test_best_unions_of_a_partition() -> None:
    # two houses of a terrace are one block of 20 × 10; a shed is too small
    truth = scene(boxes((0, 0, 10, 10), (10, 0, 20, 10), (40, 0, 41, 1)))
    blocks = blocks_of(truth)
    assert len(blocks) == 1 and blocks[0].area == 200
    # two objects inside, one that leaks by 4 of 10 m, one that lies mostly outside
    objects = boxes((0, 0, 10, 10), (10, 0, 18, 10), (18, 0, 20, 5), (18, 5, 25, 10))
    score = score_partition(objects, truth, blocks)
    assert (score.blocks, score.found, score.objects_per_block) == (1, 1.0, 3.0)
    assert score.iou == pytest.approx(190 / 200)
    assert score.under_segmentation == pytest.approx(10 / 200)
    leaking = score_partition(boxes((0, 0, 20, 14)), truth, blocks)
    assert leaking.iou == pytest.approx(200 / 280) and leaking.under_segmentation == pytest.approx(80 / 200)
    assert leaking.union.result_to_truth.near == pytest.approx((20 + 2 * 11) / 68, abs=0.01)
    # inside an area that cuts the leak off, the object is exact
    cut = replace(truth, area=shapely.box(0, 0, 20, 10))
    assert score_partition(boxes((0, 0, 20, 14)), cut, blocks_of(cut)).iou == pytest.approx(1)


def test_a_partition_that_misses_all_blocks() -> None:
    truth = scene(boxes((0, 0, 10, 10)))
    score = score_partition(boxes((-50, -50, 50, 50)), truth, blocks_of(truth))
    assert score.found == 0 and score.iou == 0 and np.isnan(score.objects_per_block)
    assert score.under_segmentation == pytest.approx(1)


def test_components_of_the_rival() -> None:
    pytest.importorskip("cc3d")
    height = np.full((20, 20), -3.0, np.float32)
    height[4:12, 4:12] = 5.0
    height[15, 15] = 9.0
    valid = np.ones(height.shape, bool)
    valid[0] = False
    labels = components(height, valid, 0.5)
    assert (labels[0] == 0).all() and labels[15, 15] == 0
    assert len(np.unique(labels[1:])) == 3 and len(np.unique(labels[4:12, 4:12])) == 1
    from affine import Affine

    ids, polygons = polygons_of(labels, Affine(0.5, 0, 0, 0, -0.5, 10))
    assert sorted(ids) == sorted(np.unique(labels[labels > 0]))
    assert sorted(shapely.area(polygons)) == [16.0, (19 * 20 - 64 - 1) / 4]


def chain_model() -> CarModel:
    random = np.random.default_rng(0)
    nodes = np.arange(99)
    edges = np.stack([nodes, nodes + 1], axis=1).astype(np.int32)
    heights = np.where(np.arange(100) < 50, 0.0, 3.0) + random.normal(0, 0.1, 100)
    return CarModel(edges, None, np.full(100, 20.0), heights, np.full(100, 1.0))


def test_the_plain_loop_samples_the_same_posterior() -> None:
    model = chain_model()
    traces, mean, deviation, same = plain_loop(model, rows_of(model), 200, 4000, 0.5)
    ours = sample(model, burn_in=200, draws=4000, tolerance=0.5, counting=True)
    assert traces[0].mean() == pytest.approx(ours.smoothness.mean(), rel=0.05)
    assert traces[1].mean() == pytest.approx(ours.noise.mean(), rel=0.02)
    np.testing.assert_allclose(mean, ours.mean, atol=0.02)
    np.testing.assert_allclose(deviation, ours.sd, rtol=0.15)
    assert ours.same is not None
    np.testing.assert_allclose(same, ours.same, atol=0.05)


def test_effective_draws_of_independent_ones() -> None:
    random = np.random.default_rng(1)
    draws = random.normal(size=(2, 500, 4000))
    chains = Chains(random.normal(size=(2, 2, 500)), draws.mean(1), draws.std(1), (draws > 0).mean(1), 2.0, 1000)
    assert effective_draws(chains) == pytest.approx([1000] * 4, rel=0.25)
    rows = sampler_table(
        [
            Sampled(4000, COUNTING, chains),
            Sampled(4000, LOOP, replace(chains, seconds=8.0)),
            Sampled(9, "x", None, "no"),
        ]
    ).rows
    assert rows[0][9] == "4 ×" and "reached" in rows[0][-1] and rows[1][9] == "" and rows[2][-1] == "skipped: no"


def test_jags_is_not_asked_for_what_it_cannot_do(monkeypatch: pytest.MonkeyPatch) -> None:
    model = chain_model()
    monkeypatch.setattr("benchmarks.objects.chains.shutil.which", lambda name: None)
    with pytest.raises(Unsuitable, match="not installed"):
        jags(model, 10, 10)
    monkeypatch.setattr("benchmarks.objects.chains.shutil.which", lambda name: "jags")
    nodes = np.zeros(LARGEST_JAGS + 1)
    with pytest.raises(Unsuitable, match="not tried"):
        jags(CarModel(np.empty((0, 2), np.int32), None, nodes + 1, nodes, nodes), 10, 10)


def test_a_survey_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(Unsuitable, match="its survey is not here"):
        prepare("amsterdam", tmp_path, size=0, workers=1, data=tmp_path)


def test_tables_and_words() -> None:
    truth = scene(boxes((0, 0, 20, 10)))
    blocks = blocks_of(truth)
    outcomes = []
    for name, seconds, objects in ((OURS, 2.0, (0, 0, 20, 10)), ("rival", 1.0, (0, 0, 20, 14))):
        outcome = Outcome(name, truth, [Watched(seconds, 1 << 30)], Watched(2 * seconds, 1), [{"merge": 0.5}])
        outcome.partition = score_partition(boxes(objects), truth, blocks)
        outcome.buildings["a way"] = outcome.partition.union
        outcomes.append(outcome)
    speed = speed_table(outcomes, MACHINE).rows
    assert speed[0][2:5] == ["0.005", "0.5 ×", "0.0025"] and speed[1][3] == ""
    for table in (speed_table(outcomes, MACHINE), partition_table(outcomes), building_table(outcomes)):
        assert all(len(row) == len(table.columns) for row in table.rows)
    assert "merge 0.5 s (25%)" in stage_table(outcomes).rows[0][2]
    words = verdict(outcomes)[0]
    assert words.startswith("**a scene.** Better: IoU of the best union (100.0 % against 71.4 %)")
    assert "Worse: speed (0.005 against 0.01 Mpx/s)" in words


@pytest.mark.slow
def test_ours_run_on_a_tiny_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.objects.page.describe_machine", lambda: MACHINE)
    run_commands_here(monkeypatch, "benchmarks.objects.page", "benchmarks.measure.commands")
    found = run_objects(
        sizes=[128], scenes=["city", "amsterdam"], nodes=[400], kernel_size=128, updates=1e4, repetitions=1,
        peers=False, data=tmp_path, scratch=tmp_path, results=tmp_path / "results",
    )  # fmt: skip
    page = (tmp_path / "results" / "objects.md").read_text()
    assert found.outcomes[0].partition is not None and found.outcomes[0].coverage
    assert "Skipped: scene amsterdam" in page and "| city 128², 0.016 Mpx | **tilepipe objects** |" in page
    assert len(found.sampled) == 3 and len(found.sweeps) == 1 and len(found.kernels) == 4
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
