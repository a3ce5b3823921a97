"""The command line: ``tilepipe COMMAND …``; heavy libraries are imported only by the command that needs them."""

from __future__ import annotations

import json
import os
import sys
import tomllib
import warnings
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

from tilepipe import __version__
from tilepipe.allocator import keep_freed_memory
from tilepipe.errors import InputError, TileError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Street, object and edge layers from city-wide rasters: tile by tile, without seams.",
)

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

Rasters = Annotated[list[Path], typer.Argument(help="Rasters (GeoTIFF, COG, VRT, Zarr); several are one mosaic.")]
Out = Annotated[Path, typer.Option(help="Folder of the run.")]
Tile = Annotated[int, typer.Option(help="Tile size in pixels.")]
Workers = Annotated[int | None, typer.Option(help="Threads or processes; all cores by default.")]
ExecutorName = Annotated[str, typer.Option("--executor", help="threads, processes, or tcp://host:port of a cluster.")]
Backend = Annotated[str, typer.Option(help="auto, numpy or cupy.")]
Memory = Annotated[str, typer.Option(help="Most memory to use, checked before work starts.")]
Seed = Annotated[int, typer.Option(help="Seed of random draws.")]
Crs = Annotated[str | None, typer.Option(help="EPSG:n for inputs that name no CRS.")]
Format = Annotated[str, typer.Option("--format", help="parquet, gpkg, fgb or geojson.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a finished run.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only errors.")]
Band = Annotated[int | None, typer.Option(help="Band to use where a raster has several.")]
Set = Annotated[list[str] | None, typer.Option("--set", help="A parameter as name=value; repeatable.")]


def _version(wanted: bool) -> None:
    if wanted:
        print(f"tilepipe {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show it.")] = False,
) -> None:
    """Options before the command."""


@app.command()
def streets(
    rasters: Rasters,
    out: Annotated[Path | None, typer.Option(help="Folder of the run; not needed with --plan.")] = None,
    height: Annotated[
        list[Path] | None,
        typer.Option(help="Height raster (DSM) on the same grid, to leave out trees and roofs."),
    ] = None,
    tile: Tile = 2048,
    workers: Workers = None,
    executor: ExecutorName = "threads",
    backend: Backend = "auto",
    memory: Memory = "8GiB",
    seed: Seed = 0,
    crs: Crs = None,
    band: Band = None,
    format: Format = "parquet",
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    set_: Set = None,
    plan: Annotated[bool, typer.Option("--plan", help="Show tiles, passes, halos and memory, and stop.")] = False,
) -> None:
    """Street centerlines from lidar intensity (dark streets), by ridge lines and by skeleton."""
    inputs: dict[str, Any] = {"rasters": [str(p) for p in rasters], "heights": [str(p) for p in height or []]}
    record = _record("streets", out, inputs, crs, band, set_) | {
        "options": _options(tile, workers, executor, backend, memory, seed, format)
    }
    _run_record(record, overwrite=overwrite, quiet=quiet, plan_only=plan)


@app.command()
def objects(
    rasters: Rasters,
    out: Annotated[Path | None, typer.Option(help="Folder of the run; not needed with --plan.")] = None,
    tile: Tile = 2048,
    workers: Workers = None,
    executor: ExecutorName = "threads",
    backend: Backend = "auto",
    memory: Memory = "8GiB",
    seed: Seed = 0,
    crs: Crs = None,
    band: Band = None,
    format: Format = "parquet",
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    set_: Set = None,
    plan: Annotated[bool, typer.Option("--plan", help="Show tiles, passes, halos and memory, and stop.")] = False,
) -> None:
    """Object polygons from lidar heights, and the probability of every boundary between them."""
    record = _record("objects", out, {"rasters": [str(p) for p in rasters]}, crs, band, set_) | {
        "options": _options(tile, workers, executor, backend, memory, seed, format)
    }
    _run_record(record, overwrite=overwrite, quiet=quiet, plan_only=plan)


