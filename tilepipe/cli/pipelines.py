"""The commands that plan and carry out runs: one for each pipeline, and those that work from the record of a run."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tilepipe.cli.options import (
    Assignments,
    Backend,
    Band,
    Crs,
    ExecutorName,
    Format,
    Memory,
    Overwrite,
    PlanOnly,
    Quiet,
    Rasters,
    RunFolder,
    Seed,
    Tile,
    Workers,
)
from tilepipe.errors import InputError

if TYPE_CHECKING:
    from tilepipe.engine.options import RunOptions

_PIPELINES: dict[str, dict[str, str]] = {"streets": {"heights": "height"}, "objects": {}, "edges": {}}
"""The pipelines; for each input that a record may name beside the rasters, the argument of the pipeline."""

_TABLES = {"inputs", "raster", "options", "parameters"}
_KNOWN = {"command", "version", "out"} | _TABLES
"""Names and tables of a record."""

Inputs = dict[str, list[Path]]


def pipeline(own: Callable[..., Inputs]) -> Callable[..., None]:
    """Make a command of a pipeline, which takes rasters, the options of ``own``, and those that all pipelines share.

    ``own`` returns the files of its options by the names that a record gives them; its name is that of the pipeline.
    """
    own_parameters = inspect.signature(own, eval_str=True).parameters
    _, _, rasters, out, *shared = inspect.signature(_carry_out, eval_str=True).parameters.values()

    @wraps(own)
    def command(**values: Any) -> None:
        further = own(**{name: values.pop(name) for name in own_parameters})
        _carry_out(own.__name__, further, **values)

    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in (rasters, out, *own_parameters.values(), *shared)
    ]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _carry_out(
    name: str,
    further: Inputs,
    rasters: Rasters,
    out: RunFolder = None,
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
    set_: Assignments = None,
    plan: PlanOnly = False,
) -> None:
    """Carry out a pipeline as its command line says; the options here are those of every pipeline."""
    inputs: dict[str, Any] = {key: [str(path) for path in paths] for key, paths in further.items()}
    options = {
        "tile": tile,
        "workers": workers,
        "executor": executor,
        "backend": backend,
        "memory": memory,
        "seed": seed,
        "format": format,
    }
    record = {
        "command": name,
        "out": str(out) if out else "",
        "inputs": {"rasters": [str(path) for path in rasters], **inputs, **_given({"crs": crs, "band": band})},
        "options": _given(options),
        "parameters": assignments(set_ or []),
    }
    run_record(record, overwrite=overwrite, quiet=quiet, plan_only=plan)


def _given(values: dict[str, Any]) -> dict[str, Any]:
    """Those that the user has given; a record holds no empty values."""
    return {name: value for name, value in values.items() if value is not None}


@pipeline
def streets(
    height: Annotated[
        list[Path] | None,
        typer.Option(help="Height raster (DSM) on the same grid, to leave out trees and roofs."),
    ] = None,
) -> Inputs:
    """Street centerlines from lidar intensity (dark streets), by ridge lines and by skeleton."""
    return {"heights": height or []}


@pipeline
def objects() -> Inputs:
    """Object polygons from lidar heights, and the probability of every boundary between them."""
    return {}


@pipeline
def edges() -> Inputs:
    """Segmentation, line field and edge lines from aerial photographs, and Nevatia–Babu edges beside them."""
    return {}


def assignments(texts: list[str]) -> dict[str, Any]:
    """Named values of ``--set name=value``; a value is read as TOML, else as text.

    Raises
    ------
    InputError
        A text has another form.
    """
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


def run_record(record: dict[str, Any], *, overwrite: bool, quiet: bool, plan_only: bool = False) -> None:
    """Plan or run a pipeline as a record says.

    Raises
    ------
    InputError
        Something in the record cannot be used.
    """
    from importlib import import_module

    from tilepipe.cli.bars import progress_bars

    command = record["command"]
    for name in _TABLES:
        if not isinstance(record.get(name, {}), dict):
            raise InputError(f"the record's '{name}' is no table: write [{name}]")
    inputs = record.get("inputs", {})
    arguments = _arguments(command, inputs) | {
        "params": record.get("parameters", {}),
        "options": _run_options(record.get("options", {}), overwrite),
    }
    module = import_module(f"tilepipe.pipelines.{command}.recipe")
    if plan_only:
        print(getattr(module, f"plan_{command}")(inputs.get("rasters", []), **arguments).text())
        return
    out = Path(record.get("out", ""))
    if not record.get("out"):
        raise InputError("no folder for the run is named: give --out FOLDER")
    with progress_bars(quiet) as progress:
        layers = getattr(module, command)(inputs.get("rasters", []), out=out, progress=progress, **arguments)
    if not quiet:
        for layer in layers:
            print(layer)


def _arguments(command: str, inputs: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a pipeline for the inputs of a record, but for its rasters."""
    further = _PIPELINES[command]
    known = ("rasters", *further, "crs", "band")
    if unknown := sorted(set(inputs) - set(known)):
        raise InputError(f"[inputs] of the record: {command} takes no '{unknown[0]}'; it takes {', '.join(known)}")
    named: dict[str, Any] = {"crs": inputs.get("crs"), "band": inputs.get("band")}
    return named | {argument: inputs.get(name) or None for name, argument in further.items()}


