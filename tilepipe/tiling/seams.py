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


def border_facts(name: str, core: NDArray[Any]) -> Facts:
    """The outermost rows and columns of a core as facts named ``<name>:<side>``: top, bottom, left, right.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.tiling.seams import border_facts
    >>> {name: values.tolist() for name, values in border_facts("grey", np.array([[1, 2], [3, 4]])).items()}
    {'grey:top': [1, 2], 'grey:bottom': [3, 4], 'grey:left': [1, 3], 'grey:right': [2, 4]}
    """
    return {f"{name}:{side}": border.copy() for side, border in zip(_SIDES, _borders(core), strict=True)}


def _borders(core: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return core[0], core[-1], core[:, 0], core[:, -1]


def raster_borders(grid: TileGrid, number: int) -> tuple[bool, bool, bool, bool]:
    """Which sides (top, bottom, left, right) of a tile's core lie on the border of the raster.

    Examples
    --------
    >>> from tilepipe.tiling.grid import TileGrid
    >>> from tilepipe.tiling.seams import raster_borders
    >>> raster_borders(TileGrid((1000, 1500), (512, 512)), 1)  # the middle one of the upper row
    (True, False, False, False)
    """
    core = grid.tile(number).core
    return core.top == 0, core.bottom == grid.shape[0], core.left == 0, core.right == grid.shape[1]


def touches_seam(labels: NDArray[np.int32], count: int, borders: tuple[bool, bool, bool, bool]) -> NDArray[np.bool_]:
    """Which labels of a core reach a side that is not the raster's border.

    Parameters
    ----------
    labels
        int32, shape (rows, columns), 0 … ``count``; 0 belongs to no feature.
    count
        Number of features.
    borders
        See `raster_borders`.

    Returns
    -------
    ndarray of bool, shape (count + 1,)
        Entry 0 is False.

    Examples
    --------
    Of two regions of the upper left tile the second goes on to the right; the first touches the raster's border only.

    >>> import numpy as np
    >>> from tilepipe.tiling.seams import touches_seam
    >>> labels = np.array([[1, 0, 0], [1, 0, 2], [0, 0, 0]], np.int32)
    >>> touches_seam(labels, 2, borders=(True, False, True, False)).tolist()
    [False, False, True]
    """
    xp = namespace(labels)
    touching: NDArray[np.bool_] = xp.zeros(count + 1, xp.bool_)
    for border, of_raster in zip(_borders(labels), borders, strict=True):
        if not of_raster:
            touching[border] = True
    touching[0] = False
    return touching


def seam_sides(grid: TileGrid, facts: list[Facts], name: str) -> Iterator[tuple[Seam, NDArray[Any], NDArray[Any]]]:
    """For each seam the values of both sides along it, pixel by pixel.

    Parameters
    ----------
    grid
        Tiling.
    facts
        Facts of each tile in row-major order, with those of `border_facts`.
    name
        As given to `border_facts`.

    Yields
    ------
    seam, first, second
        The seam, and two arrays as long as it is: values of its first and of its second tile.

    Examples
    --------
    Two tiles side by side: the right column of the first meets the left column of the second.

    >>> import numpy as np
    >>> from tilepipe.tiling.grid import TileGrid
    >>> from tilepipe.tiling.seams import border_facts, seam_sides
    >>> grid, labels = TileGrid((2, 4), (2, 2)), np.array([[0, 1, 1, 0], [0, 2, 0, 3]])
    >>> facts = [border_facts("labels", labels[tile.core.slices]) for tile in grid.tiles()]
    >>> [(first.tolist(), second.tolist()) for _, first, second in seam_sides(grid, facts, "labels")]
    [([1, 2], [1, 0])]
    """
    for seam in grid.seams():
        before, after = ("right", "left") if seam.vertical else ("bottom", "top")
        yield seam, facts[seam.first][f"{name}:{before}"], facts[seam.second][f"{name}:{after}"]
