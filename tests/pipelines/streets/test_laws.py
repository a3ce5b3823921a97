"""Laws 1 and 4 on the whole pipeline: identical bytes for any tiling, worker, interruption; nothing half there."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.laws import Killed, assert_invisible, assert_resumes, layer_bytes, tiles
from tests.scenes import LAYERS, SMALL, band, draw, ring, run_streets, write_raster
from tilepipe.engine.options import RunOptions
from tilepipe.errors import InputError
from tilepipe.io.files.record import STATE
from tilepipe.pipelines.streets.pipeline import streets

SHAPE = (90, 110)


def scene_masks() -> dict[str, np.ndarray]:
    """Scenes that seams could break."""
    cross = band(SHAPE, (-5, 40), (95, 70), 7) | band(SHAPE, (60, -5), (30, 115), 6)
    corner = band(SHAPE, (4, 4), (31, 31), 5) | band(SHAPE, (32, 32), (80, 100), 5)
    snake = ring(SHAPE, (22, 30), 15, 5) | ring(SHAPE, (60, 60), 24, 6) | band(SHAPE, (22, 45), (60, 36), 5)
    comb = band(SHAPE, (45, 5), (45, 105), 6)
    for column in range(15, 105, 15):
        comb |= band(SHAPE, (45, column), (10 if column % 2 else 80, column), 4)
    return {"cross": cross, "corner": corner, "rings": snake, "comb": comb}


def _run(raster, parameters, out, options, **inputs):
    streets(raster, out=out, params=parameters, options=options, **inputs)


def pipeline(raster, **parameters):
    """The run of the laws on a raster, with the small parameters."""
    return partial(_run, raster, SMALL | parameters)


@pytest.mark.parametrize("name", ["cross", "corner", "rings", "comb"])
def test_tiling_is_invisible(tmp_path, name):
    values = draw(SHAPE, scene_masks()[name])
    values[40:44, 50:53] = np.nan
    values[10:30, 80:84] = np.nan
    raster = write_raster(tmp_path / "intensity.tif", values, nodata=float("nan"))
    whole = layer_bytes(run_streets(raster, tmp_path / "whole", 1000))
    assert_invisible(pipeline(raster), tmp_path, whole, [RunOptions(tile=tile, workers=1) for tile in (64, 32, 23, 16)])


@pytest.mark.parametrize(("workers", "executor"), [(3, "threads"), (2, "processes")])
def test_workers_are_invisible(tmp_path, workers, executor):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    whole = layer_bytes(run_streets(raster, tmp_path / "whole", 30))
    assert_invisible(pipeline(raster), tmp_path, whole, [RunOptions(tile=30, workers=workers, executor=executor)])


def test_rectangles_are_cut_by_no_seam(tmp_path):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    rectangle = {"rectangle_rows": 3, "rectangle_columns": 1}
    whole = layer_bytes(run_streets(raster, tmp_path / "whole", 1000, **rectangle))
    choices = [RunOptions(tile=tile, workers=1) for tile in (40, 17)]
    assert_invisible(pipeline(raster, **rectangle), tmp_path, whole, choices)


def test_rectangles_with_voids_heights_and_data_driven_thresholds(tmp_path):
    values = draw(SHAPE, scene_masks()["cross"])
    values[np.random.default_rng(3).random(SHAPE) < 0.15] = np.nan
    raster = write_raster(tmp_path / "intensity.tif", values, nodata=float("nan"))
    heights = np.where(np.arange(SHAPE[1]) < 60, 10.0, 10.4).astype(np.float32) * np.ones(SHAPE, np.float32)
    heights[20:40, 45:60] += 5
    dsm = write_raster(tmp_path / "heights.tif", heights)
    settings = SMALL | {
        "rectangle_columns": 3,
        "void_reach": 0,
        "diffusion_steps": 2,
        "tolerance": 30,
        "minimum_size": 10,
        "minimum_contour": 10,
        "opening_radius": 0,
        "ground_window": 24,
        "thresholds": "histogram",
    }
    run = partial(_run, raster, settings, height=dsm)
    run(tmp_path / "whole", RunOptions(tile=300))
    choices = [RunOptions(tile=tile) for tile in (60, 33, 12)]
    assert_invisible(run, tmp_path, layer_bytes(tmp_path / "whole"), choices)


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**20), tile=st.integers(9, 70), smoothness=st.sampled_from([1.0, 2.5]))
def test_tiling_is_invisible_on_random_textures(tmp_path_factory, seed, tile, smoothness):
    from scipy import ndimage

    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(30, 80, 2))
    texture = ndimage.gaussian_filter(rng.normal(size=shape), smoothness)
    values = np.where(texture > 0.1 / smoothness, 150, 40) + rng.normal(0, 4, shape)
    values[rng.random(shape) < 0.01] = np.nan
    folder = tmp_path_factory.mktemp("random")
    raster = write_raster(folder / "intensity.tif", values.astype(np.float32), nodata=float("nan"))
    reference = layer_bytes(run_streets(raster, folder / "whole", 1000))
    assert layer_bytes(run_streets(raster, folder / "tiled", tile)) == reference


def test_the_cut_of_the_input_is_invisible(tmp_path):
    values = draw(SHAPE, scene_masks()["rings"])
    whole = write_raster(tmp_path / "whole.tif", values)
    parts = []
    for top, left in ((0, 0), (0, 60), (37, 0), (37, 60)):
        part = values[top : 37 if top == 0 else None, left : 60 if left == 0 else None]
        origin = (500000.0 + left, 5000000.0 - top)
        parts.append(write_raster(tmp_path / f"part{top}_{left}.tif", part, origin=origin))
    reference = layer_bytes(run_streets(whole, tmp_path / "a", 50))
    assert layer_bytes(run_streets(parts[::-1], tmp_path / "b", 50)) == reference


@pytest.mark.parametrize("survived", [0, 1, 5, 13, 20])
def test_a_run_killed_at_any_tile_resumes(tmp_path, survived):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    whole = layer_bytes(run_streets(raster, tmp_path / "whole", 40))
    worked = assert_resumes(
        pipeline(raster), tmp_path / "run", whole, RunOptions(tile=40, workers=1), survived=survived
    )
    assert len(worked) == 3 * 9


@pytest.mark.parametrize("failing", ["levels", "segment", "lines"])
def test_a_failed_run_resumes(tmp_path, failing):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    whole = layer_bytes(run_streets(raster, tmp_path / "whole", 40))
    assert_resumes(pipeline(raster), tmp_path / "run", whole, RunOptions(tile=40, workers=1), failing)


def _command(raster: Path, out: Path) -> list[str]:
    assignments = [part for name, value in SMALL.items() for part in ("--set", f"{name}={value}")]
    return [
        sys.executable,
        "-m",
        "tilepipe",
        "streets",
        str(raster),
        "--out",
        str(out),
        "--tile",
        "20",
        *assignments,
    ]


def test_sigkill_at_random_moments_leaves_a_resumable_run(tmp_path):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["comb"]))
    reference = layer_bytes(run_streets(raster, tmp_path / "reference", 20))
    out = tmp_path / "run"
    killed = 0
    rng = np.random.default_rng(1)
    for _ in range(3):
        process = subprocess.Popen(_command(raster, out), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        while not (out / STATE).exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(rng.uniform(0.05, 0.8))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        killed += not (out / "run.toml").exists()
        if (out / "run.toml").exists():
            break
        assert not any((out / name).exists() for name in LAYERS)
    assert killed > 0
    if not (out / "run.toml").exists():
        assert subprocess.run([*_command(raster, out), "--quiet"], check=False).returncode == 0
    assert layer_bytes(out) == reference


def test_a_finished_run_is_not_replaced_unless_told(tmp_path):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    out = run_streets(raster, tmp_path / "run", 64)
    before = layer_bytes(out)
    with pytest.raises(InputError, match="finished run; use --overwrite"):
        run_streets(raster, out, 64)
    streets(raster, out=out, params=SMALL | {"minimum_length": 60}, options=RunOptions(overwrite=True))
    assert layer_bytes(out)["centerlines.parquet"] != before["centerlines.parquet"]


def test_an_unfinished_run_of_something_else_is_not_mixed_in(tmp_path):
    raster = write_raster(tmp_path / "intensity.tif", draw(SHAPE, scene_masks()["cross"]))
    with tiles(lambda *_: Killed()), pytest.raises(Killed):
        run_streets(raster, tmp_path / "run", 40)
    with pytest.raises(InputError, match=r"differs in parameters\.tolerance"):
        run_streets(raster, tmp_path / "run", 40, tolerance=7)
