"""Folders of finished runs, opened for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from tests.report.fabricated import CRS, LEFT, PIXEL, TOP, make_run
from tilepipe.errors import InputError
from tilepipe.report.finished_run import open_finished_run, open_folder


def test_a_run_tells_how_it_lies_and_what_is_missing(tmp_path: Path) -> None:
    run = open_finished_run(make_run(tmp_path / "run"), "streets", "streets.tif", ["centerlines"])
    assert run.bounds == (LEFT, TOP - 240, LEFT + 400, TOP)
    assert (run.shape, run.pixel, run.unit, run.metres) == ((120, 200), PIXEL, "foot", 0.3048)
    assert [path.name for path in run.inputs] == ["intensity.tif"]
    assert [path.name for path in run.missing] == ["lost.tif"]
    assert run.record["parameters"]["sigma"] == 1.5
    assert run.facts("3 lines").startswith("3 lines   |   200 × 120 pixels of 0.61 m   |   ")
    assert "100 × 120 pixels" in run.facts("", (LEFT, TOP - 240, LEFT + 200, TOP))
    assert run.kilometres(run.table("centerlines")) == pytest.approx((200 + 200 + 120) * 0.3048 / 1000)
    assert run.optional_table("nothing") is None


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no streets\.tif with centerlines; give .* of a finished streets run"):
        open_finished_run(tmp_path, "streets", "streets.tif", ["centerlines"])
    with pytest.raises(InputError, match="no layer of a run"):
        open_folder(tmp_path, None)
    with pytest.raises(InputError, match="holds no edges"):
        open_folder(make_run(tmp_path / "run"), "streets.tif").table("edges")


def test_a_run_without_rasters_lies_as_its_input_did(tmp_path: Path) -> None:
    lie = f'[raster]\ncrs = "{CRS}"\nleft = 100.0\ntop = 50.0\npixel = 2.0\nshape = [10, 20]\n'
    (tmp_path / "run.toml").write_text(lie)
    run = open_folder(tmp_path, None)
    assert (run.bounds, run.shape, run.pixel) == ((100, 30, 140, 50), (10, 20), 2)


def test_the_background_is_grey_and_knows_what_it_does_not_know(tmp_path: Path) -> None:
    run = open_folder(make_run(tmp_path / "run"), "streets.tif")
    grey = run.background(run.bounds, (60, 100))
    assert (grey[30, 5], grey[5, 10], grey.filled()[0, 0]) == (20, 235, 128)
    assert grey.mask[0, 0]
    assert not grey.mask[5, 5]
    lost = open_folder(run.folder, "streets.tif", ["lost.tif"])
    assert lost.background(run.bounds, (6, 10)).mask.all()


@pytest.mark.parametrize(("band", "left", "right"), [(None, 20, 235), (2, 235, 20)])
def test_bands_are_red_green_blue_or_the_one_that_the_run_took(
    tmp_path: Path, band: int | None, left: int, right: int
) -> None:
    folder = make_run(tmp_path / "run")
    bands = np.full((4, 120, 200), 90, np.uint8)
    # the luminance rises to the right, green alone falls, and infrared does not count
    bands[0, :, :100], bands[2, :, :100], bands[1, :, 100:] = 0, 0, 70
    bands[3, :, ::2] = 255
    bands[:3:2, :, 100:] = 255
    transform = from_origin(LEFT, TOP, PIXEL, PIXEL)
    profile = {"driver": "GTiff", "height": 120, "width": 200, "count": 4, "dtype": "uint8", "crs": CRS}
    with rasterio.open(folder / "aerial.tif", "w", transform=transform, **profile) as file:
        file.write(bands)
    (folder / "run.toml").write_text('[inputs]\nrasters = ["aerial.tif"]\n' + (f"band = {band}\n" if band else ""))
    run = open_folder(folder, "streets.tif")
    grey = run.background(run.bounds, (120, 200))
    assert (grey[50, 20], grey[50, 180]) == (left, right)


def _photograph(
    folder: Path, bands: np.ndarray, meanings: Sequence[str] = (), palette: Any = None, **profile: Any
) -> np.ma.MaskedArray:
    """Background of a run over a photograph that fills it."""
    folder = make_run(folder)
    profile |= {"driver": "GTiff", "height": 120, "width": 200, "count": len(bands), "dtype": "uint8", "crs": CRS}
    transform = from_origin(LEFT, TOP, PIXEL, PIXEL)
    with rasterio.open(folder / "aerial.tif", "w", transform=transform, **profile) as file:
        if meanings:
            file.colorinterp = [ColorInterp[meaning] for meaning in meanings]
        file.write(bands)
        if palette:
            file.write_colormap(1, palette)
    (folder / "run.toml").write_text('[inputs]\nrasters = ["aerial.tif"]\n')
    run = open_folder(folder, "streets.tif")
    return run.background(run.bounds, (120, 200))


def test_the_background_is_void_where_the_photograph_is(tmp_path: Path) -> None:
    bands = np.full((3, 120, 200), 90, np.uint8)
    bands[:, :, 100:] = 200
    bands[:, :, :20] = 0
    bands[2, 50:, 150:] = 0  # a roof without blue is there
    grey = _photograph(tmp_path / "a", bands, nodata=0)
    assert np.array_equal(grey.mask, np.broadcast_to(np.arange(200) < 20, (120, 200)))
    alpha = np.full((1, 120, 200), 255, np.uint8)
    alpha[0, 60:] = 0
    grey = _photograph(tmp_path / "b", np.concatenate([alpha, bands[:1]]), meanings=("alpha", "gray"))
    assert np.array_equal(grey.mask, alpha[0] == 0)
    assert (grey[30, 50], grey[30, 150]) == (116, 235)


def test_the_background_has_the_colours_of_a_palette(tmp_path: Path) -> None:
    indices = np.ones((1, 120, 200), np.uint8)
    indices[:, :, 100:] = 0
    palette = {0: (250, 250, 250, 255), 1: (10, 10, 10, 255)}
    grey = _photograph(tmp_path / "a", indices, photometric="palette", palette=palette)
    assert (grey[50, 20], grey[50, 180]) == (20, 235)


def test_several_rasters_are_one_background(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    whole = open_folder(folder, "streets.tif")
    with rasterio.open(folder / "intensity.tif") as file:
        profile, values = file.profile, file.read(1)
    for k, (start, stop) in enumerate([(0, 70), (70, 200)]):
        profile.update(width=stop - start, transform=from_origin(LEFT + start * PIXEL, TOP, PIXEL, PIXEL))
        with rasterio.open(folder / f"part{k}.tif", "w", **profile) as file:
            file.write(values[:, start:stop], 1)
    parts = open_folder(folder, "streets.tif", [folder / "part0.tif", folder / "part1.tif"])
    shape = (120, 200)
    np.testing.assert_array_equal(whole.background(whole.bounds, shape), parts.background(parts.bounds, shape))
