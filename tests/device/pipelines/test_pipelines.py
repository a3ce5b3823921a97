"""Whole runs on the device publish the bytes of runs on the CPU."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import tilepipe
from tests.scenes import band, draw, write_raster
from tilepipe.engine.options import RunOptions

SHAPE = (30, 44)


def layers(out: Path) -> dict[str, bytes]:
    """Published layers and tables by name."""
    return {path.name: path.read_bytes() for path in sorted(out.iterdir()) if path.suffix in (".tif", ".parquet")}


def both(command: str, raster: Path, out: Path, params: dict[str, object], tile: int) -> None:
    for backend in ("numpy", "cupy"):
        options = RunOptions(tile=tile, workers=1, backend=backend)
        getattr(tilepipe, command)(raster, out=out / backend, params=params, options=options)
    expected, found = layers(out / "numpy"), layers(out / "cupy")
    assert expected.keys() == found.keys()
    assert [name for name in expected if expected[name] != found[name]] == []
    assert "cupy" in (out / "cupy" / "run.toml").read_text()


def test_streets(tmp_path: Path) -> None:
    grey = draw(SHAPE, band(SHAPE, (-5, 8), (40, 40), 6), 1)
    grey[4:6, 30:33] = np.nan
    raster = write_raster(tmp_path / "scene.tif", grey)
    params = {
        "diffusion_steps": 2, "minimum_size": 20.0, "minimum_contour": 10.0, "maximum_width": 8.0,
        "minimum_elongation": 1.0, "minimum_length": 4.0, "line_width": 6.0, "minimum_street_width": 3.0,
        "thresholds": "histogram",
    }  # fmt: skip
    both("streets", raster, tmp_path, params, 32)


def test_objects(tmp_path: Path) -> None:
    rows, columns = np.mgrid[:48, :64]
    rng = np.random.default_rng(2)
    heights = rows * 0.02 + ((rows % 24 > 6) & (columns % 32 > 10)) * 5.0 + rng.normal(0, 0.05, rows.shape)
    heights[30:33, 3:7] = np.nan
    raster = write_raster(tmp_path / "scene.tif", heights.astype(np.float32), pixel=0.5)
    params = {"draws": 12, "burn_in": 6, "thinning": 2, "largest_building": 12.0, "minimum_area": 2.0}
    both("objects", raster, tmp_path, params, 32)


def test_edges(tmp_path: Path) -> None:
    rows, columns = np.mgrid[:26, :30]
    rng = np.random.default_rng(3)
    grey = np.where((rows > 8) & (columns > 11) & (rows + columns < 44), 150.0, 60.0) + rng.normal(0, 5, rows.shape)
    raster = write_raster(tmp_path / "scene.tif", grey.astype(np.float32))
    both("edges", raster, tmp_path, {"rounds": 3, "levels": 2, "minimum_length": 2.0}, 20)
