"""Facts: what a tile leaves for a reconciliation."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

Facts = dict[str, NDArray[Any]]
"""Small arrays about one tile, by name."""
