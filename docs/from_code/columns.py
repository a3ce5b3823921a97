"""Tables of the columns of every layer, as the pipelines declare them."""

from __future__ import annotations

from docs.from_code.markdown import table
from tilepipe.engine.layers import TableLayer
from tilepipe.pipelines import registry

TABLES = {
    layer.name: layer
    for name in registry.OWN
    for layer in registry.pipeline(name).layers
    if isinstance(layer, TableLayer)
}
"""All tables by name."""


def column_table(name: str) -> str:
    """The columns of one table: name, type, unit, meaning."""
    columns = TABLES[name].columns.items()
    rows = [(f"`{column}`", declared.dtype, declared.unit, declared.meaning) for column, declared in columns]
    return table(("column", "type", "unit", "meaning"), rows)
