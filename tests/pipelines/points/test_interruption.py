"""A raster of points that is there when the process is ended is finished."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.io.clouds.test_cloud import write
from tilepipe.errors import InputError
from tilepipe.io.files.atomic import is_aside
from tilepipe.pipelines.points.recipe import grid_clouds


def cloud(folder: Path) -> Path:
    return write(folder / "cloud.las", *np.random.default_rng(0).uniform(0, 30, (3, 500)))


def test_an_interruption_after_the_raster_has_its_name_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    remove, asked = shutil.rmtree, list[Path]()

    def interrupted(folder: Path, **named: bool) -> None:
        if is_aside(Path(folder).name) and not asked:
            asked.append(folder)
            raise KeyboardInterrupt
        remove(folder, **named)

    path = cloud(tmp_path)
    monkeypatch.setattr(shutil, "rmtree", interrupted)
    assert grid_clouds([path], tmp_path / "heights.tif").is_file()
    assert asked
    assert sorted(item.name for item in tmp_path.iterdir()) == ["cloud.las", "heights.tif"]


def test_an_interruption_before_is_one(tmp_path: Path) -> None:
    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "grid":
            raise KeyboardInterrupt

    path = cloud(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        grid_clouds([path], tmp_path / "heights.tif", progress=interrupt)
    assert [item.name for item in tmp_path.iterdir()] == ["cloud.las"]


def test_what_a_killed_process_has_left_goes_where_the_raster_is_there(tmp_path: Path) -> None:
    path = cloud(tmp_path)
    grid_clouds([path], tmp_path / "heights.tif")
    (tmp_path / ".tilepipe-0123456789abcdef.partial").mkdir()
    with pytest.raises(InputError, match="exists"):
        grid_clouds([path], tmp_path / "heights.tif")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["cloud.las", "heights.tif"]
