"""The parts of README.md that follow from the code: its table of parameters, its commands, its examples."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.streets.parameters import StreetParameters

README = Path(__file__).resolve().parents[2] / "README.md"
START, END = "<!-- parameters of {}: written by scripts/readme-parameters -->", "<!-- end of parameters -->"
MODELS: dict[str, type[BaseModel]] = {
    "streets": StreetParameters,
    "objects": ObjectParameters,
    "edges": EdgeParameters,
}

# Units that the descriptions do not give in parentheses.
UNITS = {
    "lowest_percentile": "%",
    "highest_percentile": "%",
    "edge_gradient": "grey/pixel",
    "tolerance": "grey",
    "darkness": "grey",
    "variance": "m²",
}
_UNIT = re.compile(r" \((?:(\S+), )?(m²|m|degrees)\)")


def parameter_table(model: type[BaseModel]) -> str:
    """The Markdown table of all parameters of a pipeline: name, default, unit, meaning."""
    rows = [("name", "default", "unit", "meaning"), ("---", "---:", "---", "---")]
    for name, field in model.model_fields.items():
        meaning = field.description or ""
        unit = UNITS.get(name, "")
        if match := _UNIT.search(meaning):
            unit = match[2]
            meaning = _UNIT.sub(f" ({match[1]})" if match[1] else "", meaning, count=1)
        rows.append((f"`{name}`", shown(field.default), unit, meaning.replace("|", "\\|")))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def shown(value: Any) -> str:
    if value is None or isinstance(value, str | bool):
        return str(value).lower()
    return "inf" if math.isinf(value) else f"{value:g}"


def with_tables(text: str) -> str:
    """The text of the README with the tables of today."""
    for name, model in MODELS.items():
        mark = START.format(name)
        before, start, rest = text.partition(mark)
        _, end, after = rest.partition(END)
        if not (start and end):
            raise ValueError(f"README.md must hold the lines {mark} and {END}")
        text = f"{before}{mark}\n\n{parameter_table(model)}\n\n{END}{after}"
    return text


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
    README.write_text(with_tables(README.read_text(encoding="utf-8")), encoding="utf-8")
