"""The command line: every command, its exit codes, and how little it loads."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
import typer

import tilepipe
from benchmarks.memory.contents import write_content
from tests.laws import Killed, layer_bytes, tiles
from tests.scenes import SMALL, band, draw, write_raster
from tilepipe import cli, plan_objects
from tilepipe.cli.pipelines import assignments
from tilepipe.engine.options import RunOptions, format_memory, parse_memory
from tilepipe.errors import InputError
from tilepipe.io.files.record import STATE

SHAPE = (90, 110)
VALUES = draw(SHAPE, band(SHAPE, (-5, 40), (95, 70), 7) | band(SHAPE, (60, -5), (30, 115), 6))
SETTINGS = [part for name, value in SMALL.items() for part in ("--set", f"{name}={value}")]
COMMANDS = ["streets", "objects", "edges", "run", "plan", "status", "grid", "evaluate", "report", "demo", "city"]


@pytest.fixture
def tell(monkeypatch, capsys):
    """Run the command line; its exit code, standard output and standard error."""

    def command(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["tilepipe", *(str(argument) for argument in arguments)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        output = capsys.readouterr()
        return int(stopped.value.code or 0), output.out, output.err

    return command


@pytest.fixture(scope="session")
def scene(tmp_path_factory) -> Path:
    return write_raster(tmp_path_factory.mktemp("scene") / "intensity.tif", VALUES)


@pytest.fixture(scope="session")
def finished(tmp_path_factory, scene) -> Path:
    """A finished run."""
    out = tmp_path_factory.mktemp("finished") / "run"
    command = [sys.executable, "-m", "tilepipe", "streets", scene, "--out", out, "--tile", "40", *SETTINGS, "--quiet"]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b""
    return out


def begin(monkeypatch, scene: Path, out: Path, survived: int) -> list[str]:
    """Make a run that ends after some tiles; the command's arguments."""
    command = ["streets", str(scene), "--out", str(out), "--tile", "40", "--workers", "1", *SETTINGS, "--quiet"]
    monkeypatch.setattr(sys, "argv", ["tilepipe", *command])
    with tiles(lambda _, __, worked: Killed() if len(worked) == survived else None), pytest.raises(Killed):
        cli.main()
    return command


# --- what every command says of itself


