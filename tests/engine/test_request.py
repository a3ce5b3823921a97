"""A run is resumed only if all that decides its tiles is the same: each such thing, by itself, is of its identity."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from tilepipe.engine import request as request_module
from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pipeline
from tilepipe.engine.request import Request, checked_request
from tilepipe.engine.unchanged import INPUT_FILES
from tilepipe.pipelines import registry

EDGES, STREETS = registry.pipeline("edges"), registry.pipeline("streets")


def write(path: Path, seed: int = 0, west: float = 500000.0) -> Path:
    """A raster of two bands of noise."""
    values = np.random.default_rng(seed).normal(100, 20, (2, 40, 50)).astype(np.float32)
    profile = {"driver": "GTiff", "dtype": "float32", "crs": None, "transform": from_origin(west, 5e6, 1, 1)}
    with rasterio.open(path, "w", width=50, height=40, count=2, **profile) as dataset:
        dataset.write(values)
    return path


def asked(path: Any, pipeline: Pipeline = EDGES, **named: Any) -> Request:
    """A request of a pipeline; what is not named is as always."""
    options = {key: named.pop(key) for key in tuple(named) if key in RunOptions.__dataclass_fields__}
    given = {"inputs": {}, "params": {}, "crs": "EPSG:32633", "band": 1} | named
    return checked_request(pipeline, path, options=RunOptions(**({"tile": 32} | options)), **given)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"band": 2},
        {"params": {"levels": 3}},
        {"crs": "EPSG:32632"},
        {"tile": 16},
        {"pipeline": STREETS},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_decides_the_tiles_is_of_the_identity(tmp_path: Path, change: dict[str, Any]) -> None:
    path = write(tmp_path / "a.tif")
    assert asked(path).identity() == asked(path).identity()
    assert asked(path, **change).identity() != asked(path).identity()


@pytest.mark.parametrize("change", [{"workers": 3}, {"executor": "processes"}, {"memory": 5 << 30}, {"format": "gpkg"}])
def test_how_a_run_works_is_not_of_the_identity(tmp_path: Path, change: dict[str, Any]) -> None:
    path = write(tmp_path / "a.tif")
    assert asked(path, **change).identity() == asked(path).identity()


def test_the_seed_counts_where_there_are_random_numbers(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif")
    for pipeline in (EDGES, STREETS, registry.pipeline("objects")):
        assert (asked(path, pipeline, seed=1).identity() != asked(path, pipeline).identity()) == pipeline.seeded


def newer(path: Path) -> None:
    write(path, seed=1)
    os.utime(path, (1e9, 1e9))


def other_name(path: Path) -> None:
    path.rename(path.with_name("b.tif"))


def elsewhere(path: Path) -> None:
    write(path, west=600000.0)


@pytest.mark.parametrize(("change", "entry"), [(newer, INPUT_FILES), (other_name, "sources"), (elsewhere, "raster")])
def test_an_input_is_of_the_identity(tmp_path: Path, change: Callable[[Path], None], entry: str) -> None:
    before = asked(write(tmp_path / "a.tif")).identity()
    change(tmp_path / "a.tif")
    (path,) = tmp_path.glob("?.tif")
    assert asked(path).identity()[entry] != before[entry]


def test_the_version_and_the_device_are_of_the_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.tif")
    usual = asked(path).identity()
    monkeypatch.setattr(request_module, "__version__", "0.0.0")
    assert asked(path).identity() != usual
    monkeypatch.undo()
    monkeypatch.setattr(RunOptions, "resolved_backend", lambda _: "cupy")
    assert asked(path).identity() == usual | {"backend": "cupy"}


FOREIGN = """
from dataclasses import replace
from tilepipe.pipelines import registry

def recipe(run):
    return [{}]

PIPELINE = replace(registry.pipeline("edges"), name="foreign", recipe=recipe)
"""


def foreign(folder: Path, number: int) -> Pipeline:
    """A pipeline of another package, with some code of its own."""
    path = folder / f"foreign{number}.py"
    path.write_text(FOREIGN.format(number))
    found: dict[str, Any] = {"__name__": f"foreign{number}"}
    exec(compile(path.read_text(), str(path), "exec"), found)
    pipeline: Pipeline = found["PIPELINE"]
    return pipeline


def test_the_code_of_a_foreign_pipeline_is_of_the_identity(tmp_path: Path) -> None:
    path, known = write(tmp_path / "a.tif"), foreign(tmp_path, 1)
    one, again, other = (asked(path, item).identity() for item in (known, known, foreign(tmp_path, 2)))
    assert one == again and one["code"] != other["code"]
    assert {**one, "code": ""} == {**other, "code": ""}
    # a tile function counts as much as the recipe
    first = replace(known.passes[0], function=foreign(tmp_path, 3).recipe)
    assert asked(path, replace(known, passes=(first, *known.passes[1:]))).identity()["code"] != one["code"]
    assert "code" not in asked(path).identity(), "the version says what tilepipe's own is"
