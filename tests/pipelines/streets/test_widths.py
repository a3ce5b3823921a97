"""Widths of streets do not depend on the noise of the raster."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.scenes import write_raster
from tilepipe.engine.options import RunOptions
from tilepipe.pipelines.streets.pipeline import streets

PIXEL, WIDTH = 0.5, 10.0


def scene(degrees: float, noise: float) -> NDArray[np.float32]:
    """A street of ten metres, 100 grey levels darker than its sides; border pixels by their share of it."""
    row, column = (np.arange(4 * side) / 4 + 0.125 for side in (200, 320))
    across = (row[:, None] - 100) * np.cos(np.radians(degrees)) - (column - 160) * np.sin(np.radians(degrees))
    share = (abs(across) < WIDTH / PIXEL / 2).reshape(200, 4, 320, 4).mean((1, 3))
    return (150 - 100 * share + np.random.default_rng(5).normal(0, noise, share.shape)).astype(np.float32)


@pytest.mark.parametrize(("degrees", "noise"), [(0, 0), (0, 2), (0, 4), (0, 10), (23, 0), (23, 4), (23, 10)])
def test_a_street_is_as_wide_as_it_is(tmp_path: Path, degrees: float, noise: float) -> None:
    raster = write_raster(tmp_path / "intensity.tif", scene(degrees, noise), pixel=PIXEL)
    streets(raster, out=tmp_path / "run", options=RunOptions(tile=400, workers=1))
    lines = geopandas.read_parquet(tmp_path / "run" / "centerlines.parquet")
    lines = lines[lines.length_m > 20]
    assert lines.length_m.sum() > 80
    for column in ("mean_width_m", "start_width_m", "end_width_m"):
        tolerance = 0.2 if column == "mean_width_m" else 0.6
        assert abs(np.average(lines[column], weights=lines.length_m) - WIDTH) <= tolerance
    if noise <= 4:
        axis = geopandas.read_parquet(tmp_path / "run" / "skeleton.parquet")
        axis = axis[axis.length_m > 20]
        assert abs(np.average(axis.mean_width_m, weights=axis.length_m) - WIDTH) <= 0.4
