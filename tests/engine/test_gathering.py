"""What reconciliations gather is held against ``--memory`` once it is counted, whatever a raster holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from numpy.typing import NDArray

from benchmarks.memory.contents import CONTENTS, write_content
from tilepipe import InputError, RunOptions, objects
from tilepipe.engine.gathering import Gathering, most_gathered
from tilepipe.engine.options import format_memory, parse_memory
from tilepipe.engine.pipeline import Pass, Pipeline, amount
from tilepipe.engine.progress import Silent
from tilepipe.engine.request import plan_pipeline
from tilepipe.engine.run_folder import status
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import run_pipeline
from tilepipe.errors import MemoryLimitError
from tilepipe.io.files.record import STATE
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe.pipelines import registry
from tilepipe.pipelines.objects import tables
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.polygons import PolygonRings

SIDE, TILE = 192, 128
FINEST: dict[str, dict[str, Any]] = {
    "streets": {"diffusion_steps": 0, "minimum_size": 0, "minimum_contour": 0, "minimum_elongation": 0, "void_reach": 0}
    | {"closing_radius": 0, "opening_radius": 0, "speck_size": 0, "line_width": 2, "minimum_street_width": 1}
    | {"maximum_width": 8, "separation": 0.5, "minimum_length": 0, "minimum_branch": 0, "maximum_gap": 0},
    "objects": {"smallest_leaf": 0.5, "split_deviation": 0.01, "minimum_area": 0, "merge_rounds": 2, "draws": 4}
    | {"largest_building": 8},
    "edges": {"levels": 2, "noise": 0.05, "smoothness": 0, "rounds": 4, "minimum_length": 0, "edge_share": 1}
    | {"minimum_edge_length": 0},
}
"""Parameters that leave as many regions, squares and lines as there can be."""


class Finished(Silent):
    """Remembers how many tiles of each pass were finished when it began."""

    def __init__(self) -> None:
        self.before: dict[str, tuple[int, int]] = {}

    def start(self, stage: str, total: int, done: int = 0) -> None:
        self.before[stage] = done, total


def layers(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".tif", ".parquet")}


def noise(folder: Path, name: str) -> Path:
    return write_content(folder, "white noise", SIDE, heights=name == "objects")


@pytest.mark.parametrize(("name", "stopped"), [("objects", "leaves"), ("edges", "fields"), ("streets", "segment")])
def test_a_run_that_would_exceed_its_memory_stops_and_goes_on_with_more(
    tmp_path: Path, name: str, stopped: str
) -> None:
    pipeline, raster, params = registry.pipeline(name), noise(tmp_path, name), FINEST[name]
    usual = plan_pipeline(pipeline, [raster], params=params, options=RunOptions(tile=TILE, workers=1)).memory
    with pytest.raises(MemoryLimitError) as refusal:
        run_pipeline(
            pipeline, [raster], tmp_path / "run", params=params, options=RunOptions(tile=TILE, workers=1, memory=usual)
        )
    text = str(refusal.value)
    assert re.search(rf"pass {stopped} has found [\d,]+ \w+", text) and "\n" not in text
    assert [path.name for path in (tmp_path / "run").iterdir()] == [STATE]
    assert status(tmp_path / "run")["passes"][stopped] == 4
    needed = re.search(r"needs about ([\d.]+ \w+)", text)
    assert needed and parse_memory(needed[1]) >= usual
    # the state is that of any memory
    seen = Finished()
    more = RunOptions(tile=TILE, workers=1, memory=8 << 30)
    run_pipeline(pipeline, [raster], tmp_path / "run", params=params, options=more, progress=seen)
    assert seen.before[stopped] == (4, 4)
    run_pipeline(pipeline, [raster], tmp_path / "whole", params=params, options=more)
    assert layers(tmp_path / "run") == layers(tmp_path / "whole")


@pytest.mark.parametrize("name", registry.OWN)
@pytest.mark.parametrize("content", CONTENTS)
def test_no_content_has_more_than_the_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: str
) -> None:
    counted: list[str] = []

    def count(self: Gathering, declared: Pass, ledger: Ledger) -> None:
        rows, setting = ledger.rows(), self.setting
        held = sum(rows[item.rows] * amount(item.bytes_per_row, setting) for item in declared.gathers)
        assert held <= most_gathered(declared, setting)
        counted.append(declared.name)

    monkeypatch.setattr(Gathering, "count", count)
    pipeline: Pipeline = registry.pipeline(name)
    raster = write_content(tmp_path, content, 96, heights=name == "objects")
    options = RunOptions(tile=64, workers=1)
    try:
        run_pipeline(pipeline, [raster], tmp_path / "run", params=FINEST[name], options=options)
    except InputError as refused:
        assert "nodata" in str(refused) or "single value" in str(refused) or "fewer" in str(refused)  # noqa: PT017
    else:
        assert {item.name for item in pipeline.passes if item.gathers} <= set(counted)


def test_what_is_gathered_is_among_the_facts_of_its_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def count(self: Gathering, declared: Pass, ledger: Ledger) -> None:
        assert {item.rows for item in declared.gathers} <= set(ledger.rows())

    monkeypatch.setattr(Gathering, "count", count)
    for name in registry.OWN:
        options = RunOptions(tile=TILE, workers=1)
        run_pipeline(
            registry.pipeline(name), [noise(tmp_path, name)], tmp_path / name, params=FINEST[name], options=options
        )


def test_a_plan_says_what_is_usual_and_what_there_can_be_at_most(tmp_path: Path) -> None:
    plan = plan_pipeline(registry.pipeline("objects"), [noise(tmp_path, "objects")], params=FINEST["objects"])
    assert plan.memory < plan.most_memory
    assert f"at most {format_memory(plan.most_memory)} whatever the raster holds" in plan.text()


def test_polygons_are_the_same_however_few_are_objects_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once: list[int] = []

    def polygons(rings: PolygonRings, arcs: Arcs, transform: Sequence[float]) -> tuple[NDArray[Any], NDArray[Any]]:
        ids, geometries = region_polygons(rings, arcs, transform)
        at_once.append(len(ids))
        return ids, geometries

    monkeypatch.setattr(tables, "region_polygons", polygons)
    raster, options = noise(tmp_path, "objects"), RunOptions(tile=TILE, workers=1)
    objects(raster, tmp_path / "many", options=options)
    (all_regions,) = at_once
    monkeypatch.setattr(tables, "_POLYGONS_AT_ONCE", 5)
    objects(raster, tmp_path / "few", options=options)
    assert at_once[1:] == [5] * (all_regions // 5) + [all_regions % 5] * (all_regions % 5 > 0)
    assert layers(tmp_path / "few") == layers(tmp_path / "many")
