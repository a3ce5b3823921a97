"""Vector files of others: the layer that is meant, whatever the format, or one line that can be followed."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import geopandas
import pandas
import pyogrio
import pytest
import shapely

from tilepipe.cli import app
from tilepipe.errors import InputError
from tilepipe.evaluate.results import read_result
from tilepipe.io.vectors.tables import LINES, read_layer


@pytest.fixture
def lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> geopandas.GeoDataFrame:
    """Two lines of 200 m, in the folder of the test."""
    monkeypatch.chdir(tmp_path)
    geometry = shapely.linestrings([[[500060, 4999800], [500060, 5000000]], [[500150, 4999800], [500150, 5000000]]])
    return geopandas.GeoDataFrame({"k": [1.0, 2.0]}, geometry=geometry, crs="EPSG:32631")


def zipped(lines: geopandas.GeoDataFrame, names: list[str], path: str) -> None:
    for name in names:
        lines.to_file(f"{name}.shp")
    with zipfile.ZipFile(path, "w") as archive:
        for part in sorted(Path().glob("*.[sdpc][hbrp][pfxjg]")):
            archive.write(part)


def write(lines: geopandas.GeoDataFrame, name: str) -> None:
    """A file in the format that its name tells."""
    if name.endswith((".geoparquet", ".pq", ".data")):
        lines.to_parquet("plain.parquet")
        shutil.move("plain.parquet", name)
    elif name.endswith((".geojsonl", ".geojsons")):
        lines.to_crs(4326).to_file("plain.geojsonl", driver="GeoJSONSeq")
        shutil.move("plain.geojsonl", name)
    elif name.endswith(".gpkg.zip"):
        lines.to_file("plain.gpkg")
        with zipfile.ZipFile(name, "w") as archive:
            archive.write("plain.gpkg")
    elif name.endswith(".zip"):
        zipped(lines, ["roads"], name)
    else:
        lines.to_file(name, driver="OpenFileGDB" if name.endswith(".gdb") else None)


@pytest.mark.parametrize(
    "name",
    [
        "t.geoparquet",
        "t.pq",
        "t.data",
        "t.geojsonl",
        "t.geojsons",
        "t.shp.zip",
        "t.gpkg.zip",
        "t.gdb",
        "t.fgb",
        "t.shp",
    ],
)
def test_formats_are_read_as_they_are(lines, name) -> None:
    write(lines, name)
    found = read_layer(name, "truth").of(LINES)
    assert found.reprojected("EPSG:32631").size == 2
    assert sum(shapely.length(found.reprojected("EPSG:32631"))) == pytest.approx(400, abs=0.1)  # GeoJSON rounds degrees


def two_layers(lines: geopandas.GeoDataFrame, name: str) -> None:
    if name.endswith(".zip"):
        zipped(lines, ["fences", "streets"], name)
        return
    driver = "OpenFileGDB" if name.endswith(".gdb") else None
    lines[:1].to_file(name, layer="fences", driver=driver)
    lines.to_file(name, layer="streets", mode="a", driver=driver)


@pytest.mark.parametrize("name", ["two.gpkg", "two.gdb", "two.zip"])
def test_of_several_layers_one_is_named(lines, name) -> None:
    two_layers(lines, name)
    with pytest.raises(InputError, match=r"holds the layers 'fences', 'streets'; choose one with --layer NAME"):
        read_layer(name, "truth")
    with pytest.raises(InputError, match="--result-layer NAME"):
        read_result(name)
    with pytest.raises(InputError, match=r"'roads' is not among them: choose one with --area-layer NAME"):
        read_layer(name, "area", "roads")
    assert len(read_layer(name, "truth", "streets").table) == len(read_result(name, "streets").table) == 2


def test_a_layer_without_geometry_is_no_choice(lines) -> None:
    lines.to_file("one.gpkg", layer="streets")
    pyogrio.write_dataframe(pandas.DataFrame({"a": [1]}), "one.gpkg", layer="owners")
    assert len(read_layer("one.gpkg", "truth").table) == 2
    with pytest.raises(InputError, match="'owners' has no geometry"):
        read_layer("one.gpkg", "truth", "owners")
    pyogrio.write_dataframe(pandas.DataFrame({"a": [1]}), "none.gpkg")
    with pytest.raises(InputError, match="holds no geometry"):
        read_layer("none.gpkg", "truth")


def test_parquet_without_geometry_is_told(lines) -> None:
    pandas.DataFrame({"a": [1]}).to_parquet("plain.parquet")
    with pytest.raises(InputError, match="is Parquet without 'geo' metadata"):
        read_layer("plain.parquet", "truth")
    lines.to_parquet("lines.parquet")
    with pytest.raises(InputError, match="leave --layer out"):
        read_layer("lines.parquet", "truth", "streets")


def test_empty_geometries_of_other_types_do_not_matter(lines) -> None:
    lines.loc[2], lines.loc[3], lines.loc[4] = [3, None], [4, shapely.Point()], [5, shapely.GeometryCollection()]
    lines = lines.set_crs("EPSG:32631")  # geopandas before 1.1 loses it
    lines.to_parquet("lines.parquet")
    assert read_layer("lines.parquet", "truth").of(LINES).types == {"LineString"}


def test_a_place_without_coordinates_is_told(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    far = geopandas.GeoDataFrame(geometry=[shapely.LineString([(0, 95), (200, 91)])], crs="EPSG:4326")
    far.to_parquet("far.parquet")
    with pytest.raises(InputError, match=r"far\.parquet lies, .* where WGS 84 / UTM zone 31N has no coordinates"):
        read_layer("far.parquet", "truth").reprojected("EPSG:32631")


def test_the_command_line_chooses_layers(lines, capsys) -> None:
    two_layers(lines, "two.gpkg")
    lines.to_parquet("found.parquet")
    app(["evaluate", "found.parquet", "two.gpkg", "--layer", "streets"], standalone_mode=False)
    assert "of 400 m of truth" in capsys.readouterr().out
    app(["evaluate", "two.gpkg", "two.gpkg", "--result-layer", "fences", "--layer", "streets"], standalone_mode=False)
    assert "of 200 m of result" in capsys.readouterr().out
    with pytest.raises(InputError, match="--area-layer names a layer of --area"):
        app(["evaluate", "found.parquet", "two.gpkg", "--layer", "streets", "--area-layer", "x"], standalone_mode=False)