def _run_options(options: dict[str, Any], overwrite: bool) -> RunOptions:
    from tilepipe.engine.options import RunOptions, parse_memory

    if isinstance(options.get("memory"), str):
        options = options | {"memory": parse_memory(options["memory"])}
    try:
        return RunOptions(**options, overwrite=overwrite)
    except TypeError as error:
        raise InputError(f"[options] of the record: {str(error).partition(') ')[2]}; remove it") from None


def load_record(path: Path, out: Path | None) -> dict[str, Any]:
    """Read the record of a run; ``out`` is another folder than it names.

    Raises
    ------
    InputError
        The file is no record.
    """
    from tilepipe.io.record import read_record

    record = read_record(path)
    if unknown := sorted(set(record) - _KNOWN):
        raise InputError(f"{path}: '{unknown[0]}' is unknown; known are {', '.join(sorted(_KNOWN))}")
    if record.get("command") not in _PIPELINES:
        raise InputError(f"{path}: command '{record.get('command')}' is unknown; use {' or '.join(_PIPELINES)}")
    return record | ({"out": str(out)} if out is not None else {})


def run(
    record: Annotated[Path, typer.Argument(help="run.toml of a run, or one of your own.")],
    out: Annotated[Path | None, typer.Option(help="Another folder than the record names.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Repeat or resume a run from its record."""
    run_record(load_record(record, out), overwrite=overwrite, quiet=quiet)


def plan(record: Annotated[Path, typer.Argument(help="run.toml of a run, or one of your own.")]) -> None:
    """Show tiles, passes, halos and memory of a run before any work."""
    run_record(load_record(record, None), overwrite=False, quiet=True, plan_only=True)


def status(folder: Annotated[Path, typer.Argument(help="Folder of a run.")]) -> None:
    """Say what a run folder holds and how far an unfinished run is."""
    from importlib import import_module

    from tilepipe.engine.run import STATE, status

    found = status(folder)
    print(f"{folder}: {found['state']}")
    if found["state"] == "unfinished":
        sizes = import_module(f"tilepipe.pipelines.{found['record']['command']}.recipe").pass_sizes(found["record"])
        for name, total in sizes.items():
            print(f"  {name}: {found['passes'].get(name, 0)} of {total} tiles done")
        print(f"  resume with: tilepipe run {folder / STATE / 'run.toml'}")
    elif found["state"] == "finished":
        for item in sorted(folder.iterdir()):
            print(f"  {item.name}  {item.stat().st_size:,} bytes")
