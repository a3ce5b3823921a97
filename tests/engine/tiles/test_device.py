"""Tiles on the device: what does not fit beside others tries alone, and a run that cannot fit is told how it would."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Silent
from tilepipe.engine.tiles.device import fitting, on_device
from tilepipe.engine.tiles.executors import open_executor
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.errors import InputError
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe_kernels.core.arrays import choose_backend, to_device
from tilepipe_kernels.core.device_memory import DeviceMemoryError
from tilepipe_kernels.core.simulated import simulating

GRID = TileGrid((40, 60), (20, 20))
TILE = GRID.tile(1, halo=4)
LIMIT = 1 << 30

pytestmark = pytest.mark.skipif(not simulating(), reason="needs numba's CUDA simulator, and a real GPU is in use")


def test_tile_that_does_not_fit_beside_others_runs_alone() -> None:
    others, alone = threading.Event(), []

    def beside() -> str:
        others.set()
        threading.Event().wait(0.2)
        alone.append("other done")
        return "other"

    def hungry() -> str:
        if not alone:
            raise DeviceMemoryError("out of memory")
        return "fits now"

    thread = threading.Thread(target=lambda: on_device(beside, TILE, LIMIT))
    thread.start()
    others.wait()
    assert on_device(hungry, TILE, LIMIT) == "fits now"
    thread.join()


def test_tile_that_never_fits_names_the_tile_size() -> None:
    def never() -> None:
        raise DeviceMemoryError("out of memory")

    with pytest.raises(InputError, match=r"tiles of 20 pixels with their halo \(28 x 24\); use --tile 10"):
        on_device(never, TILE, LIMIT)
    # the device is free again
    assert on_device(lambda: 1, TILE, LIMIT) == 1


def test_other_errors_pass() -> None:
    calls = []

    def fails() -> None:
        calls.append(1)
        raise ValueError("something else about memory")

    with pytest.raises(ValueError, match="something else"):
        on_device(fails, TILE, LIMIT)
    assert len(calls) == 1


def test_an_error_of_the_second_attempt_passes_too() -> None:
    errors = iter([DeviceMemoryError("out of memory"), ValueError("something else")])

    def fails() -> None:
        raise next(errors)

    with pytest.raises(ValueError, match="something else"):
        on_device(fails, TILE, LIMIT)


@pytest.mark.parametrize("backend", ["numpy", "cupy"])
def test_what_is_no_tile_must_fit_as_well(backend) -> None:
    with fitting("the seams", "use fewer", backend):
        pass
    with pytest.raises(ValueError, match="something else"), fitting("the seams", "use fewer", backend):
        raise ValueError("something else about memory")
    told = r"^the memory of the GPU, or --memory, is too small for the seams; use fewer$"
    with pytest.raises(InputError, match=told), fitting("the seams", "use fewer", backend):
        raise DeviceMemoryError("out of memory")


def facts_on_device(context: int, tile: Tile) -> Facts:
    return {"numbers": to_device(np.arange(tile.number + context))}


def test_facts_come_home(tmp_path: Path) -> None:
    pass_ = BoundPass("numbers", facts_on_device, 3, GRID, 0, backend="cupy")
    with open_executor("threads", 2) as executor:
        found = run_pass(pass_, tmp_path, executor, Silent()).all_facts()
    assert [len(facts["numbers"]) for facts in found] == [3, 4, 5, 6, 7, 8]


def test_what_the_backends_mean() -> None:
    # a simulation is only for those who ask for it
    assert choose_backend("auto") == "numpy"
    assert choose_backend("cupy") == "cupy"
    with pytest.raises(ValueError, match="unknown"):
        choose_backend("jax")
    assert RunOptions(executor="tcp://far:8786").resolved_backend() == "numpy"
    assert RunOptions(executor="processes", workers=4, memory=8 << 30).device_memory == 2 << 30


def test_missing_gpu_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    monkeypatch.setattr("tilepipe_kernels.core.arrays.why_no_device", lambda: "cupy finds no NVIDIA GPU")
    with pytest.raises(InputError, match="backend 'cupy' does not work here: cupy finds no NVIDIA GPU"):
        RunOptions(backend="cupy").resolved_backend()


def test_plan_counts_the_memory_of_the_gpu(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from tests.scenes import write_raster
    from tilepipe import streets

    raster = write_raster(tmp_path / "scene.tif", np.ones((64, 64), np.float32))
    monkeypatch.setattr("tilepipe.engine.work.device_memory", lambda: 1000)
    with pytest.raises(InputError, match=r"needs about \d+ KiB of the GPU's memory, which has 1000 B; use a smaller"):
        streets(raster, out=tmp_path / "run", options=RunOptions(backend="cupy"))
    assert not (tmp_path / "run").exists()


def test_memory_that_no_tile_size_saves_is_said(tmp_path: Path) -> None:
    from tests.scenes import write_raster
    from tilepipe import plan_streets

    raster = write_raster(tmp_path / "scene.tif", np.ones((64, 64), np.float32))
    options = RunOptions(memory=100 << 20)
    plan = plan_streets(raster, options=options)
    with pytest.raises(InputError, match=r"at least \d+ MiB whatever the tiles"):
        plan.check(options)
    assert "would be refused" in plan.text()