def test_version(tell):
    assert tell("--version") == (0, f"tilepipe {tilepipe.__version__}\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_help(tell, command):
    code, text, _ = tell(command, "--help")
    assert code == 0
    assert f"tilepipe {command}" in text
    assert len(text.splitlines()) > 5


def test_the_list_of_commands_is_complete(tell):
    code, text, _ = tell("--help")
    assert code == 0
    group = typer.main.get_command(cli.app)
    assert group.list_commands(typer.Context(group)) == COMMANDS
    assert all(command in text for command in COMMANDS)


def test_without_a_command_the_help_is_shown(tell):
    code, text, error = tell()
    assert (code, error) == (2, "")
    assert all(command in text for command in COMMANDS)


def test_pipelines_share_their_options():
    group = typer.main.get_command(cli.app)
    own, shared = (
        [item.name for item in group.get_command(typer.Context(group), name).params] for name in ("streets", "objects")
    )
    assert list(shared)[:3] == ["rasters", "out", "tile"]
    assert own == ["rasters", "out", "height", "height_band", *shared[2:]]


def test_unknown_options_and_commands_exit_with_2(tell):
    assert tell("streets", "--nonsense")[0] == 2
    assert tell("nonsense")[0] == 2


def test_heavy_libraries_are_loaded_by_the_command_that_needs_them():
    heavy = "rasterio geopandas pandas dask xarray numba numpy scipy pyproj shapely zarr matplotlib bokeh distributed"
    for arguments in (["--version"], ["streets", "--help"]):
        program = (
            f"import sys\nsys.argv = ['tilepipe', *{arguments}]\nfrom tilepipe import cli\n"
            f"try:\n    cli.main()\nexcept SystemExit:\n    print(sorted(set('{heavy}'.split()) & set(sys.modules)))\n"
        )
        result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert result.stdout.splitlines()[-1] == "[]"


# --- streets, plan, status, run


def test_plan(tell, scene, tmp_path, finished):
    code, text, error = tell("streets", scene, "--out", tmp_path / "run", "--tile", 40, *SETTINGS, "--plan")
    assert (code, error) == (0, "")
    assert not (tmp_path / "run").exists()
    assert text.startswith("streets: 110 × 90 pixels of 1 m (0.0 Mpx), 9 tiles of 40 × 40")
    assert [line.split()[0] for line in text.splitlines()[2:-1]] == ["levels", "segment", "lines", "export"]
    assert "limit 8.0 GiB" in text
    assert tell("plan", finished / "run.toml") == (0, text, "")


def test_a_plan_of_one_tile_is_worded_so(tell, scene):
    text = tell("streets", scene, "--plan", "--workers", 2)[1]
    assert "1 tile of 2046 × 2046" in text or "1 tile of 2048 × 2048" in text
    assert "with 1 worker (" in text


def test_status_of_a_finished_run(tell, finished):
    code, text, _ = tell("status", finished)
    assert code == 0
    assert text.splitlines()[0] == f"{finished}: finished"
    assert f"  streets.tif  {(finished / 'streets.tif').stat().st_size:,} bytes" in text.splitlines()


def test_status_of_an_unfinished_run(tell, monkeypatch, scene, tmp_path):
    out = tmp_path / "run"
    begin(monkeypatch, scene, out, survived=13)
    code, text, _ = tell("status", out)
    assert code == 0
    assert text.splitlines() == [
        f"{out}: unfinished",
        "  levels: 9 of 9 tiles done",
        "  segment: 4 of 9 tiles done",
        "  lines: 0 of 9 tiles done",
        f"  resume with: tilepipe run {out / STATE / 'run.toml'}",
    ]


def test_the_advice_of_status_resumes_the_run(tell, monkeypatch, scene, tmp_path, finished):
    out = tmp_path / "run"
    begin(monkeypatch, scene, out, survived=13)
    code, text, _ = tell("run", out / STATE / "run.toml")
    assert code == 0
    assert text.splitlines() == [str(out / name) for name in ("streets.tif", "centerlines.parquet", "skeleton.parquet")]
    assert layer_bytes(out) == layer_bytes(finished)


def test_status_of_other_folders(tell, tmp_path):
    assert tell("status", tmp_path) == (0, f"{tmp_path}: empty\n", "")
    code, _, error = tell("status", tmp_path / "nowhere")
    assert (code, error) == (
        2,
        f"tilepipe: error: {tmp_path}/nowhere: no such folder; name the --out folder of a run\n",
    )


def test_a_record_repeats_its_run(tell, tmp_path, finished):
    code, text, _ = tell("run", finished / "run.toml", "--out", tmp_path / "again", "--quiet")
    assert (code, text) == (0, "")
    assert layer_bytes(tmp_path / "again") == layer_bytes(finished)
    first, second = (tomllib.loads((out / "run.toml").read_text()) for out in (finished, tmp_path / "again"))
    assert first.pop("out") != second.pop("out")
    # no run takes as long as another
    assert all(record["files"].pop("timings.json") for record in (first, second))
    assert first == second
    code, _, error = tell("run", finished / "run.toml")
    assert code == 2
    assert "finished run; use --overwrite" in error


def test_a_record_of_ones_own_needs_the_inputs_only(tell, tmp_path, scene):
    record = tmp_path / "mine.toml"
    record.write_text(f'command = "streets"\n[inputs]\nrasters = ["{scene}"]\n')
    assert tell("plan", record)[1].startswith("streets: 110 × 90")
    code, _, error = tell("run", record)
    assert (code, error) == (2, "tilepipe: error: no folder for the run is named: give --out FOLDER\n")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("command = ", "is no valid TOML"),
        ('command = "cats"', "command 'cats' is unknown"),
        ('command = "streets"', "no input raster"),
        ('command = "streets"\n[options]\ntiles = 3', "'tiles' is unknown; known are tile, workers"),
        ('command = "streets"\n[options]\ntile = "big"', "tile 'big' is no whole number"),
        ('command = "streets"\nparameters = 3', "'parameters' is no table"),
        ('command = "objects"\n[inputs]\nheights = ["a.tif"]', "objects takes no 'heights'; it takes rasters, crs"),
    ],
)
def test_bad_records_are_refused_in_one_line(tell, tmp_path, text, words):
    record = tmp_path / "mine.toml"
    record.write_text(text)
    code, _, error = tell("run", record, "--out", tmp_path / "run")
    assert code == 2
    assert words in error
    assert len(error.splitlines()) == 1


def test_a_folder_is_no_record(tell, finished):
    code, _, error = tell("run", finished)
    assert (code, len(error.splitlines())) == (2, 1)
    assert "name the run.toml" in error


@pytest.mark.parametrize("suffix", ["gpkg", "fgb", "geojson"])
def test_formats(tell, tmp_path, scene, finished, suffix):
    out = tmp_path / "run"
    code, text, _ = tell("streets", scene, "--out", out, "--format", suffix, *SETTINGS)
    assert code == 0
    assert text.splitlines() == [
        str(out / name) for name in ("streets.tif", f"centerlines.{suffix}", f"skeleton.{suffix}")
    ]
    lines = geopandas.read_file(out / f"centerlines.{suffix}")
    assert len(lines) == len(geopandas.read_parquet(finished / "centerlines.parquet")) > 0
    assert sorted(p.name for p in out.iterdir() if p.suffix in (".parquet", ".gpkg", ".fgb", ".geojson")) == [
        f"centerlines.{suffix}",
        f"skeleton.{suffix}",
    ]


