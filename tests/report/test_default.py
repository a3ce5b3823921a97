"""Pictures of runs whose pipeline says nothing but the names of its layers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.transform import from_origin

from tests.report.fabricated import CRS, LEFT, PIXEL, TOP, make_run, pixels_of
from tilepipe.errors import InputError
from tilepipe.report.default import TABLE_COLOURS, labelled, pictures


def test_a_run_of_labels_and_lines(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    picture, page = pictures(folder, layers=["streets.tif", "centerlines", "absent"])
    assert (picture.name, page.name) == ("quicklook.png", "report.html")
    assert max(Image.open(picture).size) <= 2000
    assert pixels_of(picture, TABLE_COLOURS[0]) > 1000
    assert pixels_of(picture, TABLE_COLOURS[1]) == 0
    text = page.read_text(encoding="utf-8")
    assert all(word in text for word in ("data:image/png", "mean_width_m", "3 centerlines"))


def test_all_that_the_folder_holds_is_drawn(tmp_path: Path) -> None:
    text = pictures(make_run(tmp_path / "run"))[1].read_text(encoding="utf-8")
    assert all(f'"{name}"' in text for name in ("input", "labels", "intensity", "streets", "centerlines", "skeleton"))


def test_numbers_have_a_colour_bar(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    heights = np.linspace(0, 9, 120 * 200, dtype=np.float32).reshape(120, 200)
    heights[:40] = np.nan
    transform = from_origin(LEFT, TOP, PIXEL, PIXEL)
    profile = {"driver": "GTiff", "height": 120, "width": 200, "count": 1, "dtype": "float32", "nodata": np.nan}
    with rasterio.open(folder / "heights.tif", "w", crs=CRS, transform=transform, **profile) as file:
        file.write(heights, 1)
    picture, _ = pictures(folder, layers=["heights.tif"])
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    # viridis from violet at the foot of the bar to yellow at its top, as pale as on the map
    bar = pixels[:, 1060:1085].reshape(-1, 3)
    for colour in ((68, 1, 84), (253, 231, 37)):
        pale = 255 - 0.45 * (255 - np.array(colour))
        assert (abs(bar - pale).sum(axis=1) < 12).any()


def test_labels_are_opaque_but_for_none_and_nodata() -> None:
    labels = np.ma.masked_equal(np.array([[0, 7], [9, 255]], np.uint32), 255)
    pixels = labelled(labels)
    assert (pixels[..., 3] > 0).tolist() == [[False, True], [True, False]]
    assert (pixels[0, 1] != pixels[1, 0]).any()


def test_a_run_without_labels_or_lines(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    with rasterio.open(folder / "streets.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
        raster.write(np.zeros(raster.shape, raster.dtypes[0]), 1)
    picture, _ = pictures(folder, layers=["streets.tif"])
    assert pixels_of(picture, TABLE_COLOURS[0]) == 0


def test_a_folder_without_layers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finished run"):
        pictures(tmp_path)
