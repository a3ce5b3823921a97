"""The synthetic city: the same pixels whatever the window, and a truth that fits the pixels."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from rasterio.features import rasterize

from tilepipe.errors import InputError
from tilepipe.synthetic import LAYERS, City, render, render_layers, truth_buildings, truth_centerlines, write_city
from tilepipe.synthetic.city import layout_of
from tilepipe_kernels.city.chart import chart, street_distance

CITY = City(seed=3, rows=620, columns=560)
ALL = tuple(LAYERS)


@pytest.fixture(scope="module")
def whole() -> dict[str, np.ndarray]:
    return render_layers(CITY, ALL)


@pytest.fixture(scope="module")
def lines() -> gpd.GeoDataFrame:
    return truth_centerlines(CITY)


@pytest.fixture(scope="module")
def footprints() -> gpd.GeoDataFrame:
    return truth_buildings(CITY)


def pixels_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of points (n, 2) of the coordinate reference system."""
    column, row = (points[:, 0] - CITY.west) / CITY.resolution, (CITY.north - points[:, 1]) / CITY.resolution
    return np.floor(row).astype(int), np.floor(column).astype(int)


@pytest.mark.parametrize("draw", range(6))
def test_a_window_is_a_part_of_the_whole(whole: dict[str, np.ndarray], draw: int) -> None:
    random = np.random.default_rng(draw)
    rows, columns = (int(n) for n in random.integers(1, 200, 2))
    row, column = int(random.integers(0, CITY.rows - rows)), int(random.integers(0, CITY.columns - columns))
    part = render_layers(CITY, ALL, (row, column, rows, columns))
    for layer in ALL:
        expected = whole[layer][..., row : row + rows, column : column + columns]
        np.testing.assert_array_equal(part[layer], expected, err_msg=layer)


def test_the_smallest_windows_see_what_the_next_block_sends_over(whole: dict[str, np.ndarray]) -> None:
    random = np.random.default_rng(0)
    # Crowns over streets reach farthest out of the block that holds them.
    places = np.argwhere((whole["trees"] == 1) & (whole["streets"] == 1))
    for row, column in random.permutation(places)[:150].tolist():
        assert render(CITY, "trees", (row, column, 1, 1)) == 1
        np.testing.assert_array_equal(
            render(CITY, "intensity", (row, column, 1, 3))[:, : CITY.columns - column],
            whole["intensity"][row : row + 1, column : column + 3],
        )


def test_a_window_far_away_and_over_the_border_is_the_same_however_cut() -> None:
    wide = render(CITY, "intensity", (-40, 90_000, 100, 120))
    np.testing.assert_array_equal(wide[30:, 50:], render(CITY, "intensity", (-10, 90_050, 70, 70)))


def test_layers_have_their_types_and_ranges(whole: dict[str, np.ndarray]) -> None:
    dtypes = {layer: block.dtype.name for layer, block in whole.items()}
    assert dtypes == {
        "height": "float32", "intensity": "uint8", "aerial": "uint8", "streets": "uint8",
        "buildings": "int32", "edges": "uint8", "trees": "uint8",
    }  # fmt: skip
    assert whole["aerial"].shape == (3, *CITY.shape)
    void = whole["intensity"] == 0
    np.testing.assert_array_equal(void, np.isnan(whole["height"]))
    assert 0 < void.mean() < 0.02
    heights = whole["height"][~void]
    assert heights.min() > 0 and heights.max() < 250


def test_streets_are_dark_and_level_and_buildings_high(whole: dict[str, np.ndarray]) -> None:
    valid = (whole["intensity"] > 0) & (whole["trees"] == 0)
    street = valid & (whole["streets"] == 1)
    assert 0.08 < street.mean() < 0.35
    assert 40 < np.median(whole["intensity"][street]) < 50
    assert np.median(whole["intensity"][valid & (whole["streets"] == 0)]) > 85
    built = valid & (whole["buildings"] > 0)
    assert np.nanmedian(whole["height"][built]) - np.nanmedian(whole["height"][street]) > 2.5


def test_street_mask_is_where_the_exact_distance_is_negative(whole: dict[str, np.ndarray]) -> None:
    layout, random = layout_of(CITY), np.random.default_rng(0)
    for row, column in random.integers(0, 560, (400, 2)).tolist():
        coordinates = chart(layout, (column + 0.5) * CITY.resolution, (row + 0.5) * CITY.resolution)
        assert whole["streets"][row, column] == (street_distance(layout, *coordinates) <= 0)


def test_centerlines_run_along_the_middle_of_their_streets(
    whole: dict[str, np.ndarray], lines: gpd.GeoDataFrame
) -> None:
    outside = total = 0
    for line, width in zip(lines.geometry, lines["width"], strict=True):
        spots = np.arange(1.0, line.length - 1.0, 3.0)
        points, ahead = (shapely.get_coordinates(line.interpolate(spots + step)) for step in (0.0, 0.01))
        normal = (ahead - points)[:, ::-1] * (1, -1) / 0.01
        for side in (-1, 1):
            for offset, inside in ((0.5 * width - 0.5, True), (0.5 * width + 0.5, False)):
                row, column = pixels_of(points + side * offset * normal)
                known = (row >= 0) & (row < CITY.rows) & (column >= 0) & (column < CITY.columns)
                street = whole["streets"][row[known], column[known]] == 1
                if inside:
                    assert street.all()
                else:
                    # Beside the border there is street only at junctions.
                    outside, total = outside + int(street.sum()), total + street.size
    assert outside / total < 0.25


