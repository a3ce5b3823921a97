"""The command line: ``tilepipe COMMAND …``; heavy libraries are imported only by the command that needs them."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from typing import Annotated

import typer

from tilepipe import __version__
from tilepipe.cli import records, tools
from tilepipe.cli.pipelines import PipelineCommands
from tilepipe.cli.signals import Interruption, interruptible
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
    epilog="Exit codes: 0 done, 1 some tile failed, 2 bad usage or input, 130 interrupted (Ctrl-C, SIGTERM, SIGHUP): "
    "run the same command again to resume. A second signal ends it at once.",
)

_BEGIN_ANEW = ("plan", "status", "grid", "evaluate", "report", "city")
"""Commands that leave nothing to resume."""

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
    if isinstance(context.obj, Interruption):
        context.obj.resumable = context.invoked_subcommand not in _BEGIN_ANEW
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit(BAD_INPUT)


def main() -> None:
    """Entry point: errors become one line and an exit code."""
    keep_freed_memory()
    # a warning is one line for people here, as an error is
    warnings.showwarning = lambda message, *_, **__: print(f"tilepipe: warning: {message}", file=sys.stderr)
    with interruptible() as interruption:
        try:
            code = app(prog_name="tilepipe", standalone_mode=False, obj=interruption) or DONE
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except Exception as error:
            # what goes wrong after an interruption goes wrong because of it
            code = INTERRUPTED if interruption.received else _failure(error)
    # typer turns an interruption into this code, without a word
    if code == INTERRUPTED:
        how = " to resume" if interruption.resumable else ""
        _tell(f"interrupted; run the same command again{how}")
    sys.exit(code)


def _failure(error: Exception) -> int:
    """One line for an error, and the exit code."""
    if isinstance(error, _UsageError):
        message, code = _usage(error), BAD_INPUT
    elif os.environ.get("TILEPIPE_DEBUG"):
        raise error
    elif isinstance(error, InputError | TileError):
        # an input may turn out to be unusable only when a tile reads it
        bad_input = isinstance(error, InputError) or isinstance(error.__cause__, InputError)
        message, code = str(error), BAD_INPUT if bad_input else FAILED
    elif isinstance(error, OSError):
        message, code = f"{error.filename or 'a file'}: {error.strerror or error}", BAD_INPUT
    else:
        raise error
    # a name in it may hold line breaks
    _tell(f"error: {' '.join(message.splitlines())}")
    return code


def _tell(line: str) -> None:
    # the terminal may be what has gone
    with suppress(OSError):
        print(f"tilepipe: {line}", file=sys.stderr, flush=True)


def _usage(error: Exception) -> str:
    """One line for what is wrong with a command line."""
    message = " ".join(error.format_message().split()).rstrip(".")  # type: ignore[attr-defined]
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "tilepipe"
    return f"{message[:1].lower()}{message[1:]}; see {path} --help"
