"""Items on their way: what a worker was given, and how often it has to be given again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Outcome = tuple[Item, Result | None, BaseException | None]

LIVES = 4
"""Workers that one item may cost before it fails: one, and the `allowed-failures: 3` of dask.distributed."""


@dataclass
class Attempt(Generic[Item]):
    """An item, and how the workers ended that have had it."""

    item: Item
    lost: list[str] = field(default_factory=list)


def name_of(item: Any) -> str:
    """What an item is called in messages; a tile has a name.

    Examples
    --------
    >>> from tilepipe.engine.tiles.workers.attempts import name_of
    >>> from tilepipe.tiling.grid import TileGrid
    >>> name_of(TileGrid((4, 6), (4, 3)).tile(1)), name_of(7)
    ('tile r0000c0001', 'item 7')
    """
    name = getattr(item, "name", None)
    return f"tile {name}" if name else f"item {item}"
