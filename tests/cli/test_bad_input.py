"""Law 5: what cannot be used is refused in one line that names it and says what to do; exit code 2 or 1."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rasterio.transform import Affine

from tests.scenes import SMALL, band, draw, write_raster
from tilepipe import cli
from tilepipe.pipelines.streets import pass_segment

SHAPE = (60, 70)
VALUES = draw(SHAPE, band(SHAPE, (30, -5), (30, 75), 6))


def run(monkeypatch, capsys, *arguments: object) -> tuple[int, str]:
    """Exit code and standard error of the command line."""
    monkeypatch.setattr(sys, "argv", ["tilepipe", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0), capsys.readouterr().err


def refused(monkeypatch, capsys, out: Path, *arguments: object) -> str:
    """The one line with which a streets command is refused; nothing is left behind."""
    code, error = run(monkeypatch, capsys, "streets", *arguments, "--out", out, "--quiet")
    assert code == 2, error
    assert len(error.strip().splitlines()) == 1, error
    assert error.startswith("tilepipe: error: ")
    assert not (out / ".state").exists()
    assert not out.is_dir() or not any(p.suffix in (".tif", ".parquet", ".toml") for p in out.iterdir())
    return error


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return write_raster(tmp_path / "good.tif", VALUES)


def test_missing_file(monkeypatch, capsys, tmp_path):
    assert "nowhere.tif: no such file" in refused(monkeypatch, capsys, tmp_path / "run", tmp_path / "nowhere.tif")


def test_not_a_raster(monkeypatch, capsys, tmp_path):
    (tmp_path / "text.tif").write_text("hello")
    assert "text.tif: is no raster" in refused(monkeypatch, capsys, tmp_path / "run", tmp_path / "text.tif")
    (tmp_path / "folder").mkdir()
    assert "folder: is a folder but no Zarr" in refused(monkeypatch, capsys, tmp_path / "run", tmp_path / "folder")


@pytest.mark.parametrize("layout", [{}, {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"}])
def test_damaged_rasters(monkeypatch, capsys, tmp_path, layout):
    import rasterio

    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "width": 70, "height": 60, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    with rasterio.open(path, "w", **profile, transform=Affine(1, 0, 5e5, 0, -1, 5e6), **layout) as dataset:
        dataset.write(VALUES, 1)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    error = refused(monkeypatch, capsys, tmp_path / "run", path)
    assert "a.tif: is damaged, it has" in error
    path.write_bytes(content[:6])
    assert "a.tif: is no raster that GDAL can read, or is damaged" in refused(monkeypatch, capsys, tmp_path / "r", path)
    if layout:
        # whole in length, but one block is rubbish: found only when a tile reads it
        middle = len(content) // 2
        path.write_bytes(content[:middle] + b"\xff" * 200 + content[middle + 200 :])
        code, error = run(monkeypatch, capsys, "streets", path, "--out", tmp_path / "run", "--quiet")
        assert code == 2
        assert "a.tif: is damaged, its rows 0:60, columns 0:70 cannot be read; copy the file anew" in error
        assert len(error.strip().splitlines()) == 1


def test_a_picture_without_georeferencing(monkeypatch, capsys, tmp_path):
    from PIL import Image

    Image.fromarray(VALUES.clip(0, 255).astype(np.uint8)).save(tmp_path / "a.png")
    assert "a.png: has no georeferencing" in refused(monkeypatch, capsys, tmp_path / "run", tmp_path / "a.png")


def test_a_named_crs_must_not_differ(monkeypatch, capsys, tmp_path, good):
    error = refused(monkeypatch, capsys, tmp_path / "run", good, "--crs", "EPSG:28992")
    assert "good.tif: is in WGS 84 / UTM zone 33N but --crs names Amersfoort / RD New" in error
    assert run(monkeypatch, capsys, "streets", good, "--crs", "EPSG:32633", "--plan")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("streets",), "missing argument 'RASTER'; see tilepipe streets --help"),
        (("streets", "a.tif", "--nonsense"), "no such option: --nonsense"),
        (("streets", "a.tif", "--tile", "big"), "invalid value for '--tile': "),
        (("streets", "a.tif", "--out"), "option '--out' requires an argument"),
        (("nonsense",), "no such command 'nonsense'"),
        (("evaluate", "a.gpkg", "b.gpkg", "c.gpkg"), "got unexpected extra argument"),
    ],
)
def test_usage(monkeypatch, capsys, arguments, line):
    code, error = run(monkeypatch, capsys, *arguments)
    assert code == 2
    assert error.startswith(f"tilepipe: error: {line}")
    assert len(error.splitlines()) == 1
    assert error.rstrip().endswith("--help")


def test_evaluate_takes_tables(monkeypatch, capsys, tmp_path, good):
    code, error = run(monkeypatch, capsys, "evaluate", good, good)
    assert code == 2
    assert "the result" in error and "good.tif cannot be read as lines or polygons; give a layer of a run" in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"crs": "EPSG:32634"}, "its CRS (EPSG:32634) differs"),
        ({"pixel": 2.0}, "pixel size 2.0 differs"),
        ({"origin": (500000.4, 5000000.0)}, "do not line up"),
    ],
)
def test_tiles_that_do_not_fit(monkeypatch, capsys, tmp_path, good, change, words):
    other = write_raster(tmp_path / "other.tif", VALUES, **change)
    error = refused(monkeypatch, capsys, tmp_path / "run", good, other)
    assert words in error
    assert "other.tif" in error


def test_no_crs(monkeypatch, capsys, tmp_path):
    raster = write_raster(tmp_path / "a.tif", VALUES, crs=None)
    assert "a.tif: has no coordinate reference system; pass --crs" in refused(
        monkeypatch, capsys, tmp_path / "run", raster
    )


def test_geographic_crs(monkeypatch, capsys, tmp_path):
    raster = write_raster(tmp_path / "a.tif", VALUES, crs="EPSG:4326", pixel=1e-5, origin=(4.0, 52.0))
    message = refused(monkeypatch, capsys, tmp_path / "run", raster)
    assert "is in degrees" in message
    assert "--dst-crs EPSG:32631" in message


@pytest.mark.parametrize(
    ("transform", "words"),
    [
        (Affine(1, 0.2, 0, 0.2, -1, 0), "rotated"),
        (Affine(1, 0, 500000, 0, 1, 5000000), "north-up"),
        (Affine(1, 0, 0, 0, -2, 0), "not square"),
    ],
)
def test_grids_that_are_not_north_up_and_square(monkeypatch, capsys, tmp_path, transform, words):
    raster = write_raster(tmp_path / "a.tif", VALUES, transform=transform)
    assert words in refused(monkeypatch, capsys, tmp_path / "run", raster)


def test_all_nodata_and_single_values(monkeypatch, capsys, tmp_path):
    raster = write_raster(tmp_path / "a.tif", np.full(SHAPE, -1, np.float32), nodata=-1)
    assert "nothing but nodata" in refused(monkeypatch, capsys, tmp_path / "run", raster)
    raster = write_raster(tmp_path / "b.tif", np.full(SHAPE, 7, np.uint8))
    assert "single value 7" in refused(monkeypatch, capsys, tmp_path / "run2", raster)


def test_one_pixel(monkeypatch, capsys, tmp_path):
    raster = write_raster(tmp_path / "a.tif", VALUES[:1, :1])
    assert "1 × 1 pixels" in refused(monkeypatch, capsys, tmp_path / "run", raster)


def test_several_bands(monkeypatch, capsys, tmp_path):
    import rasterio

    with rasterio.open(
        tmp_path / "rgb.tif",
        "w",
        driver="GTiff",
        width=5,
        height=5,
        count=3,
        dtype="uint8",
        crs="EPSG:32633",
        transform=Affine(1, 0, 0, 0, -1, 0),
    ) as dataset:
        dataset.write(np.zeros((3, 5, 5), np.uint8))
    assert "3 bands; choose one with --band" in refused(monkeypatch, capsys, tmp_path / "run", tmp_path / "rgb.tif")


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("time_step=0.6", "time_step 0.6 is unstable: use at most 0.5"),
        ("rectangle_rows=2", "rectangle_rows=2: must be odd"),
        ("tolerancy=3", "'tolerancy' is unknown; did you mean 'tolerance'"),
        ("tolerance=-1", "tolerance=-1"),
        ("tolerance=much", "tolerance='much'"),
        ("high=0.1", "low (0.2) must not exceed high"),
        ("tolerance", "write --set name=value"),
        ("low=0", "low=0"),
        ("void_reach=inf", "void_reach=inf"),
        ("darkness=nan", "darkness=nan"),
        ("closing_radius=inf", "closing_radius=inf"),
        ("maximum_width=40000", "maximum_width=40000"),
    ],
)
def test_parameters(monkeypatch, capsys, tmp_path, good, setting, words):
    assert words in refused(monkeypatch, capsys, tmp_path / "run", good, "--set", setting)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--memory", "1MiB"), "use a larger --memory"),
        (("--memory", "lots"), "memory 'lots'"),
        (("--tile", "0"), "tile size 0"),
        (("--workers", "0"), "0 workers"),
        (("--executor", "fibers"), "executor 'fibers'"),
        (("--backend", "cupy"), "backend 'cupy'"),
        (("--format", "shp"), "format 'shp'"),
        (("--crs", "EPSG:n"), None),
    ],
)
def test_options(monkeypatch, capsys, tmp_path, good, option, words):
    # as on a machine without a GPU, where nothing simulates one
    monkeypatch.setenv("NUMBA_ENABLE_CUDASIM", "0")
    if words is None:
        code, _ = run(monkeypatch, capsys, "streets", good, "--out", tmp_path / "run", "--help")
        assert code == 0
    else:
        assert words in refused(monkeypatch, capsys, tmp_path / "run", good, *option)


def test_a_refusal_leaves_a_finished_run_as_it_was(monkeypatch, capsys, tmp_path, good):
    out = tmp_path / "run"
    assert run(monkeypatch, capsys, "streets", good, "--out", out, "--quiet")[0] == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    void = write_raster(tmp_path / "void.tif", np.full(SHAPE, -1, np.float32), nodata=-1)
    for arguments in ((good, "--memory", "1MiB"), (void,)):
        code, _ = run(monkeypatch, capsys, "streets", *arguments, "--out", out, "--overwrite", "--quiet")
        assert code == 2
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_heights_elsewhere(monkeypatch, capsys, tmp_path, good):
    far = write_raster(tmp_path / "far.tif", VALUES, origin=(600000.0, 5000000.0))
    assert "does not overlap" in refused(monkeypatch, capsys, tmp_path / "run", good, "--height", far)


def test_unwritable_folder(monkeypatch, capsys, tmp_path, good):
    (tmp_path / "file").write_text("")
    assert "file" in refused(monkeypatch, capsys, tmp_path / "file" / "run", good)
    assert "is a file" in refused(monkeypatch, capsys, tmp_path / "file", good)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    assert "not empty" in refused(monkeypatch, capsys, tmp_path / "mine", good)


def test_full_disk(monkeypatch, capsys, tmp_path, good):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=60k", "tmpfs", disk], check=False, capture_output=True
    )
    if mounted.returncode:
        pytest.skip("a small file system can be mounted by root only")
    try:
        settings = [part for name, value in SMALL.items() for part in ("--set", f"{name}={value}")]
        code, error = run(monkeypatch, capsys, "streets", good, "--out", disk / "run", "--quiet", *settings)
        assert code in (1, 2)
        assert len(error.strip().splitlines()) == 1
        assert "No space left" in error or "full" in error
        assert not (disk / "run" / "streets.tif").exists()
    finally:
        subprocess.run(["umount", disk], check=True)


def test_a_failed_tile_exits_with_1(monkeypatch, capsys, tmp_path, good):
    def failing(*_, **__):
        raise RuntimeError("broken memory")

    monkeypatch.setattr(pass_segment.growing, "grow_regions", failing)
    code, error = run(monkeypatch, capsys, "streets", good, "--out", tmp_path / "run", "--quiet")
    assert code == 1
    assert "broken memory" in error
    assert len(error.strip().splitlines()) == 1


def test_infinities_are_nodata(monkeypatch, capsys, tmp_path):
    import rasterio

    values = VALUES.copy()
    values[5:8, 5:8] = np.inf
    raster = write_raster(tmp_path / "a.tif", values)
    code, error = run(monkeypatch, capsys, "streets", raster, "--out", tmp_path / "run", "--quiet")
    assert code == 0, error
    with rasterio.open(tmp_path / "run" / "streets.tif") as dataset:
        ids = dataset.read(1)
        assert (ids[5:8, 5:8] == dataset.nodata).all()
        assert (ids == dataset.nodata).sum() == 9


def test_no_command_writes_to_a_url(monkeypatch, capsys, tmp_path, good):
    """Nor makes a local folder named as its beginning."""
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    for out in ("s3://bucket/run", "http://host/run", "/vsis3/bucket/run"):
        for arguments in (
            ("streets", good, "--out", out),
            ("grid", good, "--out", f"{out}.tif"),
            ("report", out),
            ("demo", "--out", out, "--size", 256),
            ("city", out, "--size", 512),
        ):
            code, error = run(monkeypatch, capsys, *arguments, *(() if arguments[0] == "report" else ("--quiet",)))
            assert (code, len(error.splitlines())) == (2, 1), error
            assert error.startswith(f"tilepipe: error: {out}"), error
            assert "results are written to a local disk" in error
    assert sorted(tmp_path.iterdir()) == before


def test_a_server_that_does_not_answer(monkeypatch, capsys, tmp_path, good):
    for option in ((), ("--height",)):
        rasters = (good, *option, "http://127.0.0.1:1/a.tif") if option else ("http://127.0.0.1:1/a.tif",)
        error = refused(monkeypatch, capsys, tmp_path / "run", *rasters)
        assert "http://127.0.0.1:1/a.tif: cannot be opened (" in error
        assert "check the address" in error
    code, error = run(monkeypatch, capsys, "evaluate", "http://127.0.0.1:1/a.gpkg", good)
    assert code == 2
    assert "http://127.0.0.1:1/a.gpkg lies on a server; download it first" in error


@pytest.mark.parametrize("name", ["/vsizip/town.zip/a.gpkg", "zip://town.zip!a.gpkg", "/vsitar/town.tar/a.gpkg"])
def test_what_lies_in_an_archive_is_to_be_unpacked(monkeypatch, capsys, tmp_path, good, name):
    for arguments in (("evaluate", name, good), ("grid", name, "--out", tmp_path / "o.tif")):
        code, error = run(monkeypatch, capsys, *arguments)
        assert (code, len(error.splitlines())) == (2, 1)
        assert name in error
        assert "lies in an archive; unpack it first" in error
