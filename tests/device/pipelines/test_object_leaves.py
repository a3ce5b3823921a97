"""The first pass of `objects` on the device gives the very facts and labels of the CPU."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.parameters import object_parameters
from tests.scenes import write_raster
from tilepipe.engine.pipeline import Setting
from tilepipe.engine.tiles.state import StateArray
from tilepipe.io.rasters.raster import open_raster
from tilepipe.pipelines.objects.pass_leaves import LeafContext, find_leaves, halo
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.core.arrays import Backend, on_device, to_host


def houses(side: int = 32) -> NDArray[np.float32]:
    """Two houses on a slope, with noise, voids and what is no height."""
    random = np.random.default_rng(3)
    heights = 2 + 0.05 * np.arange(side) + random.normal(0, 0.05, (side, side))
    heights[4:14, 6:15] = 9
    heights[18:26, 10:28] = 12
    heights[random.random(heights.shape) < 0.03] = np.nan
    heights[28:30, 2:5] = 1e9
    return heights.astype(np.float32)


@pytest.mark.parametrize("buildings", [True, False])
def test_facts_and_labels_are_those_of_the_cpu(tmp_path: Path, buildings: bool) -> None:
    raster = open_raster([write_raster(tmp_path / "dsm.tif", houses())])
    parameters = object_parameters({"largest_building": 6.0, "largest_leaf": 8.0, "buildings": buildings})
    found: dict[Backend, tuple[Facts, NDArray[np.int32]]] = {}
    for backend in ("numpy", "cupy"):
        grid = TileGrid(raster.shape, (16, 16))
        labels = StateArray(tmp_path / f"{backend}.zarr", grid, "int32")
        labels.create()
        context = LeafContext(raster, parameters, grid, labels, backend)
        tile = grid.tile(3, halo(Setting(parameters, raster.shape, 1.0, 16)))
        found[backend] = find_leaves(context, tile), labels.read(tile.core)
    (here, labels_here), (there, labels_there) = found["numpy"], found["cupy"]
    np.testing.assert_array_equal(labels_here, labels_there)
    assert here.keys() == there.keys() and labels_here.max() > 4
    assert ("above" in here) == buildings
    assert on_device(*(there[name] for name in ("first", "count", "total", "edges", "lowest", "absurd", "label:top")))
    for name, values in here.items():
        other = to_host(there[name])
        assert other.dtype == values.dtype, name
        np.testing.assert_array_equal(other, values, err_msg=name)
