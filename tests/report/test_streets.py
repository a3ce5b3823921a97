"""Pictures and page of a small fabricated run."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from PIL import Image
from rasterio.transform import from_origin

from tilepipe.errors import InputError
from tilepipe.io.cog import cog_from_tiled
from tilepipe.io.formats import SUFFIX, write_table
from tilepipe.report import frame, page
from tilepipe.report import streets as pictures
from tilepipe.report.page import detail, map_page, quicklook, report

CRS = "EPSG:2994"
LEFT, TOP, PIXEL = 6e5, 8e5, 2.0


def make_run(folder: Path, rows: int = 120, columns: int = 200, format: str = "parquet") -> Path:
    """A run with three streets that meet in the middle of the raster."""
    folder.mkdir()
    middle = (LEFT + columns * PIXEL / 2, TOP - rows * PIXEL / 2)
    ends = [(LEFT, middle[1]), (LEFT + columns * PIXEL, middle[1]), (middle[0], TOP)]
    lines = [shapely.LineString([middle, end]) for end in ends]
    streets = np.zeros((rows, columns), np.uint32)
    streets[rows // 2 - 4 : rows // 2 + 4] = 7
    streets[: rows // 2, columns // 2 - 4 : columns // 2 + 4] = 7
    intensity = np.where(streets > 0, 40, 180).astype(np.uint8)
    intensity[:5, :5] = 0
    transform = from_origin(LEFT, TOP, PIXEL, PIXEL)
    for name, values in [("labels.tif", streets), ("intensity.tif", intensity)]:
        profile = {
            "driver": "GTiff",
            "height": rows,
            "width": columns,
            "count": 1,
            "dtype": values.dtype,
            "nodata": 0,
        }
        with rasterio.open(folder / name, "w", **profile, crs=CRS, transform=transform) as file:
            file.write(values, 1)
    cog_from_tiled(folder / "labels.tif", folder / "streets.tif")
    facts = {"line_id": np.arange(3), "from_node": np.zeros(3, int), "to_node": np.arange(1, 4)}
    facts |= {"length_m": shapely.length(lines) * 0.3048, "mean_width_m": np.array([4.9, 5.0, np.nan])}
    for name in ("centerlines", "skeleton"):
        write_table(folder / f"{name}{SUFFIX[format]}", facts, lines, CRS, format)
    (folder / "run.toml").write_text(
        '[inputs]\nrasters = ["intensity.tif", "lost.tif"]\n[parameters]\nname = "<b>bold</b>"\nsigma = 1.5\n'
    )
    (folder / "timings.json").write_text(json.dumps({"diffuse": 1.25, "grow": 0.5}))
    return folder


def pixels_of(path: Path, colour: str) -> int:
    from matplotlib.colors import to_rgb

    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    wanted = np.array([round(255 * part) for part in to_rgb(colour)])
    return int((abs(picture - wanted).sum(axis=2) < 12).sum())


def test_the_pictures_show_lines_junction_and_regions(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    for draw, name in [(quicklook, "quicklook.png"), (detail, "quicklook_detail.png")]:
        path = draw(run)
        assert path == run / name
        assert max(Image.open(path).size) <= 2000
        assert pixels_of(path, pictures.LINE_COLOUR) > 1500
        assert pixels_of(path, pictures.JUNCTION_COLOUR) > 20
    without = make_run(tmp_path / "without")
    lines = geopandas.read_parquet(without / "centerlines.parquet")
    write_table(without / "centerlines.parquet", {}, lines.geometry[:0], CRS, geometry_type="LineString")
    # The legend still holds a sample of the line.
    assert pixels_of(quicklook(without), pictures.LINE_COLOUR) < 400


@pytest.mark.parametrize("shape", [(3000, 40), (40, 3000), (30, 30)])
def test_pictures_of_any_shape_stay_small(tmp_path: Path, shape: tuple[int, int]) -> None:
    path = quicklook(make_run(tmp_path / "run", *shape))
    assert max(Image.open(path).size) <= 2000


def test_pictures_repeat_in_bytes(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert quicklook(run).read_bytes() == quicklook(run).read_bytes()


def test_regions_and_background_are_where_they_belong(tmp_path: Path) -> None:
    run = pictures.open_run(make_run(tmp_path / "run"))
    mask = pictures.region_mask(run, run.bounds, (60, 100))
    grey = pictures.grey_background(run, run.bounds, (60, 100))
    assert [mask[30, 5], mask[5, 50], mask[55, 5]] == [True, True, False]
    assert (grey[30, 5], grey[5, 10], grey[0, 0]) == (20, 235, 128)
    east = (LEFT + 200, run.bounds[1], run.bounds[2], run.bounds[3])
    np.testing.assert_array_equal(
        pictures.region_mask(run, east, (120, 100)),
        pictures.region_mask(run, run.bounds, (120, 200))[:, 100:],
    )


def test_several_rasters_are_one_background(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    whole = pictures.open_run(folder)
    with rasterio.open(folder / "intensity.tif") as file:
        profile, values = file.profile, file.read(1)
    for k, (start, stop) in enumerate([(0, 70), (70, 200)]):
        profile.update(width=stop - start, transform=from_origin(LEFT + start * PIXEL, TOP, PIXEL, PIXEL))
        with rasterio.open(folder / f"part{k}.tif", "w", **profile) as file:
            file.write(values[:, start:stop], 1)
    parts = pictures.open_run(folder, [folder / "part0.tif", folder / "part1.tif"])
    shape = (120, 200)
    np.testing.assert_array_equal(
        pictures.grey_background(whole, whole.bounds, shape),
        pictures.grey_background(parts, parts.bounds, shape),
    )


def test_the_detail_shows_the_busiest_place(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", 1300, 3000)
    x, y = LEFT + 1200 * PIXEL, TOP - 1100 * PIXEL
    knot = [shapely.LineString([(x, y + k), (x + 300, y + 200 + k)]) for k in range(0, 100, 2)]
    far = [shapely.LineString([(LEFT + 5000 + k, TOP - 2500), (LEFT + 5900, TOP - 2400 + k)]) for k in range(5)]
    write_table(folder / "centerlines.parquet", {}, knot + far, CRS)
    run = pictures.open_run(folder)
    window = pictures._busiest_window(run)
    assert window is not None
    assert shapely.box(*window).covers(shapely.MultiLineString(knot))
    assert (window[2] - window[0], window[3] - window[1]) == (1000 * PIXEL, 1000 * PIXEL)
    assert shapely.box(*run.bounds).covers(shapely.box(*window))


def test_junctions_by_node_and_by_coordinate(tmp_path: Path) -> None:
    table = pictures.open_run(make_run(tmp_path / "run")).centerlines
    # A line that goes on from a free end makes no junction there.
    onward = table.iloc[[1]].assign(from_node=table["to_node"].iloc[1], to_node=9)
    end = shapely.get_point(table.geometry.iloc[1], -1)
    onward = onward.set_geometry([shapely.LineString([end, (end.x + 10, end.y)])], crs=CRS)
    table = geopandas.GeoDataFrame(pd.concat([table, onward], ignore_index=True))
    expected = [[LEFT + 200, TOP - 120]]
    np.testing.assert_array_equal(pictures.junctions(table), expected)
    np.testing.assert_array_equal(pictures.junctions(table[["geometry"]]), expected)


@pytest.mark.parametrize(("longest", "bar"), [(9.9, 5), (10, 10), (0.3, 0.2), (4999, 2000)])
def test_scale_bars_are_round(longest: float, bar: float) -> None:
    assert frame.round_length(longest) == pytest.approx(bar)


def test_the_page_stands_alone_and_tells_all(tmp_path: Path) -> None:
    text = map_page(make_run(tmp_path / "run")).read_text(encoding="utf-8")
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
    monkeypatch.setattr(page, "_MOST_LINES", 2)
    monkeypatch.setattr(page, "_MOST_VERTICES", 50)
    wave = np.linspace(0, 60, 400)
    lines = [shapely.LineString(np.column_stack([LEFT + wave * k, TOP - 100 + np.sin(wave)])) for k in (1, 2, 3)]
    table, remark = page._thinned(geopandas.GeoDataFrame(geometry=lines, crs=CRS), PIXEL)
    assert len(table) == 2
    assert shapely.get_num_coordinates(table.geometry.to_numpy()).sum() <= 50
    assert "2 longest of 3" in remark
    assert "simplified" in remark
    assert "2 longest of 3" in map_page(run).read_text(encoding="utf-8")


@pytest.mark.parametrize("format", ["gpkg", "geojson"])
def test_runs_in_other_formats_are_drawn(tmp_path: Path, format: str) -> None:
    run = make_run(tmp_path / "run", format=format)
    assert [path.name for path in report(run)] == ["quicklook.png", "quicklook_detail.png", "report.html"]
    assert pixels_of(run / "quicklook.png", pictures.LINE_COLOUR) > 1500


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finished streets run"):
        report(tmp_path)