def test_overwriting_in_another_format_leaves_no_old_layer(tell, tmp_path, scene):
    out = tmp_path / "run"
    assert tell("streets", scene, "--out", out, *SETTINGS, "--quiet")[0] == 0
    assert tell("streets", scene, "--out", out, *SETTINGS, "--quiet", "--format", "fgb", "--overwrite")[0] == 0
    assert not (out / "centerlines.parquet").exists()
    assert (out / "centerlines.fgb").exists()


# --- interruption and leftovers


def test_an_interruption_is_one_line_and_130(tell, scene, tmp_path, finished):
    out = tmp_path / "run"
    command = ["streets", scene, "--out", out, "--tile", 40, "--workers", 1, *SETTINGS, "--quiet"]
    with tiles(lambda *_: KeyboardInterrupt()):
        code, text, error = tell(*command)
    assert (code, text) == (130, "")
    assert error == "tilepipe: interrupted; run the same command again to resume\n"
    assert tell(*command)[0] == 0
    assert layer_bytes(out) == layer_bytes(finished)


def test_state_without_an_identity_is_nobodys(tell, monkeypatch, scene, tmp_path, finished):
    """A process that ends while it clears its state leaves facts behind, which must not enter another run."""
    out = tmp_path / "run"
    begin(monkeypatch, scene, out, survived=13)
    (out / STATE / "identity.toml").unlink()
    (marker,) = out.glob(f"{STATE}/*/levels/r0000c0000.facts")
    marker.write_bytes(marker.with_name("r0000c0001.facts").read_bytes())
    code, _, error = tell("run", finished / "run.toml", "--out", out, "--quiet")
    assert (code, error) == (0, "")
    assert layer_bytes(out) == layer_bytes(finished)


