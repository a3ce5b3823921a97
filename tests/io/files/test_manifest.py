"""What tilepipe writes beside its runs replaces no file of others and no input."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.report.fabricated import make_run
from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.io.files.manifest import Written
from tilepipe.io.rasters.cog import cog_from_tiled, write_cog
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.vectors.formats import convert, write_table
from tilepipe.report.finished_run import open_folder
from tilepipe.synthetic import City, write_city

CITY = City(rows=64, columns=64)


def test_a_city_replaces_what_a_city_has_written(tmp_path: Path) -> None:
    first = write_city(tmp_path, CITY, ["intensity"], tile=512)
    write_city(tmp_path, CITY, ["streets"], tile=512, truth=False)
    write_city(tmp_path, CITY, ["intensity", "streets"], tile=512)
    first["intensity"].write_bytes(b"mine")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match=r"intensity\.tif: was not written by tilepipe or has changed since"):
        write_city(tmp_path, CITY, ["streets", "intensity"], tile=512)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("text", ["command = 'streets'", "files = 3", "no toml"])
def test_a_manifest_of_others_is_not_replaced(tmp_path: Path, text: str) -> None:
    (tmp_path / "files.toml").write_text(text)
    with pytest.raises(InputError, match=r"files\.toml: "):
        write_city(tmp_path, CITY, ["intensity"], tile=512)
    assert [path.name for path in tmp_path.iterdir()] == ["files.toml"]
    assert (tmp_path / "files.toml").read_text() == text


def test_a_report_replaces_what_a_report_has_written(tmp_path: Path) -> None:
    run = open_folder(make_run(tmp_path / "run"), "streets.tif")
    for text in ("first", "second"):
        with run.adding("report.html") as aside:
            aside.write_text(text)
        assert (run.folder / "report.html").read_text() == text
    (run.folder / "quicklook.png").write_text("mine")
    with pytest.raises(InputError, match=r"quicklook\.png: was not written by tilepipe"), run.adding("quicklook.png"):
        pass
    assert (run.folder / "quicklook.png").read_text() == "mine"


@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_a_copy_does_not_replace_its_source(tmp_path: Path, link: object) -> None:
    raster = write_raster(tmp_path / "a.tif", np.ones((20, 30), np.float32))
    table = write_table(tmp_path / "a.parquet", {}, shapely.points([[0, 0]]), "EPSG:32633")
    for source, write in ((raster, cog_from_tiled), (table, lambda a, b: convert(a, "gpkg", destination=b))):
        before = source.read_bytes()
        target = source
        if callable(link):
            target = source.with_name(f"link{source.suffix}")
            link(source, target)
        with pytest.raises(InputError, match=r"it is the (raster to be copied|table to be converted)"):
            write(source, target)
        assert source.read_bytes() == before


def test_a_raster_leaves_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "a.tiled.tif").write_text("mine")
    geometry = Geometry("EPSG:32633", 5e5, 5e6, pixel=1, shape=(20, 30), metres=1, height_metres=1)
    write_cog(tmp_path / "a.tif", lambda window: np.ones(window.shape, np.uint8), "uint8", geometry, nodata=0)
    assert (tmp_path / "a.tiled.tif").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "a.tiled.tif"]


def test_any_other_content_of_the_same_size_is_another_file(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"0")
    first = Written.of(path)
    assert first.lies_in(tmp_path)
    others = [bytes([value]) for value in range(49, 58)]
    for content in others:
        path.write_bytes(content)
        assert not first.lies_in(tmp_path), content
    # checksums on both sides
    assert {Written.of(path).crc32 < first.crc32 for content in others if path.write_bytes(content)} == {True, False}
    for content in (b"", b"00"):
        path.write_bytes(content)
        assert not Written("a", 1, Written.of(path).crc32).lies_in(tmp_path)
