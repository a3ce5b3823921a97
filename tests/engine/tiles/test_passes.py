"""A pass runs every tile once, resumes from verified tiles only, and names the tiles that failed."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Silent
from tilepipe.engine.run import open_run
from tilepipe.engine.tiles.executors import open_executor
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.errors import InputError, TileError
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe_kernels.core.cache import tell_compiling

GRID = TileGrid((23, 31), (10, 9))


@dataclass(frozen=True)
class Context:
    source: StateArray
    result: StateArray
    failing: tuple[int, ...] = ()


def double(context: Context, tile: Tile) -> Facts:
    """Twice the source, and a note that the tile was worked on."""
    with open(context.result.path.parent / "worked", "a") as file:
        file.write(f"{tile.number}\n")
    if tile.number in context.failing:
        raise RuntimeError("no luck here")
    values = 2 * context.source.read(tile.padded)[tile.core_in_padded.slices]
    return write_state({"result": context.result}, tile, {"result": values})


@pytest.fixture
def context(tmp_path: Path) -> Context:
    source = StateArray(tmp_path / "source.zarr", GRID, "int32")
    source.create()
    values = np.arange(23 * 31).reshape(23, 31)
    for tile in GRID.tiles():
        source.write(tile, values[tile.core.slices])
    return Context(source, StateArray(tmp_path / "result.zarr", GRID, "int32"))


def doubling(context: Context) -> BoundPass:
    return BoundPass("double", double, context, GRID, 2, {"result": context.result})


def worked(context: Context) -> list[int]:
    path = context.result.path.parent / "worked"
    return sorted(int(line) for line in path.read_text().split()) if path.exists() else []


@pytest.mark.parametrize(("kind", "workers"), [("threads", 1), ("threads", 3), ("processes", 2)])
def test_executors_give_the_same_array(context, tmp_path, kind, workers):
    with open_executor(kind, workers) as executor:
        run_pass(doubling(context), tmp_path, executor, Silent())
    whole = context.result.read(GRID.tile(0).core.padded(100, GRID.shape))
    np.testing.assert_array_equal(whole, 2 * np.arange(23 * 31).reshape(23, 31))
    assert worked(context) == list(range(len(GRID)))


def test_resume_runs_only_what_is_missing_or_damaged(context, tmp_path):
    with open_executor("threads", 1) as executor:
        ledger = run_pass(doubling(context), tmp_path, executor, Silent())
        (tmp_path / "worked").unlink()
        run_pass(doubling(context), tmp_path, executor, Silent())
        assert worked(context) == []
        ledger.forget(GRID.tile(2).name)
        damaged = ledger.path(GRID.tile(4).name)
        damaged.write_bytes(damaged.read_bytes()[:-3])
        context.result.write(GRID.tile(7), np.zeros(GRID.tile(7).core.shape, np.int32))
        run_pass(doubling(context), tmp_path, executor, Silent())
    assert worked(context) == [2, 4, 7]
    whole = context.result.read(GRID.tile(0).core.padded(100, GRID.shape))
    np.testing.assert_array_equal(whole, 2 * np.arange(23 * 31).reshape(23, 31))


def test_failed_tiles_are_named_and_the_others_kept(context, tmp_path):
    failing = Context(context.source, context.result, failing=(3, 5))
    with open_executor("threads", 2) as executor:
        with pytest.raises(TileError, match=r"tile r0000c0003 .*and 1 more tiles of 12 failed: RuntimeError: no luck"):
            run_pass(doubling(failing), tmp_path, executor, Silent())
        (tmp_path / "worked").unlink()
        run_pass(doubling(context), tmp_path, executor, Silent())
    assert worked(context) == [3, 5]


def compile_something(_: int) -> None:
    tell_compiling()


@pytest.mark.parametrize(("kind", "workers"), [("threads", 1), ("threads", 2), ("processes", 2)])
def test_what_workers_compile_is_told_to_the_progress_of_the_run(tmp_path, kind, workers):
    heard = threading.Event()

    class Progress(Silent):
        def compiling(self) -> None:
            heard.set()

    options = RunOptions(executor=kind, workers=workers)
    with open_run(tmp_path / "run", {}, {}, options, Progress()) as run:
        assert [error for _, _, error in run.executor.run(compile_something, [1])] == [None]
        assert heard.wait(10)


def test_distributed_cluster(context, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None, protocol="tcp"
        ) as cluster,
        open_executor(cluster.scheduler_address, 1) as executor,
    ):
        run_pass(doubling(context), tmp_path, executor, Silent())
    assert worked(context) == list(range(len(GRID)))


@pytest.mark.parametrize("kind", ["fibers", "tcp://127.0.0.1:1"])
def test_unknown_executors_are_refused(kind):
    with pytest.raises(InputError, match=r"unknown|answers"), open_executor(kind, 1):
        pass


def test_a_core_of_the_wrong_shape_or_kind_is_refused(context):
    context.result.create()
    with pytest.raises(ValueError, match="core"):
        context.result.write(GRID.tile(0), np.zeros((3, 3), np.int32))
    with pytest.raises(ValueError, match="writes float64 into result, which holds int32"):
        context.result.write(GRID.tile(0), np.zeros(GRID.tile(0).core.shape))


def test_an_array_made_anew_under_the_same_name_is_opened_anew(tmp_path):
    import shutil

    for tile in (10, 7):
        array = StateArray(tmp_path / "a.zarr", TileGrid((20, 20), (tile, tile)), "int32")
        array.create()
        array.write(array.grid.tile(1), np.full(array.grid.tile(1).core.shape, tile))
        assert array.read(array.grid.tile(1).core).min() == tile
        assert len(list((tmp_path / "a.zarr" / "c").rglob("*"))) == 2
        shutil.rmtree(array.path)


@pytest.mark.parametrize(
    ("entry", "value"),
    [("codecs", [{"name": "bytes", "configuration": {"endian": "big"}}]), ("fill_value", 3), ("shape", [20, 21])],
)
def test_an_array_of_another_description_is_made_anew(tmp_path, entry, value):
    array = StateArray(tmp_path / "a.zarr", TileGrid((20, 20), (10, 10)), "int32")
    array.create()
    created = (array.path / "zarr.json").read_bytes()
    (array.path / "zarr.json").write_text(json.dumps(json.loads(created) | {entry: value}))
    array.create()
    assert (array.path / "zarr.json").read_bytes() == created
