"""Where no number of workers is named there are as many as the cores, or as ``--memory`` holds."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from benchmarks.memory.contents import write_content
from tilepipe import InputError, RunOptions, objects
from tilepipe.engine import options as options_module
from tilepipe.engine.options import parse_memory
from tilepipe.engine.planning import Plan
from tilepipe.errors import MemoryLimitError
from tilepipe.io.files.record import RECORD
from tilepipe.pipelines.objects.pipeline import plan_objects

SIDE, TILE, CORES = 192, 64, 12
FINEST: dict[str, Any] = {
    "smallest_leaf": 0.5,
    "split_deviation": 0.01,
    "minimum_area": 0,
    "merge_rounds": 2,
    "draws": 4,
}


@pytest.fixture
def raster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Noise of nine tiles, and a machine of twelve cores."""
    monkeypatch.setattr(options_module, "default_workers", lambda: CORES)
    return write_content(tmp_path, "white noise", SIDE, heights=True)


def plan(
    raster: Path,
    memory: int,
    workers: int | None = None,
    executor: str = "threads",
    params: dict[str, Any] | None = None,
) -> Plan:
    options = RunOptions(tile=TILE, workers=workers, memory=memory, executor=executor)
    return plan_objects(raster, params=params, options=options)


def recorded(run: Path) -> int:
    return int(tomllib.loads((run / RECORD).read_text())["options"]["workers"])


@pytest.mark.parametrize("executor", ["threads", "processes"])
def test_there_are_as_many_workers_as_memory_holds(raster: Path, executor: str) -> None:
    for workers in (1, 3, 8):
        limit = plan(raster, 1 << 40, workers, executor).memory
        found = plan(raster, limit, executor=executor)
        assert (found.workers, found.memory) == (workers, limit)
        assert (
            f"{workers} worker{'s' * (workers > 1)} of 9 that the cores allow: --memory holds no more" in found.text()
        )
        assert plan(raster, limit - 1, executor=executor).workers == max(1, workers - 1)
    assert plan(raster, 1 << 40).workers == 9
    assert "the cores allow" not in plan(raster, 1 << 40).text() + plan(raster, limit, 1).text()


def test_a_run_has_and_records_the_workers_of_its_plan(raster: Path, tmp_path: Path) -> None:
    raster = write_content(tmp_path, "one region", SIDE, heights=True)
    limit = plan(raster, 1 << 40, 3).memory
    objects(raster, tmp_path / "three", options=RunOptions(tile=TILE, memory=limit))
    assert recorded(tmp_path / "three") == 3
    objects(raster, tmp_path / "all", options=RunOptions(tile=TILE))
    assert recorded(tmp_path / "all") == CORES
    names = ("regions.tif", "objects.parquet", "boundaries.parquet")
    assert all((tmp_path / "three" / name).read_bytes() == (tmp_path / "all" / name).read_bytes() for name in names)


def test_workers_that_were_named_are_refused_where_memory_does_not_hold_them(raster: Path, tmp_path: Path) -> None:
    limit = plan(raster, 1 << 40, 3).memory
    with pytest.raises(InputError, match="larger --memory or a smaller --tile than 64, or fewer workers than 9"):
        objects(raster, tmp_path / "run", options=RunOptions(tile=TILE, workers=CORES, memory=limit))
    assert not (tmp_path / "run").exists()


def test_a_run_that_stops_for_memory_is_done_with_what_it_says(raster: Path, tmp_path: Path) -> None:
    limit, told = plan(raster, 1 << 40, 3, params=FINEST).memory, 0
    options = RunOptions(tile=TILE, memory=limit)
    # each pass that leaves more than the memory holds says so
    for _ in range(3):
        try:
            objects(raster, tmp_path / "run", params=FINEST, options=options)
            break
        except MemoryLimitError as stopped:
            named = re.search(r"such as --memory (\S+) --workers (\d+)", str(stopped))
            assert named and parse_memory(named[1]) > options.memory
            options, told = RunOptions(tile=TILE, memory=parse_memory(named[1]), workers=int(named[2])), told + 1
    assert told and options.workers == 3 and recorded(tmp_path / "run") == 3


def test_fewer_workers_are_named_where_they_leave_room(raster: Path, tmp_path: Path) -> None:
    limit = plan(raster, 1 << 40, 9).memory
    found = plan(raster, limit)
    free = limit - found.with_workers(1).memory_with(0)
    assert found.workers_within(free) == 1 and found.workers_within(free + 1) == 0
    assert found.workers_within(0) == 9
