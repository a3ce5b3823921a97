"""The command line: ``tilepipe COMMAND …``; heavy libraries are imported only by the command that needs them."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Annotated, NoReturn

import typer

from tilepipe import __version__
from tilepipe.cli import records, tools
from tilepipe.cli.pipelines import PipelineCommands
from tilepipe.engine.tiles.allocator import keep_freed_memory
from tilepipe.errors import InputError, TileError

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""The base of what is wrong with a command line: a class of click, or of typer's own copy of it."""

app = typer.Typer(
    cls=PipelineCommands,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Street, object and edge layers from city-wide rasters: tile by tile, without seams.",
)

for _command in (
    records.run,
    records.plan,
    records.status,
    tools.grid,
    tools.evaluate,
    tools.report,
    tools.demo,
    tools.city,
):
    app.command()(_command)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"tilepipe {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _common(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show it.")] = False,
) -> None:
    """Options before the command."""
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit(BAD_INPUT)


def main() -> None:
    """Entry point: errors become one line and an exit code."""
    keep_freed_memory()
    # a warning is one line for people here, as an error is
    warnings.showwarning = lambda message, *_, **__: print(f"tilepipe: warning: {message}", file=sys.stderr)
    try:
        code = app(prog_name="tilepipe", standalone_mode=False) or DONE
    except _UsageError as error:
        _stop(_usage(error), BAD_INPUT)
    except (InputError, TileError) as error:
        if os.environ.get("TILEPIPE_DEBUG"):
            raise
        # an input may turn out to be unusable only when a tile reads it
        bad_input = isinstance(error, InputError) or isinstance(error.__cause__, InputError)
        _stop(str(error), BAD_INPUT if bad_input else FAILED)
    except OSError as error:
        if os.environ.get("TILEPIPE_DEBUG"):
            raise
        _stop(f"{error.filename or 'a file'}: {error.strerror or error}", BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    # typer turns an interruption into this code, without a word
    if code == INTERRUPTED:
        print("tilepipe: interrupted; run the same command again to resume", file=sys.stderr)
    sys.exit(code)


def _stop(message: str, code: int) -> NoReturn:
    print(f"tilepipe: error: {message}", file=sys.stderr)
    sys.exit(code)


def _usage(error: Exception) -> str:
    """One line for what is wrong with a command line."""
    message = " ".join(error.format_message().split()).rstrip(".")  # type: ignore[attr-defined]
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "tilepipe"
    return f"{message[:1].lower()}{message[1:]}; see {path} --help"