def test_centerline_vertices_are_dense_and_on_their_level(lines: gpd.GeoDataFrame) -> None:
    layout = layout_of(CITY)
    for family, coordinate in (("street", 0), ("cross street", 1)):
        for line in lines.geometry[lines["family"] == family]:
            # The ends lie on the city's border, between two exact vertices.
            vertices = shapely.get_coordinates(line)[1:-1]
            assert np.hypot(*np.diff(vertices, axis=0).T).max(initial=0) < 3.2
            levels = [chart(layout, x - CITY.west, CITY.north - y)[coordinate] for x, y in vertices]
            assert np.ptp(levels) < 1e-6 if levels else True


def test_streets_that_cross_share_a_vertex(lines: gpd.GeoDataFrame) -> None:
    junctions = 0
    geometries = lines.geometry.to_numpy()
    for a, b in shapely.STRtree(geometries).query(geometries, predicate="intersects").T:
        if a < b:
            shared = set(geometries[a].coords) & set(geometries[b].coords)
            crossings = shapely.get_num_geometries(geometries[a].intersection(geometries[b]))
            assert len(shared) == crossings
            junctions += crossings
    assert junctions > 6 and (lines["family"] == "dead end").any()


def test_footprints_are_the_building_layer(whole: dict[str, np.ndarray], footprints: gpd.GeoDataFrame) -> None:
    shapes = zip(footprints.geometry, footprints["building"], strict=True)
    burnt = rasterize(shapes, out_shape=CITY.shape, transform=CITY.transform, dtype="int32")
    # A pixel whose centre lies on an outline to rounding may fall either way.
    assert np.count_nonzero(burnt != whole["buildings"]) <= 2
    assert footprints["building"].is_unique and footprints["height"].min() >= 3


def test_buildings_keep_clear_of_streets_and_each_other(
    whole: dict[str, np.ndarray], footprints: gpd.GeoDataFrame, lines: gpd.GeoDataFrame
) -> None:
    assert not np.any((whole["buildings"] > 0) & (whole["streets"] == 1))
    shapes = footprints.geometry.to_numpy()
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    assert np.array_equal(first, second)
    corridors = lines.buffer(lines["width"] / 2, cap_style="flat")
    assert not len(shapely.STRtree(shapes).query(corridors.to_numpy(), predicate="intersects")[0])


def test_edges_part_labels_where_no_tree_hides_them(whole: dict[str, np.ndarray]) -> None:
    label = np.where(whole["streets"] == 1, -1, whole["buildings"])
    for row in range(200, 260):
        for column in range(200, 260):
            expected = 0
            for bit, (r, c) in ((1, (row + 1, column)), (2, (row, column + 1))):
                hidden = whole["trees"][row, column] or whole["trees"][r, c]
                expected += bit * bool(label[row, column] != label[r, c] and not hidden)
            assert whole["edges"][row, column] == expected
    assert whole["edges"][200:260, 200:260].any()


def test_files_hold_the_layers_whatever_the_tiles_and_workers(whole: dict[str, np.ndarray], tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    paths = write_city(tmp_path / "a", CITY, tile=512, workers=2, progress=lambda *step: seen.append(step))
    other = write_city(tmp_path / "b", CITY, tile=1024, workers=1)
    assert seen == [(n, 4) for n in range(1, 5)]
    names = sorted(["files.toml", *(path.name for path in paths.values())])
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == names
    for layer in ALL:
        with rasterio.open(paths[layer]) as file, rasterio.open(other[layer]) as again:
            np.testing.assert_array_equal(file.read().squeeze(), whole[layer])
            np.testing.assert_array_equal(again.read(), file.read())
            assert file.crs == CITY.crs and file.transform == CITY.transform and file.block_shapes[0] == (512, 512)
    with rasterio.open(paths["intensity"]) as file:
        assert file.nodata == 0
    lines = gpd.read_parquet(paths["centerlines"])
    assert len(lines) and lines.crs == CITY.crs and len(gpd.read_parquet(paths["footprints"]))


def test_an_interrupted_city_leaves_no_file(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_city(tmp_path, CITY, ("streets",), tile=512, progress=stop)
    assert not list(tmp_path.iterdir())


def test_another_seed_is_another_city() -> None:
    window = (0, 0, 64, 64)
    assert np.any(render(City(seed=1), "height", window) != render(City(seed=2), "height", window))
    np.testing.assert_array_equal(
        render(City(seed=1, rows=100), "aerial", window), render(City(seed=1, rows=900), "aerial", window)
    )


def test_densities_of_zero_leave_nothing() -> None:
    bare = City(seed=3, trees=0, cars=0, voids=0, speckle=0)
    layers = render_layers(bare, ("trees", "intensity", "streets"), (0, 0, 200, 200))
    assert not layers["trees"].any() and layers["intensity"].all()
    assert layers["intensity"][layers["streets"] == 1].max() < 100


@pytest.mark.parametrize(
    "wrong",
    [{"rows": 0}, {"resolution": 0.0}, {"rows": 10**7, "columns": 10**7}, {"trees": 3.0}, {"speckle": -0.1}],
)
def test_a_city_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        City(**wrong)  # type: ignore[arg-type]


def test_unknown_layers_and_unusable_tiles_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="choose from"):
        render(CITY, "lidar")
    with pytest.raises(InputError, match="empty"):
        render(CITY, "trees", (0, 0, 0, 5))
    with pytest.raises(InputError, match="512"):
        write_city(tmp_path, CITY, tile=500)
    with pytest.raises(InputError, match="workers"):
        write_city(tmp_path, CITY, workers=0)
