"""The passes of `edges` on the device give the very facts, levels and lines of the CPU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.parameters import edge_parameters
from tests.scenes import write_raster
from tilepipe.engine.pipeline import Setting
from tilepipe.engine.tiles.state import StateArray
from tilepipe.pipelines.edges.pass_bands import Photograph, open_photograph
from tilepipe.pipelines.edges.pass_fields import NODATA, FieldContext, find_fields, halo
from tilepipe.pipelines.edges.pass_levels import CountContext, LevelScale, count_greys
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.core.arrays import Backend, on_device, to_host
from tilepipe_kernels.nevatia_babu import elements

SHAPE, TILE = (20, 22), (12, 12)


@pytest.fixture
def photograph(tmp_path: Path) -> Photograph:
    """A street across bright ground, with noise and a hole."""
    random = np.random.default_rng(5)
    grey = np.full(SHAPE, 180.0)
    grey[8:13] = 60
    grey[:, 15:] -= 50
    grey += random.normal(0, 15, SHAPE)
    grey[2:4, 3:6] = np.nan
    path = write_raster(tmp_path / "photo.tif", np.round(grey).astype(np.float32))
    return open_photograph([path], crs=None, band=None, grey="automatic")


def assert_same(there: Facts, here: Facts) -> None:
    assert here.keys() == there.keys()
    for name, values in here.items():
        other = to_host(there[name])
        assert other.dtype == values.dtype, name
        np.testing.assert_array_equal(other, values, err_msg=name)


def test_counts_are_those_of_the_cpu(photograph: Photograph) -> None:
    context = CountContext(photograph, True)
    tile = TileGrid(SHAPE, TILE).tile(3, elements.halo())
    here, there = count_greys(context, tile), count_greys(replace(context, backend="cupy"), tile)
    assert on_device(*there.values()) and here["edge:counts"].sum() > 0
    assert_same(there, here)


@pytest.mark.parametrize(
    "choice",
    [
        {"optimiser": "parallel"},
        {"optimiser": "icm", "nevatia_babu": False},
        {"scheme": "integrated", "optimiser": "messages", "nevatia_babu": False},
    ],
    ids=lambda choice: "-".join(map(str, choice.values())),
)
def test_facts_and_fields_are_those_of_the_cpu(photograph: Photograph, tmp_path: Path, choice: dict[str, Any]) -> None:
    parameters = edge_parameters({"rounds": 2, "levels": 3, "minimum_length": 1.0} | choice)
    scale = LevelScale(20.0, 220.0, (40.0, 120.0, 200.0), 0.4)
    found: dict[Backend, tuple[Facts, NDArray[np.uint8], NDArray[np.uint8]]] = {}
    for backend in ("numpy", "cupy"):
        grid = TileGrid(SHAPE, TILE)
        levels, lines = (StateArray(tmp_path / f"{name}-{backend}", grid, "uint8", NODATA) for name in ("x", "lines"))
        levels.create()
        lines.create()
        context = FieldContext(photograph, scale, parameters, levels, lines, 5.0, 0, backend)
        tile = grid.tile(3, halo(Setting(parameters, SHAPE, 1.0, TILE[0])))
        found[backend] = find_fields(context, tile), levels.read(tile.core), lines.read(tile.core)
    here, there = found["numpy"], found["cupy"]
    assert_same(there[0], here[0])
    assert len(here[0]["contrast"]) > 0
    for mine, theirs in zip(there[1:], here[1:], strict=True):
        np.testing.assert_array_equal(mine, theirs)
