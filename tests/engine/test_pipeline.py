"""What follows from the declaration of a pipeline: its plan, its tiling, the names of its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.scenes import write_raster
from tilepipe.engine.layers import TableLayer
from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pass, Pipeline, Setting
from tilepipe.engine.planning import plan_run
from tilepipe.engine.request import checked_request, setting_of_record
from tilepipe.pipelines import registry


def wide(context: object, tile: object) -> dict[str, object]:
    return {}


def setting(pipeline: Pipeline, **values: object) -> Setting:
    inputs = frozenset(item.name for item in pipeline.inputs)
    return Setting(pipeline.parameters(**values), (300, 200), 1.0, 128, inputs, {"grey": "single band"})


@pytest.mark.parametrize("name", registry.OWN)
def test_every_pipeline_can_be_planned_from_its_declaration_alone(name: str) -> None:
    pipeline = registry.pipeline(name)
    plan = plan_run(pipeline, setting(pipeline), RunOptions(workers=1))
    assert [item.name for item in plan.passes] == [item.name for item in pipeline.needed_passes(setting(pipeline))]
    assert all(item.memory > 0 for item in plan.passes)


def test_a_pass_that_is_needed_is_planned() -> None:
    streets = registry.pipeline("streets")
    names = {
        kind: [item.name for item in plan_run(streets, setting(streets, thresholds=kind), RunOptions()).passes]
        for kind in ("contrast", "histogram")
    }
    assert names == {
        "contrast": ["levels", "segment", "lines"],
        "histogram": ["levels", "segment", "responses", "lines"],
    }


def test_no_tile_cuts_a_cell() -> None:
    objects = registry.pipeline("objects")
    assert objects.grid(setting(objects, largest_leaf=16.0)).tile_shape == (128, 128)
    assert objects.grid(replace(setting(objects, largest_leaf=16.0), tile=100)).tile_shape == (96, 96)
    assert objects.grid(replace(setting(objects, largest_leaf=16.0), tile=3)).tile_shape == (16, 16)


@pytest.mark.parametrize("name", registry.OWN)
def test_the_record_of_a_run_gives_the_same_setting(name: str, tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", np.arange(600, dtype=np.float32).reshape(20, 30))
    pipeline = registry.pipeline(name)
    request = checked_request(pipeline, path, {}, None, None, None, RunOptions(tile=64))
    found = setting_of_record(pipeline, request.record(tmp_path / "run"))
    assert pipeline.needed_passes(found) == pipeline.needed_passes(request.setting)
    assert (found.shape, found.resolution, found.inputs) == ((20, 30), request.setting.resolution, frozenset())
    assert pipeline.grid(found).tile_shape == request.grid.tile_shape


def test_what_is_declared_twice_or_not_at_all_is_refused() -> None:
    one = Pass("a", wide, halo=0, bytes_per_pixel=1)  # type: ignore[arg-type]
    table = TableLayer("a", "Point", {}, "")
    for passes, layers, message in (
        ((one, one), (), "declares the pass 'a' twice"),
        ((one,), (table, table), "declares the layer 'a' twice"),
        ((), (), "declares no pass"),
        ((replace(one, halo=-1),), (), "has no halo"),
        ((Pass("a", wide, bytes_per_pixel=1),), (), "pass 'a' of pipeline 'x' has no halo"),  # type: ignore[arg-type]
        ((Pass("a", wide, halo=1),), (), "has no bytes_per_pixel"),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match=message):
            Pipeline(name="x", summary="", parameters=object, passes=passes, layers=layers, recipe=list)  # type: ignore[arg-type]
