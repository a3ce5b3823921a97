"""Seam facts: what the two sides of a seam know about the pixels along it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Seam, TileGrid
from tilepipe_kernels.core.arrays import namespace

_SIDES = ("top", "bottom", "left", "right")


def edge_facts(name: str, core: NDArray[Any]) -> Facts:
    """The four outermost rows and columns of a core as facts named ``<name>:<side>``."""
    edges = core[0], core[-1], core[:, 0], core[:, -1]
    return {f"{name}:{side}": edge.copy() for side, edge in zip(_SIDES, edges, strict=True)}


def raster_borders(grid: TileGrid, number: int) -> tuple[bool, bool, bool, bool]:
    """Which sides (top, bottom, left, right) of a tile's core lie on the border of the raster."""
    core = grid.tile(number).core
    return core.top == 0, core.bottom == grid.shape[0], core.left == 0, core.right == grid.shape[1]


def touches_seam(labels: NDArray[np.int32], count: int, borders: tuple[bool, bool, bool, bool]) -> NDArray[np.bool_]:
    """Which labels 0 … ``count`` of a core reach a side that is not the raster's border; entry 0 is False."""
    xp = namespace(labels)
    touching: NDArray[np.bool_] = xp.zeros(count + 1, xp.bool_)
    for edge, on_border in zip((labels[0], labels[-1], labels[:, 0], labels[:, -1]), borders, strict=True):
        if not on_border:
            touching[edge] = True
    touching[0] = False
    return touching


def seam_edges(grid: TileGrid, facts: list[Facts], name: str) -> Iterator[tuple[Seam, NDArray[Any], NDArray[Any]]]:
    """For each seam the values of both sides along it, pixel by pixel, from `edge_facts` of all tiles."""
    for seam in grid.seams():
        before, after = ("right", "left") if seam.vertical else ("bottom", "top")
        yield seam, facts[seam.first][f"{name}:{before}"], facts[seam.second][f"{name}:{after}"]