def _record(
    command: str, out: Path | None, inputs: dict[str, Any], crs: str | None, band: int | None, set_: list[str] | None
) -> dict[str, Any]:
    """A record of what a command line asks for, but its options."""
    named = {name: value for name, value in (("crs", crs), ("band", band)) if value}
    return {
        "command": command,
        "out": str(out) if out else "",
        "inputs": inputs | named,
        "parameters": _assignments(set_ or []),
    }


def _options(
    tile: int, workers: int | None, executor: str, backend: str, memory: str, seed: int, format: str
) -> dict[str, Any]:
    options: dict[str, Any] = {
        "tile": tile,
        "executor": executor,
        "backend": backend,
        "memory": memory,
        "seed": seed,
        "format": format,
    }
    return options | ({"workers": workers} if workers is not None else {})


def _assignments(texts: list[str]) -> dict[str, Any]:
    """Named values of ``--set name=value``; a value is read as TOML, else as text."""
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"--set {text}: write --set name=value")
        try:
            values[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            values[name.strip()] = value
    return values


_PIPELINES = ("streets", "objects")


def _run_record(record: dict[str, Any], *, overwrite: bool, quiet: bool, plan_only: bool = False) -> None:
    """Plan or run a pipeline as a record says."""
    from importlib import import_module

    from tilepipe.options import RunOptions, parse_memory
    from tilepipe.progress import progress_bars

    command = record["command"]
    pipeline = import_module(f"tilepipe.{command}")
    for name in ("inputs", "options", "parameters"):
        if not isinstance(record.get(name, {}), dict):
            raise InputError(f"the record's '{name}' is no table: write [{name}]")
    inputs, options = dict(record.get("inputs", {})), dict(record.get("options", {}))
    if isinstance(options.get("memory"), str):
        options["memory"] = parse_memory(options["memory"])
    try:
        run_options = RunOptions(**options, overwrite=overwrite)
    except TypeError as error:
        raise InputError(f"[options] of the record: {str(error).partition(') ')[2]}; remove it") from None
    arguments: dict[str, Any] = {
        "params": record.get("parameters", {}),
        "crs": inputs.get("crs"),
        "band": inputs.get("band"),
        "options": run_options,
    }
    if command == "streets":
        arguments["height"] = inputs.get("heights") or None
    elif inputs.get("heights"):
        raise InputError(f"the record's inputs name 'heights', which {command} does not take; put them in 'rasters'")
    if plan_only:
        print(getattr(pipeline, f"plan_{command}")(inputs.get("rasters", []), **arguments).text())
        return
    out = Path(record.get("out", ""))
    if not record.get("out"):
        raise InputError("no folder for the run is named: give --out FOLDER")
    # a warning is one line for people here, as an error is
    warnings.showwarning = lambda message, *_, **__: print(f"tilepipe: warning: {message}", file=sys.stderr)
    with progress_bars(quiet) as progress:
        layers = getattr(pipeline, command)(inputs.get("rasters", []), out=out, progress=progress, **arguments)
    if not quiet:
        for layer in layers:
            print(layer)


_KNOWN = {"command", "version", "out", "inputs", "raster", "options", "parameters"}
"""Names and tables of a record."""


def _load_record(path: Path, out: Path | None) -> dict[str, Any]:
    from tilepipe.run import read_record

    record = read_record(path)
    if unknown := sorted(set(record) - _KNOWN):
        raise InputError(f"{path}: '{unknown[0]}' is unknown; known are {', '.join(sorted(_KNOWN))}")
    if record.get("command") not in _PIPELINES:
        raise InputError(f"{path}: command '{record.get('command')}' is unknown; use {' or '.join(_PIPELINES)}")
    if out is not None:
        record["out"] = str(out)
    return record


@app.command()
def run(
    record: Annotated[Path, typer.Argument(help="run.toml of a run, or one of your own.")],
    out: Annotated[Path | None, typer.Option(help="Another folder than the record names.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Repeat or resume a run from its record."""
    _run_record(_load_record(record, out), overwrite=overwrite, quiet=quiet)


@app.command()
def plan(record: Annotated[Path, typer.Argument(help="run.toml of a run, or one of your own.")]) -> None:
    """Show tiles, passes, halos and memory of a run before any work."""
    _run_record(_load_record(record, None), overwrite=False, quiet=True, plan_only=True)


@app.command()
def status(folder: Annotated[Path, typer.Argument(help="Folder of a run.")]) -> None:
    """Say what a run folder holds and how far an unfinished run is."""
    from importlib import import_module

    from tilepipe.run import STATE, status

    found = status(folder)
    print(f"{folder}: {found['state']}")
    if found["state"] == "unfinished":
        sizes = import_module(f"tilepipe.{found['record']['command']}").pass_sizes(found["record"])
        for name, total in sizes.items():
            print(f"  {name}: {found['passes'].get(name, 0)} of {total} tiles done")
        print(f"  resume with: tilepipe run {folder / STATE / 'run.toml'}")
    elif found["state"] == "finished":
        for item in sorted(folder.iterdir()):
            print(f"  {item.name}  {item.stat().st_size:,} bytes")


@app.command()
def grid(
    clouds: Annotated[list[Path], typer.Argument(help="LAS, LAZ or COPC files, or folders of them.")],
    out: Annotated[Path, typer.Option(help="GeoTIFF to write.")],
    resolution: Annotated[float, typer.Option(help="Cell size in metres.")] = 0.5,
    value: Annotated[Literal["height", "intensity"], typer.Option(help="What to grid.")] = "height",
    method: Annotated[
        Literal["nearest", "max", "min", "mean", "idw"], typer.Option(help="How a cell gets its value.")
    ] = "nearest",
    void_reach: Annotated[float, typer.Option(help="Fill voids from values within this reach (m).")] = 1.5,
    returns: Annotated[Literal["all", "first", "last"], typer.Option(help="Returns to use.")] = "all",
    idw_radius: Annotated[float | None, typer.Option(help="Radius of idw (m); the cell's diagonal by default.")] = None,
    classes: Annotated[str | None, typer.Option(help="Point classes to use, such as 2,6.")] = None,
    crs: Crs = None,
    memory: Memory = "2GiB",
    workers: Workers = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
    quiet: Quiet = False,
) -> None:
    """Grid lidar point clouds to a raster of heights or intensities."""
    from tilepipe.gridding import grid_clouds
    from tilepipe.options import parse_memory
    from tilepipe.passes import default_workers
    from tilepipe.progress import progress_bars

    with progress_bars(quiet) as progress:
        path = grid_clouds(
            clouds,
            out,
            resolution=resolution,
            value=value,
            method=method,
            void_reach=void_reach,
            idw_radius=idw_radius,
            returns=returns,
            classes=_numbers(classes),
            crs=crs,
            memory=parse_memory(memory),
            workers=workers or default_workers(),
            overwrite=overwrite,
            progress=progress,
        )
    if not quiet:
        print(path)


def _numbers(text: str | None) -> list[int] | None:
    try:
        return None if text is None else [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--classes {text}: write class numbers with commas, such as 2,6") from None


@app.command()
def evaluate(
    result: Annotated[Path, typer.Argument(help="Table of lines or polygons, or the folder of a run.")],
    truth: Annotated[Path, typer.Argument(help="Table of true lines or polygons.")],
    buffer: Annotated[float, typer.Option(help="Farthest match of lines, or of polygons' boundaries (m).")] = 3.0,
    area: Annotated[Path | None, typer.Option(help="Polygon table: score only inside.")] = None,
    direction: Annotated[float | None, typer.Option(help="Largest angle between matching lines (degrees).")] = None,
    overlap: Annotated[float, typer.Option(help="Polygons: share of an object's area that must match.")] = 0.5,
    minimum_area: Annotated[float, typer.Option(help="Polygons: score objects from this area also apart (m²).")] = 50.0,
    step: Annotated[float, typer.Option(help="Polygons: sampling of the boundaries (m).")] = 0.5,
    dissolve: Annotated[bool, typer.Option("--dissolve", help="Polygons: those that touch are one object.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable output.")] = False,
) -> None:
    """Score lines (Heipke et al. 1997) or polygons (Rutzinger et al. 2009): completeness, correctness, quality, RMS."""
    from tilepipe.evaluate import LineScore, both_polygons, evaluate
    from tilepipe.evaluate_areas import AreaScore, evaluate_areas

    score: LineScore | AreaScore
    if both_polygons(result, truth):
        if direction is not None:
            raise InputError("--direction is for lines; leave it out for polygons")
        score = evaluate_areas(
            result,
            truth,
            area,
            overlap=overlap,
            minimum_area=minimum_area,
            cutoff=buffer,
            step=step,
            dissolve=dissolve,
        )
    else:
        if dissolve:
            raise InputError("--dissolve is for polygons; leave it out for lines")
        score = evaluate(result, truth, buffer, area, direction_tolerance=direction)
    print(json.dumps(score.as_dict()) if as_json else score.summary())


@app.command()
def report(folder: Annotated[Path, typer.Argument(help="Folder of a finished run.")]) -> None:
    """Draw quick-look pictures of a run, and of streets a map page."""
    from tilepipe.object_quicklook import object_pictures
    from tilepipe.report import report

    for path in object_pictures(folder) if (folder / "regions.tif").is_file() else report(folder):
        print(path)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder of the demo.")] = Path("demo"),
    size: Annotated[int, typer.Option(help="Side of the synthetic city in pixels.")] = 2048,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Make a synthetic city, find its streets, score them, and draw them."""
    from tilepipe.demo import run_demo
    from tilepipe.progress import progress_bars

    with progress_bars(quiet) as progress:
        result = run_demo(out, size=size, seed=seed, progress=progress)
    print(result)


@app.command()
def city(
    out: Annotated[Path, typer.Argument(help="Folder to write.")],
    size: Annotated[int, typer.Option(help="Side in pixels.")] = 2048,
    resolution: Annotated[float, typer.Option(help="Pixel size in metres.")] = 0.5,
    layers: Annotated[str, typer.Option(help="Layers with commas: intensity,height,aerial,…")] = "intensity,height",
    seed: Seed = 0,
    workers: Workers = None,
    quiet: Quiet = False,
) -> None:
    """Write a seeded synthetic city of any size with its truth."""
    from tilepipe.passes import default_workers
    from tilepipe.progress import progress_bars
    from tilepipe.synthetic import City, write_city

    with progress_bars(quiet) as progress:
        paths = write_city(
            out,
            City(seed=seed, rows=size, columns=size, resolution=resolution),
            layers=tuple(layers.split(",")),
            workers=workers or default_workers(),
            progress=partial(progress, "city"),
        )
    if not quiet:
        for path in paths.values():
            print(path)


def main() -> None:
    """Entry point: errors become one line and an exit code."""
    keep_freed_memory()
    try:
        app()
    except (InputError, TileError) as error:
        if os.environ.get("TILEPIPE_DEBUG"):
            raise
        print(f"tilepipe: error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
    except OSError as error:
        if os.environ.get("TILEPIPE_DEBUG"):
            raise
        print(f"tilepipe: error: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        _stop_interrupted()
    except SystemExit as stopped:
        # typer turns an interruption into this code, without a word
        if stopped.code == INTERRUPTED:
            _stop_interrupted()
        raise


def _stop_interrupted() -> NoReturn:
    print("tilepipe: interrupted; run the same command again to resume", file=sys.stderr)
    sys.exit(INTERRUPTED)
