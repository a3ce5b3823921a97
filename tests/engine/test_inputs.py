"""Further inputs of several bands: which one is used is chosen, kept and told by their own option."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

import tilepipe
from tilepipe.cli import app
from tilepipe.engine.options import RunOptions
from tilepipe.engine.request import checked_request
from tilepipe.errors import InputError
from tilepipe.io.files.record import read_record
from tilepipe.pipelines.streets.pipeline import PIPELINE
from tilepipe.tiling.grid import Window


def write(path: Path, *bands: float) -> str:
    """Raster of 80 × 80 pixels of 1 m; each band holds noise around one value."""
    values = np.random.default_rng(0).normal(np.reshape(bands, (-1, 1, 1)), 1, (len(bands), 80, 80))
    profile = {"driver": "GTiff", "dtype": "float32", "crs": "EPSG:32633", "transform": from_origin(0, 80, 1, 1)}
    with rasterio.open(path, "w", width=80, height=80, count=len(bands), **profile) as dataset:
        dataset.write(values.astype(np.float32))
    return str(path)


@pytest.fixture
def intensity(tmp_path: Path) -> str:
    return write(tmp_path / "intensity.tif", 100)


@pytest.fixture
def height(tmp_path: Path) -> str:
    return write(tmp_path / "height.tif", 20, 300)


def test_the_message_names_the_option_of_the_input(intensity, height) -> None:
    with pytest.raises(
        InputError, match=r"height\.tif: has 2 bands; choose one with --height-band n \(height_band=n\)"
    ):
        tilepipe.plan_streets(intensity, height=height)
    with pytest.raises(InputError, match=r"height\.tif: has no band 3; it has 2"):
        tilepipe.plan_streets(intensity, height=height, height_band=3)
    with pytest.raises(InputError, match="--height-band chooses a band of --height; give that too"):
        tilepipe.plan_streets(intensity, height_band=2)
    with pytest.raises(InputError, match=r"height\.tif: has 2 bands; choose one with --band n"):
        tilepipe.plan_streets(height)
    assert "height_band" in inspect.signature(tilepipe.streets).parameters


@pytest.mark.parametrize(("band", "value"), [(1, 20), (2, 300)])
def test_the_band_that_is_chosen_is_read_and_recorded(intensity, height, band, value, tmp_path) -> None:
    def request(number: int):
        return checked_request(
            PIPELINE, intensity, {"heights": height, "height_band": number}, {}, None, None, RunOptions()
        )

    chosen = request(band)
    assert abs(np.mean(chosen.opened.inputs["heights"].read(Window(0, 0, 80, 80))) - value) < 1
    assert chosen.record(tmp_path)["inputs"]["height_band"] == band
    assert chosen.identity() != request(3 - band).identity(), "a run is not resumed with other heights"


def test_the_command_line_and_a_record_choose_bands(intensity, height, tmp_path) -> None:
    run = str(tmp_path / "run")
    app(
        ["streets", intensity, "--height", height, "--height-band", "2", "--out", run, "--quiet"], standalone_mode=False
    )
    record = tmp_path / "run" / "run.toml"
    assert read_record(record)["inputs"]["height_band"] == 2
    app(["run", str(record), "--overwrite", "--quiet"], standalone_mode=False)
    assert read_record(record)["inputs"]["height_band"] == 2