def test_overwriting_does_not_clear_the_state_of_a_process_at_work(tell, monkeypatch, scene, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    out = tmp_path / "run"
    command = begin(monkeypatch, scene, out, survived=5)
    with (out / STATE / "lock").open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        code, _, error = tell(*command, "--set", "tolerance=3", "--overwrite")
    assert code == 2
    assert "another process is at work" in error
    assert len(list(out.glob(f"{STATE}/*/levels/*.facts"))) == 5


# --- parsing


def testassignments():
    texts = ["a=3", "b=0.5", "c=true", "d=histogram", 'e="x=y"', "f=", "g = 4", "a=5", "h=" + "[" * 5000]
    expected = {"a": 5, "b": 0.5, "c": True, "d": "histogram", "e": "x=y", "f": "", "g": 4, "h": "[" * 5000}
    assert assignments(texts) == expected
    for bad in ("tolerance", "=3"):
        with pytest.raises(InputError, match="write --set name=value"):
            assignments([bad])


def test_memory_sizes():
    assert parse_memory("8GiB") == parse_memory(" 8 g ") == parse_memory("8192MB") == 8 << 30
    assert parse_memory("1.5K") == 1536
    assert parse_memory("7") == 7
    assert [format_memory(size) for size in (5, 2048, 3 << 20, 3 << 29, 5 << 40)] == [
        "5 B",
        "2 KiB",
        "3 MiB",
        "1.5 GiB",
        "5120.0 GiB",
    ]
    needed, allowed = (1.9 + 0.02) * (1 << 30), (1.9 + 0.01) * (1 << 30)
    assert (format_memory(needed), format_memory(allowed, up=False)) == ("2.0 GiB", "1.9 GiB")
    for bad in ("", "GiB", "-1G", "8 PB", "1e3"):
        with pytest.raises(InputError, match="is not understood"):
            parse_memory(bad)


def test_options_are_whole_numbers():
    assert RunOptions(tile=np.int64(7)).tile == 7
    for wrong in ({"tile": 1.5}, {"workers": "2"}, {"memory": None}):
        with pytest.raises(InputError, match="is no whole number"):
            RunOptions(**wrong)


def test_more_memory_than_can_be_addressed_is_refused():
    assert RunOptions(memory=sys.maxsize).memory == sys.maxsize
    with pytest.raises(InputError, match="memory is more than any machine can address"):
        RunOptions(memory=10**400)


# --- the other commands


def test_evaluate(tell, finished, tmp_path):
    lines = finished / "centerlines.parquet"
    code, text, _ = tell("evaluate", finished, lines)
    assert code == 0
    assert "completeness" in text
    code, text, _ = tell("evaluate", lines, lines, "--buffer", 2, "--json")
    score = json.loads(text)
    assert code == 0
    assert score["completeness"] == score["correctness"] == 1
    code, _, error = tell("evaluate", lines, tmp_path / "nowhere.parquet")
    assert (code, len(error.splitlines())) == (2, 1)
    assert "nowhere.parquet" in error


def test_report(tell, finished):
    code, text, error = tell("report", finished)
    assert code == 0, error
    made = [Path(line) for line in text.splitlines()]
    assert made
    assert all(path.stat().st_size > 0 for path in made)


def test_grid(tell, tmp_path):
    import laspy

    rng = np.random.default_rng(0)
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    cloud.header.scales = [0.01, 0.01, 0.01]
    cloud.header.offsets = [500000, 5000000, 0]
    cloud.x, cloud.y = 500000 + rng.uniform(0.1, 19.9, 4000), 5000000 + rng.uniform(0.1, 11.9, 4000)
    cloud.z, cloud.intensity = np.full(4000, 7.25), np.full(4000, 99)
    cloud.write(tmp_path / "cloud.las")
    out = tmp_path / "height.tif"
    code, text, error = tell("grid", tmp_path / "cloud.las", "--out", out, "--crs", "EPSG:32633", "--resolution", 1)
    assert code == 0, error
    assert text == f"{out}\n"
    with rasterio.open(out) as dataset:
        assert (dataset.height, dataset.width, dataset.crs.to_epsg()) == (12, 20, 32633)
        assert np.all(dataset.read(1) == 7.25)
    code, _, error = tell("grid", tmp_path / "cloud.las", "--out", out, "--classes", "two")
    assert (code, error) == (2, "tilepipe: error: --classes two: write class numbers with commas, such as 2,6\n")


def test_city(tell, tmp_path):
    code, text, error = tell("city", tmp_path / "city", "--size", 128, "--layers", "intensity", "--workers", 1)
    assert code == 0, error
    made = [Path(line).name for line in text.splitlines()]
    assert "intensity.tif" in made
    with rasterio.open(tmp_path / "city" / "intensity.tif") as dataset:
        assert dataset.shape == (128, 128)
    code, _, error = tell("city", tmp_path / "city", "--size", 128, "--layers", "cats")
    assert (code, len(error.splitlines())) == (2, 1)
    assert "cats" in error


# --- the memory plan


def _peak_memory(command: list[str]) -> int:
    """Largest resident memory in bytes of a command that ends well."""
    program = (
        "import resource, subprocess, sys\nsubprocess.run(sys.argv[1:], check=True)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
    )
    result = subprocess.run([sys.executable, "-c", program, *command], capture_output=True, text=True, check=True)
    unit = 1 if sys.platform == "darwin" else 1024
    return int(result.stdout.split()[-1]) * unit


@pytest.fixture(scope="session")
def wide_city(tmp_path_factory) -> Path:
    from tilepipe.synthetic import City, write_city

    folder = tmp_path_factory.mktemp("city")
    city = City(seed=0, rows=2048, columns=2048, resolution=0.5)
    return write_city(folder, city, layers=("intensity",), truth=False)["intensity"]


@pytest.mark.slow
def test_noise_keeps_to_what_it_may_need_at_most(tmp_path):
    raster = write_content(tmp_path, "white noise", 768, heights=True)
    options = RunOptions(tile=512, workers=1)
    finest = {"smallest_leaf": 0.5, "minimum_area": 0.0}
    allowed = plan_objects(raster, params=finest, options=options).most_memory
    command = [sys.executable, "-m", "tilepipe", "objects", str(raster), "--out", str(tmp_path / "run"), "--quiet"]
    settings = [part for name, value in finest.items() for part in ("--set", f"{name}={value}")]
    limits = ["--tile", "512", "--workers", "1", "--memory", f"{allowed >> 10}KiB"]
    measured = _peak_memory([*command, *settings, *limits])
    assert measured <= allowed, f"measured {format_memory(measured)}, allowed {format_memory(allowed)}"


@pytest.mark.slow
@pytest.mark.parametrize("tile", [1024, 512])
def test_the_memory_plan_is_kept(tmp_path, wide_city, tile):
    from tilepipe.pipelines.streets.pipeline import plan_streets

    planned = plan_streets(wide_city, options=RunOptions(tile=tile, workers=2)).memory
    command = [sys.executable, "-m", "tilepipe", "streets", str(wide_city), "--out", str(tmp_path / "run")]
    measured = _peak_memory([*command, "--tile", str(tile), "--workers", "2", "--quiet"])
    assert measured <= planned <= 4 * measured, f"measured {format_memory(measured)}, planned {format_memory(planned)}"
