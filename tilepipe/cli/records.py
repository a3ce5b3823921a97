"""The commands that work from the record of a run: repeat it, plan it, say how far it is."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tilepipe.cli.options import Overwrite, Quiet
from tilepipe.errors import InputError
from tilepipe.pipelines import registry

if TYPE_CHECKING:
    from tilepipe.engine.options import RunOptions
    from tilepipe.engine.pipeline import Pipeline


def run_record(record: dict[str, Any], *, overwrite: bool, quiet: bool, plan_only: bool = False) -> None:
    """Plan or run a pipeline as a record says.

    Raises
    ------
    InputError
        Something in the record cannot be used.
    """
    from tilepipe.cli.bars import progress_bars
    from tilepipe.engine.request import plan_pipeline
    from tilepipe.engine.work import run_pipeline
    from tilepipe.io.files.record import check_record

    check_record(record, "the record")
    pipeline = registry.pipeline(record["command"])
    inputs = record.get("inputs", {})
    arguments = _arguments(pipeline, inputs) | {
        "params": record.get("parameters", {}),
        "options": _run_options(record.get("options", {}), overwrite),
    }
    if plan_only:
        print(plan_pipeline(pipeline, inputs.get("rasters", []), **arguments).text())
        return
    out = Path(record.get("out", ""))
    if not record.get("out"):
        raise InputError("no folder for the run is named: give --out FOLDER")
    with progress_bars(quiet) as progress:
        layers = run_pipeline(pipeline, inputs.get("rasters", []), out, progress=progress, **arguments)
    if not quiet:
        for layer in layers:
            print(layer)


def _arguments(pipeline: Pipeline, inputs: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a run for the inputs of a record, but for its rasters."""
    further = [name for item in pipeline.inputs for name in (item.name, item.band_option)]
    known = ("rasters", *further, "crs", "band")
    name = pipeline.name
    if unknown := sorted(set(inputs) - set(known)):
        raise InputError(f"[inputs] of the record: {name} takes no '{unknown[0]}'; it takes {', '.join(known)}")
    return {
        "crs": inputs.get("crs"),
        "band": inputs.get("band"),
        "inputs": {name: inputs[name] for name in further if inputs.get(name)},
    }


def _run_options(options: dict[str, Any], overwrite: bool) -> RunOptions:
    from tilepipe.engine.options import RunOptions, parse_memory

    if isinstance(options.get("memory"), str):
        options = options | {"memory": parse_memory(options["memory"])}
    try:
        return RunOptions(**options, overwrite=overwrite)
    except TypeError as error:
        known = [item.name for item in fields(RunOptions) if item.name != "overwrite"]
        unknown = next((name for name in options if name not in known), str(error))
        raise InputError(f"[options] of the record: '{unknown}' is unknown; known are {', '.join(known)}") from None


def load_record(path: Path, out: Path | None) -> dict[str, Any]:
    """Read the record of a run; ``out`` is another folder than it names.

    Raises
    ------
    InputError
        The file is no record.
    """
    from tilepipe.io.files.record import KNOWN, read_record

    record = read_record(path)
    if unknown := sorted(set(record) - set(KNOWN)):
        raise InputError(f"{path}: '{unknown[0]}' is unknown; known are {', '.join(sorted(KNOWN))}")
    _check_command(path, record)
    return record | ({"out": str(out)} if out is not None else {})


def _check_command(path: Path, record: dict[str, Any]) -> None:
    command = record.get("command")
    if command is None or not registry.is_known(command):
        named = "names no command" if command is None else f"command '{command}' is unknown"
        raise InputError(f"{path}: {named}; use {' or '.join(registry.names())}")


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
    from tilepipe.engine.run_folder import status
    from tilepipe.io.files.record import RECORD, STATE

    found = status(folder)
    print(f"{folder}: {found['state']}")
    if found["state"] == "unfinished":
        record = folder / STATE / RECORD
        for name, total in _tiles_of_passes(record, found["record"]).items():
            print(f"  {name}: {found['passes'].get(name, 0)} of {total} tiles done")
        print(f"  resume with: tilepipe run {record}")
    elif found["state"] == "finished":
        for item in sorted(folder.iterdir()):
            print(f"  {item.name}  {item.stat().st_size:,} bytes")


def _tiles_of_passes(path: Path, record: dict[str, Any]) -> dict[str, int]:
    """Number of tiles of each pass of a run, by the record in a file."""
    from tilepipe.engine.request import setting_of_record

    _check_command(path, record)
    pipeline = registry.pipeline(record["command"])
    setting = setting_of_record(pipeline, record)
    return {item.name: len(pipeline.grid(setting)) for item in pipeline.needed_passes(setting)}
