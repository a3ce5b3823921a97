"""Pictures of a small `edges` run."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from tests.scenes import write_raster
from tilepipe import InputError, edges
from tilepipe.edge_quicklook import BORDER_COLOUR, EDGE_COLOUR, NEVATIA_BABU_COLOUR, edge_pictures

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


def test_pictures_show_both_methods(run: Path) -> None:
    whole, detail = paths = edge_pictures(run)
    assert [path.name for path in paths] == NAMES
    assert all(max(Image.open(path).size) <= 2000 for path in paths)
    for path in paths:
        # the roof has four sides, the street two that are candidates
        assert share(path, EDGE_COLOUR) > 5e-4
        assert share(path, BORDER_COLOUR) > 1e-3
    assert share(detail, NEVATIA_BABU_COLOUR) > 2e-3
    assert share(whole, NEVATIA_BABU_COLOUR) == 0
    first = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in edge_pictures(run)] == first


def test_levels_stand_in_for_a_lost_photograph(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    record = (folder / "run.toml").read_text()
    assert "photograph.tif" in record
    with_photograph = edge_pictures(folder)[1].read_bytes()
    (folder / "run.toml").write_text(record.replace("photograph.tif", "lost.tif"))
    detail = edge_pictures(folder)[1]
    assert detail.read_bytes() != with_photograph
    assert share(detail, EDGE_COLOUR) > 5e-4


def test_a_run_without_lines_of_the_classical_method(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "nevatia_babu.parquet").unlink()
    assert share(edge_pictures(folder)[1], NEVATIA_BABU_COLOUR) == 0


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finished edges run"):
        edge_pictures(tmp_path)
