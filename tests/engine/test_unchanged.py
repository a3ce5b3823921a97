"""A run whose inputs change never publishes a mixture, nor resumes with tiles of what is no longer there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel

from tests.scenes import write_raster
from tilepipe.engine.layers import RasterLayer
from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pass, Pipeline, State
from tilepipe.engine.tiles.state import write_state
from tilepipe.engine.work import Work, run_pipeline
from tilepipe.errors import InputError
from tilepipe.io.files.identity import ChangedInputError
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile

SIDE, TILE = 400, 100
at_tile: dict[int, Callable[[], Any]] = {}
"""What happens when a tile is begun."""
begun: list[int] = []


def keep(context: tuple[Any, Any], tile: Tile) -> Facts:
    raster, state = context
    begun.append(tile.number)
    at_tile.get(tile.number, lambda: None)()
    return write_state({"kept": state}, tile, {"kept": np.nan_to_num(raster.read(tile.core)).astype(np.uint8)})


KEEP = Pass("keep", keep, halo=0, bytes_per_pixel=8, writes={"kept": State("uint8")})


def recipe(run: Work) -> list[Path]:
    state = run.state("kept")
    run.over_tiles(KEEP, (run.raster, state))
    at_tile.get(-1, lambda: None)()
    return [run.write_raster("kept.tif", state.read)]


class Nothing(BaseModel):
    """No parameters."""


PIPELINE = Pipeline(
    name="keep",
    summary="Keeps a raster as it is.",
    parameters=Nothing,
    passes=(KEEP,),
    layers=(RasterLayer("kept.tif", "uint8", 0, "as it was"),),
    recipe=recipe,
)


@pytest.fixture(autouse=True)
def _nothing_happens():
    at_tile.clear()
    begun.clear()


def values(number: int) -> NDArray[np.uint8]:
    return np.random.default_rng(number).integers(1, 255, (SIDE, SIDE), dtype=np.uint8)


def run(raster: Any, out: Path, *, overwrite: bool = False, executor: str = "threads") -> NDArray[np.uint8]:
    options = RunOptions(tile=TILE, workers=1, executor=executor, overwrite=overwrite, backend="numpy")
    run_pipeline(PIPELINE, raster, out, options=options, crs="EPSG:32633" if isinstance(raster, xr.DataArray) else None)
    with rasterio.open(out / "kept.tif") as layer:
        return layer.read(1)


def replaced(path: Path, number: int) -> None:
    """Another file in its place, as a copy makes it."""
    write_raster(path.with_suffix(".new.tif"), values(number))
    os.replace(path.with_suffix(".new.tif"), path)


def test_a_file_that_is_replaced_half_way_is_named_and_nothing_is_published(tmp_path):
    path = write_raster(tmp_path / "a.tif", values(1))
    at_tile[7] = lambda: replaced(path, 2)
    with pytest.raises(ChangedInputError, match=r"a\.tif: has changed since the run began; nothing is published"):
        run(path, tmp_path / "run")
    assert begun == list(range(8))
    assert not (tmp_path / "run" / "kept.tif").exists()
    at_tile.clear()
    with pytest.raises(InputError, match=r"holds an unfinished run, but .*a\.tif has changed since; start anew with"):
        run(path, tmp_path / "run")
    assert np.array_equal(run(path, tmp_path / "run", overwrite=True), values(2))


def test_the_file_is_put_back_and_the_run_goes_on(tmp_path):
    path = write_raster(tmp_path / "a.tif", values(1))
    other = tmp_path / "aside.tif"

    def swap() -> None:
        path.rename(other)
        write_raster(path, values(2))

    at_tile[7] = swap
    with pytest.raises(ChangedInputError):
        run(path, tmp_path / "run")
    os.replace(other, path)
    at_tile.clear(), begun.clear()
    assert np.array_equal(run(path, tmp_path / "run"), values(1))
    assert begun == list(range(7, 16))


def test_a_file_that_changes_after_the_last_tile_is_noticed_before_publishing(tmp_path):
    path = write_raster(tmp_path / "a.tif", values(1))
    at_tile[-1] = lambda: replaced(path, 2)
    with pytest.raises(ChangedInputError):
        run(path, tmp_path / "run")
    assert not (tmp_path / "run" / "kept.tif").exists()


def stop() -> None:
    raise KeyboardInterrupt


def test_a_touched_file_is_read_again_and_the_finished_tiles_are_kept(tmp_path):
    path = write_raster(tmp_path / "a.tif", values(1))
    at_tile[9] = stop
    with pytest.raises(KeyboardInterrupt):
        run(path, tmp_path / "run")
    os.utime(path)
    at_tile.clear(), begun.clear()
    assert np.array_equal(run(path, tmp_path / "run"), values(1))
    assert begun == list(range(9, 16))


def test_a_file_that_is_touched_half_way_stops_the_run_and_the_same_command_goes_on(tmp_path):
    path = write_raster(tmp_path / "a.tif", values(1))
    at_tile[9] = lambda: os.utime(path)
    with pytest.raises(ChangedInputError, match="run the same command again"):
        run(path, tmp_path / "run")
    at_tile.clear(), begun.clear()
    assert np.array_equal(run(path, tmp_path / "run"), values(1))
    assert begun == list(range(9, 16))


@pytest.mark.parametrize("keeps_time", [False, True])
def test_a_change_between_the_samples_is_found_where_tiles_have_read(tmp_path, keeps_time):
    """Same size and samples: only reading tells that this is no touch."""
    path = write_raster(tmp_path / "a.tif", values(1))
    at_tile[9] = stop
    with pytest.raises(KeyboardInterrupt):
        run(path, tmp_path / "run")
    data = bytearray(path.read_bytes())
    place = len(data) // 8
    data[place : place + 9] = bytes(9)
    times = path.stat()
    path.write_bytes(data)
    if keeps_time:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    at_tile.clear()
    with pytest.raises(InputError, match=r"a\.tif has changed since; start anew with --overwrite"):
        run(path, tmp_path / "run")


def test_one_file_of_a_mosaic(tmp_path):
    left, right = write_raster(tmp_path / "a.tif", values(1)), tmp_path / "b.tif"
    write_raster(right, values(2), origin=(500000.0 + SIDE, 5000000.0))
    at_tile[3] = lambda: right.unlink()
    with pytest.raises(ChangedInputError, match=r"b\.tif: is gone since the run began"):
        run([left, right], tmp_path / "run")


def test_a_worker_process_finds_another_file(tmp_path):
    """The file is replaced when the worker has not seen it yet."""
    path = write_raster(tmp_path / "a.tif", values(1))
    with pytest.MonkeyPatch.context() as patch:
        from tilepipe.engine import run as run_module

        begin = run_module.begin
        patch.setattr(run_module, "begin", lambda *given, **more: (replaced(path, 2), begin(*given, **more))[1])
        with pytest.raises(ChangedInputError, match=r"a\.tif: has changed since the run began"):
            run(path, tmp_path / "run", executor="processes")


def test_an_array_that_is_changed_meanwhile(tmp_path):
    centres = {"y": 5_820_000.0 - np.arange(SIDE), "x": 392_000.0 + np.arange(SIDE)}
    array = xr.DataArray(values(1), centres, ("y", "x"))
    before = array.copy(deep=True)
    at_tile[9] = lambda: array.values.__setitem__(slice(None), 7)
    with pytest.raises(ChangedInputError, match="the array: has changed"):
        run(array, tmp_path / "run")
    at_tile.clear()
    with pytest.raises(InputError, match="the array has changed since"):
        run(array, tmp_path / "run")
    # tiles of what it was for a while are not taken for tiles of what it is
    with pytest.raises(InputError, match="the array has changed since"):
        run(before, tmp_path / "run")


def test_what_lies_elsewhere_is_in_the_plan_and_in_the_record(tmp_path):
    from tests.io.rasters.test_vrt import RAW, vrt
    from tilepipe.engine.request import checked_request
    from tilepipe.io.files.record import read_record

    (tmp_path / "secret").write_bytes(bytes(range(63)))
    path = vrt(tmp_path / "raw.vrt", RAW.format("secret"))
    request = checked_request(PIPELINE, path, {}, None, None, None, RunOptions(tile=TILE, workers=1))
    named = f"{tmp_path / 'secret'} (raw pixels)"
    assert f"\nreads {named}" in request.plan().text()
    run(path, tmp_path / "run")
    assert read_record(tmp_path / "run" / "run.toml")["elsewhere"] == [named]
