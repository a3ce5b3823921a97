"""Labels of a state array under the numbers that a reconciliation has given them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.state import StateArray
from tilepipe.tiling.grid import Window
from tilepipe_kernels.regions.region_table import select_labels


def read_relabelled(labels: StateArray, lookup: Path, offsets: Sequence[int], window: Window) -> NDArray[np.uint32]:
    """Ids of a window of labels, put together from the tiles that it touches.

    Parameters
    ----------
    labels
        State array in which every tile numbers its features from 1 on; 0 = none.
    lookup
        File of a uint32 array: the id of every local feature number, tile after tile; see
        `tilepipe.tiling.numbering.Numbering`.
    offsets
        First entry of each tile in the lookup, and its length.
    window
        In pixels of the state array.

    Returns
    -------
    ndarray of uint32
        0 = none.
    """
    table = np.load(lookup, mmap_mode="r")
    ids = np.empty(window.shape, np.uint32)
    for tile in labels.grid.overlapping(window):
        part = tile.core.intersection(window)
        own = table[offsets[tile.number] : offsets[tile.number + 1]]
        renumbered = np.concatenate([np.zeros(1, np.uint32), own])
        ids[part.relative_to(window).slices] = select_labels(labels.read(part), renumbered)
    return ids
