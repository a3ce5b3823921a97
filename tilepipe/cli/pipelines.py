"""A command for each pipeline, made of what the pipeline declares when it is asked for."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

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
from tilepipe.cli.records import run_record
from tilepipe.engine.inputs import Input
from tilepipe.errors import InputError
from tilepipe.io.files.record import parsed_toml
from tilepipe.pipelines import registry


class PipelineCommands(TyperGroup):
    """The commands, those of the pipelines among them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands, the pipelines first."""
        return [*registry.names(), *super().list_commands(ctx)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by its name, None for an unknown one."""
        command = super().get_command(ctx, cmd_name)
        if command is not None or not registry.is_known(cmd_name):
            return command
        try:
            return _pipeline_command(cmd_name)
        except InputError as error:
            # a package that cannot be used does not spoil the help of all others
            if ctx.meta.get(_LISTING):
                return _command(lambda: None, cmd_name, f"Cannot be used: {error}.")
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        ctx.meta[_LISTING] = True
        super().format_help(ctx, formatter)
        for complaint in registry.complaints():
            print(f"tilepipe: warning: {complaint}", file=sys.stderr)


_LISTING = "tilepipe.listing"
"""Mark of a context in which commands are only listed."""


def _pipeline_command(name: str) -> Any:
    """Command of a pipeline: rasters, options for its further inputs, and the options that all pipelines share."""
    summary, inputs = registry.face(name)
    _, _, rasters, out, *shared = inspect.signature(_carry_out, eval_str=True).parameters.values()
    own = [option for item in inputs for option in _input_options(item)]
    parameters = [item.replace(kind=inspect.Parameter.KEYWORD_ONLY) for item in (rasters, out, *own, *shared)]

    def command(**values: Any) -> None:
        further = {item.name: values.pop(item.option) or [] for item in inputs}
        bands = _given({item.band_option: values.pop(item.band_option) for item in inputs})
        _carry_out(name, further | bands, **values)

    return _command(command, name, summary, parameters)


def _input_options(item: Input) -> list[inspect.Parameter]:
    """The option of an input, and that of its band."""
    band = f"Band of --{item.option.replace('_', '-')} to use (from 1), where it has several."
    return [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
        for name, annotation in (
            (item.option, Annotated[list[str] | None, typer.Option(help=item.meaning, metavar="RASTER")]),
            (item.band_option, Annotated[int | None, typer.Option(help=band)]),
        )
    ]


def _command(
    function: Callable[..., None], name: str, summary: str, parameters: Sequence[inspect.Parameter] = ()
) -> Any:
    """A function as a command that takes the parameters."""
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(name, help=summary)(function)
    return typer.main.get_command(app)


def _carry_out(
    name: str,
    further: dict[str, Any],
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
        "inputs": {"rasters": list(rasters), **further, **_given({"crs": crs, "band": band})},
        "options": _given(options),
        "parameters": assignments(set_ or []),
    }
    run_record(record, overwrite=overwrite, quiet=quiet, plan_only=plan)


def _given(values: dict[str, Any]) -> dict[str, Any]:
    """Those that the user has given; a record holds no empty values."""
    return {name: value for name, value in values.items() if value is not None}


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
            values[name.strip()] = parsed_toml(f"value = {value}")["value"]
        except ValueError:
            values[name.strip()] = value
    return values
