"""The small runs that the simulator disturbs: the pipelines of tilepipe and one of others, on a few tiles."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from tests.scenes import SMALL, band, draw, write_raster
from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pipeline
from tilepipe.engine.work import run_pipeline
from tilepipe.pipelines import registry

_SPOTS = Path(__file__).resolve().parents[2] / "docs" / "extend" / "bright_spots" / "bright_spots.py"

SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "bright_spots": ({"threshold": 100.0}, {"threshold": 150.0}),
    "streets": (SMALL, SMALL | {"minimum_length": 12}),
    "objects": ({"largest_leaf": 8.0}, {"largest_leaf": 16.0}),
    "edges": ({"levels": 2}, {"levels": 3}),
}
"""Parameters of each pipeline, and others whose layers differ."""


@cache
def pipeline(name: str) -> Pipeline:
    """A pipeline by name; that of others stands in the documentation."""
    if name != "bright_spots":
        return registry.pipeline(name)
    spec = importlib.util.spec_from_file_location(name, _SPOTS)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module.PIPELINE  # type: ignore[no-any-return]


def write_scene(folder: Path) -> Path:
    """A raster of a crossing of two streets."""
    shape = (48, 64)
    mask = band(shape, (10, -5), (30, 70), 8) | band(shape, (-5, 30), (60, 36), 8)
    return write_raster(folder / "scene.tif", draw(shape, mask))


def run(name: str, raster: Path, folder: Path, *, other: bool = False, overwrite: bool = False) -> None:
    """Run a pipeline on the scene, with its parameters or the others, in several tiles."""
    options = RunOptions(tile=32, workers=1, overwrite=overwrite)
    run_pipeline(pipeline(name), raster, folder, params=SCENES[name][other], options=options)


Runner = Callable[[Path], None]
"""Runs something into a folder."""
