"""A pipeline of a package of its own, installed and used by the command line: nothing of tilepipe knows its name."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
from scipy import ndimage

from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.pipelines import registry

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "docs" / "extend" / "bright_spots"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of packages that holds the example of the documentation, as pip leaves it."""
    return install(tmp_path_factory.mktemp("packages"), SOURCE)


def install(folder: Path, source: Path) -> Path:
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    information = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    points = project["entry-points"]["tilepipe.pipelines"]
    lines = [f"{name} = {value}" for name, value in points.items()]
    (information / "entry_points.txt").write_text("\n".join(["[tilepipe.pipelines]", *lines, ""]))
    for module in source.glob("*.py"):
        (folder / module.name).write_text(module.read_text())
    return folder


def write_package(folder: Path, name: str, code: str, point: str = "spots") -> Path:
    """Install a package that declares a pipeline by a module of its own."""
    source = folder / f"{name}-source"
    source.mkdir(parents=True)
    module = name.replace("-", "_")
    (source / f"{module}.py").write_text(code)
    (source / "pyproject.toml").write_text(
        f'[project]\nname = "{name}"\nversion = "1.0"\n'
        f'[project.entry-points."tilepipe.pipelines"]\n{point} = "{module}:PIPELINE"\n'
    )
    return install(folder / f"{name}-installed", source)


