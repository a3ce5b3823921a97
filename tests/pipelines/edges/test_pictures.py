"""Pictures of a small `edges` run."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from tests.scenes import write_raster
from tilepipe import InputError, edges
from tilepipe.pipelines.edges.pictures import BORDER_COLOUR, EDGE_COLOUR, NEVATIA_BABU_COLOUR, pictures
from tilepipe.report.map import NODATA_TINT

NAMES = ["quicklook.png", "quicklook_detail.png"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dark street of 10 m between bright yards, and a roof, on pixels of 1 m."""
    folder = tmp_path_factory.mktemp("edges")
    grey = np.full((120, 150), 150, np.float32)
    grey[40:50] = 60
    grey[70:100, 60:95] = 230
    grey += np.random.default_rng(3).normal(0, 4, grey.shape).astype(np.float32)
    grey[:10, :10] = np.nan
    edges(write_raster(folder / "photograph.tif", grey), out=folder / "run", params={"levels": 3})
    return folder / "run"


def share(path: Path, colour: str) -> float:
    """Share of the pixels of a picture that have a colour."""
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    wanted = np.array([round(255 * part) for part in to_rgb(colour)])
    return float((abs(picture - wanted).sum(axis=2) < 12).mean())


def copied(run: Path, tmp_path: Path, rows: dict[str, slice]) -> Path:
    """A copy of a run with these rows of its tables."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    for name, kept in rows.items():
        gpd.read_parquet(folder / name).iloc[kept].to_parquet(folder / name)
    return folder


def words(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What is written in each of the pictures."""
    written: list[list[str]] = []
    save = Figure.savefig

    def spy(figure: Figure, *arguments: Any, **options: Any) -> None:
        written.append([text.get_text() for text in figure.findobj(Text)])
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", spy)
    pictures(folder)
    return written


def test_pictures_show_both_methods(run: Path) -> None:
    *paths, page = pictures(run)
    whole, detail = paths
    assert [path.name for path in paths] == NAMES
    assert page.name == "report.html"
    assert all(max(Image.open(path).size) <= 2000 for path in paths)
    for path in paths:
        # the roof has four sides, the street two that are candidates
        assert share(path, EDGE_COLOUR) > 5e-4
        assert share(path, BORDER_COLOUR) > 1e-3
    assert share(detail, NEVATIA_BABU_COLOUR) > 2e-3
    assert share(whole, NEVATIA_BABU_COLOUR) == 0
    first = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in pictures(run)[:-1]] == first


def test_levels_stand_in_for_a_lost_photograph(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    record = (folder / "run.toml").read_text()
    assert "photograph.tif" in record
    with_photograph = pictures(folder)[1].read_bytes()
    (folder / "run.toml").write_text(record.replace("photograph.tif", "lost.tif"))
    detail = pictures(folder)[1]
    assert detail.read_bytes() != with_photograph
    assert share(detail, EDGE_COLOUR) > 5e-4


def test_a_run_without_lines_of_the_classical_method(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "nevatia_babu.parquet").unlink()
    assert share(pictures(folder)[1], NEVATIA_BABU_COLOUR) == 0


def test_levels_and_nodata_have_a_legend(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, detail = words(run, monkeypatch)
    assert {"level 0 … 2, darkest to brightest", "nodata", "edge", "may be the border of a street"} <= set(whole)
    assert "nodata" in detail
    assert not any("level 0" in text for text in detail)
    assert all(share(run / name, NODATA_TINT) > 1e-3 for name in NAMES)
    # the detail is the whole here
    assert "detail picture" not in whole
    assert "no lines" not in whole + detail


def test_the_legend_names_only_what_is_drawn(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with rasterio.open(run / "segments.tif") as raster:
        assert (raster.read(1) == raster.nodata).sum() == 100
    none = slice(0)
    folder = copied(run, tmp_path, {"nevatia_babu.parquet": none})
    whole, detail = words(folder, monkeypatch)
    assert detail.count("no lines") == 1
    assert detail.count("edge") == 1
    folder = copied(run, tmp_path / "empty", {"nevatia_babu.parquet": none, "edges.parquet": none})
    with rasterio.open(folder / "segments.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
        raster.write(np.minimum(raster.read(1), 2), 1)
    whole, _ = words(folder, monkeypatch)
    assert "no lines" in whole
    assert not {"edge", "may be the border of a street", "nodata"} & set(whole)


def test_of_too_many_lines_the_longest_are_drawn(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tilepipe.report.map.MOST_LINES", 1)
    assert "may be the border of a street (the 1 longest)" in words(run, monkeypatch)[0]


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finished edges run"):
        pictures(tmp_path)
