"""The parts of README.md that follow from the code: its table of parameters, its commands, its examples."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path
from typing import Any

from tilepipe.street_parameters import StreetParameters

README = Path(__file__).resolve().parents[1] / "README.md"
START, END = "<!-- parameters: written by scripts/readme-parameters -->", "<!-- end of parameters -->"

# Units that the descriptions do not give in parentheses.
UNITS = {
    "lowest_percentile": "%",
    "highest_percentile": "%",
    "edge_gradient": "grey/pixel",
    "tolerance": "grey",
    "darkness": "grey",
}
_UNIT = re.compile(r" \((?:(\S+), )?(m²|m|degrees)\)")


def parameter_table() -> str:
    """The Markdown table of all parameters: name, default, unit, meaning."""
    rows = [("name", "default", "unit", "meaning"), ("---", "---:", "---", "---")]
    for name, field in StreetParameters.model_fields.items():
        meaning = field.description or ""
        unit = UNITS.get(name, "")
        if match := _UNIT.search(meaning):
            unit = match[2]
            meaning = _UNIT.sub(f" ({match[1]})" if match[1] else "", meaning, count=1)
        rows.append((f"`{name}`", shown(field.default), unit, meaning.replace("|", "\\|")))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def shown(value: Any) -> str:
    if value is None or isinstance(value, str):
        return str(value).lower()
    return "inf" if math.isinf(value) else f"{value:g}"


def with_table(text: str) -> str:
    """The text of the README with the table of today."""
    before, start, rest = text.partition(START)
    _, end, after = rest.partition(END)
    if not (start and end):
        raise ValueError(f"README.md must hold the lines {START} and {END}")
    return f"{before}{START}\n\n{parameter_table()}\n\n{END}{after}"


def code_blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands(text: str, program: str) -> list[list[str]]:
    """Arguments of every command line of a program, in blocks of code and inside the text."""
    lines = [
        line for block in code_blocks(text, "bash") for line in block.replace("\\\n", " ").splitlines()
    ] + re.findall(r"`([^`\n]+)`", text)
    split = [shlex.split(line, comments=True) for line in lines if line.startswith(f"{program} ")]
    return [words[1:] for words in split]


if __name__ == "__main__":
    README.write_text(with_table(README.read_text(encoding="utf-8")), encoding="utf-8")