def tell(*arguments: object, packages: tuple[Path, ...]) -> subprocess.CompletedProcess[str]:
    paths = [*map(str, packages), str(ROOT), str(ROOT / "kernels")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-m", "tilepipe", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    random = np.random.default_rng(4)
    values = ndimage.gaussian_filter(random.normal(0, 1, (90, 120)), 2.5)
    grey = np.clip(128 + 90 * values / values.std(), 0, 255).astype(np.float32)
    return write_raster(tmp_path_factory.mktemp("scene") / "grey.tif", grey)


def test_it_runs_plans_resumes_reports_and_is_scored(installed: Path, scene: Path, tmp_path: Path) -> None:
    def ran(*arguments: object) -> str:
        done = tell(*arguments, packages=(installed,))
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "Bright spots of a raster as boxes." in ran("--help")
    assert "--tile" in ran("spots", "--help")
    planned = ran("spots", scene, "--plan", "--tile", 40)
    assert "spots: 120 × 90 pixels" in planned and "\nmark " in planned
    ran("spots", scene, "--out", tmp_path / "one", "--quiet")
    ran("spots", scene, "--out", tmp_path / "many", "--tile", 31, "--workers", 2, "--quiet")
    for name in ("spots.tif", "spots.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()
    with rasterio.open(tmp_path / "one" / "spots.tif") as found, rasterio.open(scene) as given:
        _, count = ndimage.label(given.read(1) >= 200)
        table = geopandas.read_parquet(tmp_path / "one" / "spots.parquet")
        assert found.read(1).max() == len(table) > 5 and len(table) <= count
    assert "finished" in ran("status", tmp_path / "one")
    assert "quicklook.png" in ran("report", tmp_path / "one")
    assert "completeness" in ran("evaluate", tmp_path / "one", tmp_path / "many" / "spots.parquet").lower()
    ran("run", tmp_path / "one" / "run.toml", "--out", tmp_path / "again", "--quiet")
    assert (tmp_path / "again" / "spots.tif").read_bytes() == (tmp_path / "one" / "spots.tif").read_bytes()


def test_its_operators_work_on_arrays(beside: Callable[[Path], None], scene: Path) -> None:
    import tilepipe.accessor

    array = tilepipe.as_dataarray(tilepipe.open_raster([scene]), chunks=32)
    bright = array.tilepipe.bright(threshold=190)
    assert bright.chunks == array.chunks
    np.testing.assert_array_equal(bright.values, array.values >= 190)
    with pytest.raises(AttributeError, match="no operator 'nothing'"):
        array.tilepipe.nothing()


def test_an_interrupted_run_resumes(installed: Path, scene: Path, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    options = ("--tile", 31, "--workers", 1, "--quiet")
    assert tell("spots", scene, "--out", whole, *options, packages=(installed,)).returncode == 0
    fragile = install(tmp_path / "fragile", SOURCE)
    module, stop = fragile / "bright_spots.py", tmp_path / "stop"
    guard = f"    assert tile.number < 5 or not Path({str(stop)!r}).exists(), 'no more'\n"
    module.write_text(module.read_text().replace("    values = context.raster", f"{guard}    values = context.raster"))
    stop.touch()
    failed = tell("spots", scene, "--out", broken, *options, packages=(fragile,))
    assert failed.returncode == 1 and "failed: AssertionError: no more" in failed.stderr
    assert "pass mark: tile" in failed.stderr and not (broken / "spots.tif").exists()
    told = tell("status", broken, packages=(fragile,)).stdout
    assert "unfinished" in told and "mark: 5 of 12 tiles done" in told
    other = tell("spots", scene, "--out", broken, *options, packages=(installed,))
    assert other.returncode == 2 and "differs in code" in other.stderr
    stop.unlink()
    assert tell("spots", scene, "--out", broken, *options, packages=(fragile,)).returncode == 0
    for name in ("spots.tif", "spots.parquet"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()


BROKEN = {
    "cannot be imported: ModuleNotFoundError: No module named 'nowhere'": "import nowhere\n",
    "is no tilepipe pipeline but a int": "PIPELINE = 3\n",
    "calls itself 'other'": "from bright_spots import PIPELINE\nimport dataclasses\n"
    "PIPELINE = dataclasses.replace(PIPELINE, name='other')\n",
    "has no halo: give the pixels that it reads around a tile, 0 for none": "from bright_spots import PIPELINE\n"
    "import dataclasses\nfrom tilepipe.engine.pipeline import Pass\n"
    "PIPELINE = dataclasses.replace(PIPELINE, passes=(Pass('mark', print, bytes_per_pixel=1),))\n",
    "declares the pass 'mark' twice": "from bright_spots import MARK, PIPELINE\nimport dataclasses\n"
    "PIPELINE = dataclasses.replace(PIPELINE, passes=(MARK, MARK))\n",
}


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch, installed: Path) -> Iterator[Callable[[Path], None]]:
    """Put packages on the path of this process, beside the example; it is as before at the end."""
    known = set(sys.modules)

    def put(package: Path) -> None:
        monkeypatch.syspath_prepend(str(package))
        registry.forget()

    put(installed)
    yield put
    monkeypatch.undo()
    registry.forget()
    for name in set(sys.modules) - known:
        if "spots" in name:
            del sys.modules[name]


@pytest.mark.parametrize("wanted", BROKEN)
def test_a_package_that_cannot_be_used_is_named_in_one_line(
    beside: Callable[[Path], None], tmp_path: Path, wanted: str
) -> None:
    beside(write_package(tmp_path, "rotten-spots", BROKEN[wanted], point="rotten"))
    with pytest.raises(InputError) as told:
        registry.pipeline("rotten")
    assert len(str(told.value).splitlines()) == 1
    assert "rotten-spots" in str(told.value) and wanted in str(told.value)
    assert registry.pipeline("spots").name == "spots" and registry.names() == [*registry.OWN, "rotten", "spots"]


def test_such_a_package_spoils_no_other_command(installed: Path, scene: Path, tmp_path: Path) -> None:
    package = write_package(tmp_path, "rotten-spots", "import nowhere\n", point="rotten")
    told = tell("rotten", scene, "--out", tmp_path / "run", packages=(package, installed))
    assert (told.returncode, told.stdout) == (2, "") and len(told.stderr.strip().splitlines()) == 1
    told = tell("--help", packages=(package, installed))
    assert told.returncode == 0 and "rotten" in told.stdout and "Cannot be used" in told.stdout
    assert tell("spots", scene, "--plan", packages=(package, installed)).returncode == 0


def test_a_name_that_two_packages_declare_is_refused(beside: Callable[[Path], None], tmp_path: Path) -> None:
    beside(write_package(tmp_path, "other-spots", "from bright_spots import PIPELINE\n"))
    with pytest.raises(
        InputError, match=r"'spots' is declared twice, by the packages .*-spots and .*-spots; uninstall"
    ):
        registry.pipeline("spots")


def test_a_name_of_tilepipe_itself_is_not_taken(beside: Callable[[Path], None], tmp_path: Path) -> None:
    beside(write_package(tmp_path, "other-streets", "from bright_spots import PIPELINE\n", point="streets"))
    assert registry.pipeline("streets").name == "streets"
    (complaint,) = registry.complaints()
    assert "other-streets" in complaint


def test_an_unknown_pipeline_is_said(scene: Path) -> None:
    assert tell("nonsense", scene, packages=()).returncode == 2
