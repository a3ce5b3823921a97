"""Points of the network, gathered from the tiles that hold them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.network.chain_loops import copy_runs, expand_parts
from tilepipe_kernels.network.street_graph import Bool, Chains
from tilepipe_kernels.network.tracing import Fragments

Attributes = Mapping[str, NDArray[np.float32]]
LoadTile = Callable[[int], tuple[Fragments, Attributes]]


def gather(
    chains: Chains, load_tile: LoadTile, start: Int64, stop: Int64, backward: Bool
) -> tuple[Int64, dict[str, NDArray[np.float32]]]:
    """Points of parts, one part after the other; each tile concerned is loaded once.

    Parameters
    ----------
    chains
        The chains whose canonical positions the parts are.
    load_tile
        Gives the fragments and attributes of a tile, by its index in the tables given to ``join``.
    start, stop, backward
        Parts, shape (m,): canonical positions [start, stop), read from the end where ``backward``.

    Returns
    -------
    pixels, attributes
        Global flat indices, int64 of shape (total,), and float32 attributes of the same shape by name.

    Raises
    ------
    ValueError
        If the tiles concerned do not have the same attributes, or a tile is not the one that was joined.
    """
    slices = chains.slice_position, chains.slice_source, chains.slice_step
    source, step, count, target = expand_parts(start, stop, backward, *slices)
    tile_of_run = np.searchsorted(chains.tile_offsets, source, side="right") - 1
    order = np.argsort(tile_of_run, kind="stable")
    tiles, first = np.unique(tile_of_run[order], return_index=True)
    pixels = np.empty(int(count.sum()), np.int64)
    gathered: dict[str, NDArray[np.float32]] = {}
    for tile, runs in zip(tiles.tolist(), np.split(order, first[1:]), strict=False):
        fragments, attributes = _checked(chains, load_tile, tile)
        if not gathered:
            gathered = {name: np.empty(len(pixels), np.float32) for name in attributes}
        if attributes.keys() != gathered.keys():
            raise ValueError(f"tile {tile} has attributes {sorted(attributes)}, others {sorted(gathered)}")
        where = source[runs] - chains.tile_offsets[tile], step[runs], count[runs], target[runs]
        copy_runs(fragments.pixels, *where, pixels)
        for name, values in attributes.items():
            copy_runs(values, *where, gathered[name])
    return pixels, gathered


def pixels_at(chains: Chains, load_tile: LoadTile, positions: Int64) -> Int64:
    """Global flat indices of the pixels at canonical positions."""
    return gather(chains, load_tile, positions, positions + 1, np.zeros(len(positions), bool))[0]


def coordinates(pixels: Int64, attributes: Attributes, width: int) -> NDArray[np.float64]:
    """Points (x, y), shape (n, 2), in pixels from the upper left corner; pixel centres are at halves."""
    row, column = np.divmod(pixels, width)
    xy = np.stack([column, row], axis=1) + 0.5
    for axis, name in enumerate(("dx", "dy")):
        if name in attributes:
            xy[:, axis] += attributes[name]
    return xy


def tiles_of_slices(chains: Chains) -> Iterator[tuple[int, Int64]]:
    """Each tile that holds points, with its slices."""
    tile_of_slice = np.searchsorted(chains.tile_offsets, chains.slice_source, side="right") - 1
    order = np.argsort(tile_of_slice, kind="stable")
    tiles, first = np.unique(tile_of_slice[order], return_index=True)
    yield from zip(tiles.tolist(), np.split(order, first[1:]), strict=False)


def _checked(chains: Chains, load_tile: LoadTile, tile: int) -> tuple[Fragments, Attributes]:
    fragments, attributes = load_tile(tile)
    if len(fragments.pixels) != chains.tile_offsets[tile + 1] - chains.tile_offsets[tile]:
        raise ValueError(f"tile {tile} has changed since its fragments were joined; run the reconciliation again")
    return fragments, attributes
