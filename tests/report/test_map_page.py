"""The map page of a small fabricated run."""

from __future__ import annotations

import re
from pathlib import Path

import geopandas
import numpy as np
import pytest
import shapely

from tests.report.fabricated import CRS, LEFT, PIXEL, TOP, make_run
from tilepipe.report import map_page
from tilepipe.report.finished_run import open_folder
from tilepipe.report.map import tinted
from tilepipe.report.map_page import PictureOnPage, TableOnPage, picture_shape, write_map_page


def page_of(folder: Path) -> Path:
    """The page of the fabricated run: a tint, its lines, and the blocks between them."""
    run = open_folder(folder, "streets.tif")
    lines = run.table("centerlines")
    blocks = geopandas.GeoDataFrame({"storeys": [3, 4]}, geometry=[shapely.box(0, 0, 9, 9)] * 2, crs=CRS)
    mask = np.ones(picture_shape(run), bool)
    layers = [
        PictureOnPage("tint", tinted(mask, "#00a6d6")),
        TableOnPage("blocks", blocks, "#ffc400", {"storeys": "storeys", "absent": "absent"}, visible=False),
        TableOnPage("lines", lines, "#ff3d14", {"mean_width_m": "width (m)"}),
    ]
    return write_map_page(run, "Streets", f"{len(lines)} centerlines", layers)


def test_the_page_stands_alone_and_tells_all(tmp_path: Path) -> None:
    text = page_of(make_run(tmp_path / "run")).read_text(encoding="utf-8")
    assert "<script src=" not in text
    assert "<link" not in text
    for part in (
        "3 centerlines",
        "diffuse",
        "1.750",
        "parameters.sigma",
        "mean_width_m",
        "data:image/png",
        "lost.tif",
    ):
        assert part in text
    assert "<b>bold" not in text
    assert "&lt;b&gt;bold" in text
    assert len(text) < 4e6


def test_the_page_thins_what_it_cannot_carry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(tmp_path / "run")
    monkeypatch.setattr(map_page, "_MOST_LINES", 2)
    monkeypatch.setattr(map_page, "_MOST_VERTICES", 50)
    wave = np.linspace(0, 60, 400)
    lines = [shapely.LineString(np.column_stack([LEFT + wave * k, TOP - 100 + np.sin(wave)])) for k in (1, 2, 3)]
    table, remark = map_page._thinned(geopandas.GeoDataFrame(geometry=lines, crs=CRS), PIXEL)
    assert len(table) == 2
    assert shapely.get_num_coordinates(table.geometry.to_numpy()).sum() <= 50
    assert "2 longest of 3" in remark
    assert "simplified" in remark
    assert "2 longest of 3" in page_of(run).read_text(encoding="utf-8")


def test_the_page_draws_polygons_and_begins_at_round_numbers(tmp_path: Path) -> None:
    text = page_of(make_run(tmp_path / "run")).read_text(encoding="utf-8")
    assert "MultiPolygons" in text
    assert "storeys" in text
    assert "absent" not in text
    # the first line goes from the middle of the raster to its left side
    assert re.search(r"\[200\.0,0\.0\]", text)
    assert f'"origin",{LEFT:.1f}' in text
