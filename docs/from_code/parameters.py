"""Tables of the parameters of a pipeline, from its model."""

from __future__ import annotations

import math
import re
from typing import Any

from pydantic import BaseModel

from docs.from_code.markdown import table
from tilepipe.pipelines import registry

MODELS: dict[str, type[BaseModel]] = {name: registry.pipeline(name).parameters for name in registry.OWN}

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
    """All parameters of a model: name, default, unit, meaning."""
    rows = []
    for name, field in model.model_fields.items():
        meaning = field.description or ""
        unit = UNITS.get(name, "")
        if match := _UNIT.search(meaning):
            unit = match[2]
            meaning = _UNIT.sub(f" ({match[1]})" if match[1] else "", meaning, count=1)
        rows.append((f"`{name}`", shown(field.default), unit, meaning))
    return table(("name", "default", "unit", "meaning"), rows, right=[1])


def shown(value: Any) -> str:
    """A default as it is written in TOML, or ``none``."""
    if value is None or isinstance(value, str | bool):
        return str(value).lower()
    return "inf" if math.isinf(value) else f"{value:g}"
