"""The command line: every command with its arguments and options, from the program itself."""

from __future__ import annotations

import re
from typing import Any

import typer

from docs.from_code.markdown import table
from tilepipe import cli
from tilepipe.pipelines import registry

EXIT_CODES = {
    cli.DONE: "done",
    cli.FAILED: "some tile failed; it is named, no layer is published, the finished tiles are kept for the next try",
    cli.BAD_INPUT: "an option, a parameter or an input cannot be used, or has changed; one line says what to do",
    cli.INTERRUPTED: "interrupted by Ctrl-C, SIGTERM or SIGHUP; the same command resumes; a second signal ends at once",
}


def command_group() -> Any:
    """The program as click sees it."""
    return typer.main.get_command(cli.app)


def exit_code_table() -> str:
    """Exit codes and what they mean."""
    return table(("code", "meaning"), ((str(code), meaning) for code, meaning in EXIT_CODES.items()))


def command_sections() -> str:
    """A section per command: usage, what it does, arguments and options."""
    group = command_group()
    context = typer.Context(group)
    # pipelines of other packages have pages of their own
    names = [*registry.OWN, *group.commands]
    return "\n\n".join(_section(name, group.get_command(context, name)) for name in names)


def _section(name: str, command: Any) -> str:
    context = typer.Context(command, info_name=name)
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    usage = " ".join(["tilepipe", name, *(_name(argument, context) for argument in arguments), "[OPTIONS]"])
    told = [" ".join(paragraph.split()) for paragraph in (command.help or "").split("\n\n")]
    rows = [(f"`{_name(parameter, context)}`", *_meaning(parameter, context)) for parameter in command.params]
    parts = [f"(command-{name})=", f"## {name}", *told, f"```text\n{usage}\n```"]
    return "\n\n".join([*parts, table(("argument or option", "default", "meaning"), rows)])


def _name(parameter: Any, context: Any) -> str:
    """Name and type of what is given, such as ``--tile <int>`` or ``<raster>…``."""
    name = str(parameter.get_help_record(context)[0])
    if parameter.param_type_name == "argument":
        return f"{name.split(maxsplit=1)[0].rstrip('.').upper()}{'…' if parameter.nargs == -1 else ''}"
    return re.sub(r"<list\[(\w+)\]>", lambda match: f"<{match[1].lower()}>", name)


def _meaning(parameter: Any, context: Any) -> tuple[str, str]:
    """Default and meaning."""
    text = str(parameter.get_help_record(context)[1])
    if match := re.search(r"\s*\[(?:default: (.*)|required)\]$", text):
        return (f"`{match[1]}`" if match[1] else "required"), text[: match.start()]
    return "", text
