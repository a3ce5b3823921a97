"""The laws of `edges`: tiling, workers and interruption do not show; lines, counts and energies are what they say."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from tests.laws import assert_invisible, assert_resumes, layer_bytes
from tests.parameters import edge_parameters
from tilepipe import InputError, RunOptions, edges, plan_edges
from tilepipe_kernels.mrf.edge_energy import energy

LAYERS = ("segments.tif", "lines.tif", "edges.parquet", "nevatia_babu.parquet", "edges.json")
pytestmark = pytest.mark.filterwarnings("ignore:.*still wanted to change")

FEW = {"rounds": 6, "minimum_street_length": 10.0, "minimum_length": 2.0, "minimum_edge_length": 2.0}


def streets(side: int = 180) -> NDArray[np.uint8]:
    """Dark streets on bright ground, red and green and blue alike but for noise; pixels of 1 m."""
    random = np.random.default_rng(2)
    row, column = np.mgrid[:side, :side]
    grey = np.full((side, side), 180.0)
    grey[(row > 60) & (row < 70)] = 70
    grey[(row - column > 20) & (row - column < 35)] = 60
    grey[(row - 120) ** 2 + (column - 140) ** 2 < 400] = 110
    bands = grey + random.normal(0, 12, (3, side, side))
    bands[:, 100:104, 20:60] = 0
    return np.clip(bands, 0, 255).astype(np.uint8)


def write(path: Path, bands: NDArray[np.uint8]) -> Path:
    profile = {"driver": "GTiff", "count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    profile |= {"dtype": "uint8", "crs": "EPSG:32633", "transform": from_origin(1000, 2000, 1, 1), "nodata": 0}
    with rasterio.open(path, "w", **profile) as file:
        file.write(bands)
    return path


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("scene") / "photo.tif", streets())


def run(scene: Path, out: Path, options: RunOptions, **choice: object) -> None:
    edges(scene, out=out, params=FEW | choice, options=options)


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    run(scene, folder, RunOptions(tile=256, workers=1))
    assert sorted(layer_bytes(folder)) == sorted(LAYERS)
    return folder


@pytest.mark.parametrize(
    ("tile", "workers", "executor"), [(64, 2, "threads"), (77, 3, "threads"), (100, 2, "processes")]
)
def test_tiling_and_workers_do_not_show(
    scene: Path, whole: Path, tmp_path: Path, tile: int, workers: int, executor: str
) -> None:
    options = RunOptions(tile=tile, workers=workers, executor=executor)
    assert_invisible(partial(run, scene), tmp_path, layer_bytes(whole), [options])


@pytest.mark.parametrize(
    "choice",
    [
        {"optimiser": "messages", "levels": 3},
        {"optimiser": "icm", "potential": "quadratic"},
        {"optimiser": "annealing", "sweeps": 3},
        {"scheme": "integrated", "rounds": 3},
        {"scheme": "integrated", "rounds": 3, "optimiser": "messages"},
        {"grey": "principal", "edge_share": 0.3},
    ],
    ids=lambda choice: "-".join(map(str, choice.values())),
)
def test_tiling_does_not_show_with_any_choice(scene: Path, tmp_path: Path, choice: dict[str, object]) -> None:
    chosen = partial(run, scene, **choice)
    chosen(tmp_path / "whole", RunOptions(tile=256, workers=2))
    assert_invisible(chosen, tmp_path, layer_bytes(tmp_path / "whole"), [RunOptions(tile=70, workers=2)])


@pytest.mark.parametrize("failing", ["levels", "fields"])
def test_a_failed_run_resumes(scene: Path, whole: Path, tmp_path: Path, failing: str) -> None:
    options = RunOptions(tile=64, workers=1)
    assert_resumes(partial(run, scene), tmp_path / "run", layer_bytes(whole), options, failing)


def test_the_energy_is_that_of_the_published_fields(scene: Path, whole: Path) -> None:
    from tilepipe.pipelines.edges.pass_bands import open_photograph
    from tilepipe.pipelines.edges.pass_levels import LevelScale
    from tilepipe.tiling.grid import Window

    said = json.loads((whole / "edges.json").read_text())
    assert said["grey"] == "luminance"
    with rasterio.open(whole / "segments.tif") as file:
        levels = file.read(1)
    with rasterio.open(whole / "lines.tif") as file:
        lines = file.read(1)
    parameters = edge_parameters(FEW)
    photograph = open_photograph([scene], crs=None, band=None, grey="automatic")
    values = photograph.read(Window(0, 0, *levels.shape))
    low, high = said["grey_range"]
    means = tuple((value - low) / (high - low) * 255 for value in said["level_values"])
    scale = LevelScale(low, high, means, said["noise_in_levels"])
    assert scale.noise == 0.3
    observed = scale.levels(scale.grey(values))
    nodata = levels == 255
    assert np.array_equal(nodata, np.isnan(values)) and np.array_equal(lines == 255, nodata)
    h, v = (np.where(nodata, 0, lines >> bit & 1).astype(np.uint8) for bit in (0, 1))
    expected = energy(observed, levels, h, v, parameters.model(scale.noise))
    assert said["energy"] == pytest.approx(expected, rel=1e-9)
    assert said["energy_of_levels"] + said["energy_of_lines"] == pytest.approx(said["energy"])


def test_lines_run_where_levels_differ_and_within_half_a_pixel(whole: Path) -> None:
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    table = geopandas.read_parquet(whole / "edges.parquet")
    with rasterio.open(whole / "lines.tif") as file:
        field = file.read(1)
        corner = file.transform
    field = np.where(field == 255, 0, field)
    cracks = [shapely.LineString([corner * (j, i + 1), corner * (j + 1, i + 1)]) for i, j in np.argwhere(field & 1)]
    cracks += [shapely.LineString([corner * (j + 1, i), corner * (j + 1, i + 1)]) for i, j in np.argwhere(field & 2)]
    drawn = shapely.unary_union(cracks).buffer(0.56)
    assert table.is_valid.all() and table.geometry.within(drawn).all()
    assert np.allclose(table.length_m, table.length)
    assert table.sinuosity.dropna().ge(1).all() and table.straightness.between(0, 1 + 1e-12).all()


def test_streets_are_marked_with_their_width(whole: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    table = geopandas.read_parquet(whole / "edges.parquet")
    level = table[table.street_border & (table.straightness > 0.9) & (table.length_m > 20)]
    assert (level.street_width_m.sub(9).abs() < 1.5).any()
    partners = table.set_index("line_id").loc[level.street_partner]
    assert len(partners) == len(level)
    assert not table[~table.street_border].street_partner.any()


def test_flat_or_empty_images_are_refused(tmp_path: Path) -> None:
    empty = write(tmp_path / "empty.tif", np.zeros((3, 20, 20), np.uint8))
    with pytest.raises(InputError, match=r"empty\.tif: holds nothing but nodata"):
        edges(empty, out=tmp_path / "run")
    flat = write(tmp_path / "flat.tif", np.full((3, 20, 20), 9, np.uint8))
    with pytest.raises(InputError, match=r"flat\.tif: holds 1 grey values"):
        edges(flat, out=tmp_path / "run")
    with pytest.raises(InputError, match="levels"):
        edges(flat, out=tmp_path / "run", params={"levels": 1})


def test_two_levels_without_an_edge_line_are_published(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    bands = np.full((3, 30, 30), 90, np.uint8)
    bands[:, :, 15:] = 95
    photo = write(tmp_path / "photo.tif", bands)
    edges(photo, out=tmp_path / "run", params={"levels": 2, "minimum_length": 1000.0, "minimum_edge_length": 1000.0})
    assert geopandas.read_parquet(tmp_path / "run" / "edges.parquet").empty
    assert geopandas.read_parquet(tmp_path / "run" / "nevatia_babu.parquet").empty


def test_the_classical_method_can_be_left_out(scene: Path, tmp_path: Path) -> None:
    found = edges(scene, out=tmp_path / "run", params=FEW | {"nevatia_babu": False})
    assert [path.name for path in found] == ["segments.tif", "lines.tif", "edges.parquet", "edges.json"]


def test_a_cap_that_leaves_much_is_said(scene: Path, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="still wanted to change after 1 rounds"):
        edges(scene, out=tmp_path / "run", params=FEW | {"rounds": 1})
    assert json.loads((tmp_path / "run" / "edges.json").read_text())["unresolved_sites"] > 0


def test_the_plan_names_passes_and_halos(scene: Path) -> None:
    text = plan_edges(scene, params={"grey": "principal"}).text()
    assert all(name in text for name in ("bands", "levels", "fields"))
