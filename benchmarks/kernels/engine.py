"""What the engine itself costs: a pass that does nothing, from Zarr to Zarr."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.kernels.scene import Scene
from benchmarks.measure.contest import Call, Case, Contestant
from tilepipe.engine.progress import Silent
from tilepipe.engine.tiles.executors import open_executor
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid

TILE = 2048


@dataclass(frozen=True)
class _Copy:
    source: StateArray
    target: StateArray


def _copy(context: _Copy, tile: Tile) -> Facts:
    """Tile function: write what was read."""
    return write_state({"target": context.target}, tile, {"target": context.source.read(tile.core)})


def engine_case(scene: Scene, size: int, scratch: Path) -> Case:
    """Diffused intensity, ``size`` pixels a side, float32, read and written by tiles of 2048 pixels."""
    source = StateArray(scratch / "source.zarr", TileGrid((size, size), (min(TILE, size),) * 2), "float32")

    def prepare() -> None:
        if not source.path.exists():
            source.create()
            for tile in source.grid.tiles():
                repeats = [-(-side // scene.size) for side in tile.core.shape]
                source.write(tile, np.tile(scene.diffused, repeats)[: tile.core.rows, : tile.core.columns])

    def ours() -> Call:
        prepare()
        return lambda workers: _run_pass(source, scratch / "ours", workers)

    def dask(chunks: int | None) -> Call:
        prepare()
        return _dask(source, scratch / "dask.zarr", chunks)

    return Case(
        "engine, pass that does nothing",
        "Mpx/s",
        size**2 / 1e6,
        size**2 * 8,
        [
            Contestant("tilepipe run_pass", ours, ours=True, note="checksums and resume included"),
            Contestant("dask, map_overlap of depth 0", lambda: dask(None), note="chunks as stored"),
            Contestant("dask, same tiles", lambda: dask(TILE), note="chunks of 2048"),
        ],
        aim=60,
    )


def _run_pass(source: StateArray, folder: Path, workers: int) -> Any:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    target = StateArray(folder / "target.zarr", source.grid, "float32")
    pass_ = BoundPass("copy", _copy, _Copy(source, target), source.grid, 0, {"target": target})
    with open_executor("threads", workers) as executor:
        return run_pass(pass_, folder, executor, Silent())


def _dask(source: StateArray, path: Path, chunks: int | None) -> Call:
    import dask
    import dask.array as da

    def run(workers: int) -> Any:
        shutil.rmtree(path, ignore_errors=True)
        array = da.from_zarr(str(source.path), chunks=chunks)
        copied = array.map_overlap(lambda block: block, depth=0, boundary="none", dtype=np.float32)
        with dask.config.set(scheduler="threads", num_workers=workers):
            copied.to_zarr(str(path))

    return run
