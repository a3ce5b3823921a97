"""The region adjacency graph of all leaves, from the leaves and contacts of the tiles."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.errors import InputError
from tilepipe.pipelines.objects.leaf_features import TICKS_PER_METRE, Relief
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid
from tilepipe.tiling.numbering import Numbering
from tilepipe.tiling.seams import seam_sides
from tilepipe_kernels.regions.contraction import RegionGraph, Statistics

_PLAUSIBLE = -500.0, 9000.0
"""Heights on land in metres."""


@dataclass(frozen=True)
class Leaves:
    """All leaves of a raster, ordered by their first pixel, and their graph.

    Attributes
    ----------
    first
        Lowest global index (row-major, in pixels) of each leaf, int64.
    rank
        Place in this order of every local leaf number, see `Numbering`, int32.
    numbering
        The local leaf numbers of all tiles.
    statistics
        Count, mean height in m, and spread in m².
    lowest, highest
        Lowest and highest pixel of each leaf in m, float32.
    relief
        What the leaves tell of buildings, if it is asked for.
    """

    first: NDArray[np.int64]
    rank: NDArray[np.int32]
    numbering: Numbering
    statistics: Statistics
    lowest: NDArray[np.float32]
    highest: NDArray[np.float32]
    relief: Relief | None

    def lookup(self, values: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Values of the leaves, by local leaf number."""
        return values[self.rank]


def join_leaves(run: Work, ledger: Ledger) -> tuple[Leaves, RegionGraph]:
    """Leaves of the raster and their graph; warns of heights that can hardly be meant.

    Raises
    ------
    InputError
        When the raster holds only nodata.
    """
    with run.timed("reconcile leaves"):
        name, facts = run.raster.names[0], ledger.all_facts()
        absurd = sum(int(found["absurd"][0]) for found in facts)
        leaves, graph = reconcile_leaves(run.grid, facts, run.parameters.split_deviation**2)
        if not leaves.first.size:
            raise InputError(f"{name}: holds nothing but nodata; check the file and its nodata value")
        _warn_of_heights(name, leaves, absurd)
        return leaves, graph


def _warn_of_heights(name: str, leaves: Leaves, absurd: int) -> None:
    """Say what heights can hardly be meant: another unit, or a nodata value that nobody has declared."""
    advice = "check the unit of the heights and the nodata value"
    if absurd:
        warnings.warn(f"{name}: {absurd:,} pixels hold no possible height and count as nodata; {advice}", stacklevel=4)
    low, high = float(leaves.lowest.min()), float(leaves.highest.max())
    if low < _PLAUSIBLE[0] or high > _PLAUSIBLE[1]:
        warnings.warn(f"{name}: heights from {low:,.0f} to {high:,.0f} m; {advice}", stacklevel=4)


def reconcile_leaves(grid: TileGrid, facts: list[Facts], largest_variance: float) -> tuple[Leaves, RegionGraph]:
    """Lay the leaves of all tiles end to end in the order of their first pixels and join their contacts.

    Parameters
    ----------
    grid
        Tiling.
    facts
        Facts of the pass `leaves`, by tile; emptied.
    largest_variance
        Variance in m² above which squares are split.  The smallest squares can exceed it, on walls and in trees:
        what they hold is no noise of one surface, so they count with this variance.

    Returns
    -------
    Leaves
        Nothing in it depends on the tiling.
    RegionGraph
        Their graph, spreads limited as said, borders in pixel sides; large, and of no use once they have merged.
    """
    # what has been taken over is given up at once, since all facts together are larger than all that is made of them
    numbering = Numbering.of_counts(np.array([f["first"].size for f in facts]))
    first = _taken(facts, "first")
    order = np.argsort(first, kind="stable")
    first = first[order]
    rank = np.empty(order.size, np.int32)
    rank[order] = np.arange(order.size, dtype=np.int32)
    edges, length = _joined([*_tile_contacts(facts, numbering, rank), *_seam_contacts(grid, facts, numbering, rank)])
    count, total, spread = (_taken(facts, name)[order].astype(np.float64) for name in ("count", "total", "squares"))
    mean = total / count
    total *= mean
    spread -= total
    del total
    np.maximum(spread, 0.0, out=spread)
    spread /= TICKS_PER_METRE**2
    mean /= TICKS_PER_METRE
    limited = Statistics(count, mean, np.minimum(spread, largest_variance * count))
    lowest, highest = (
        (_taken(facts, name)[order] / TICKS_PER_METRE).astype(np.float32) for name in ("lowest", "highest")
    )
    statistics, relief = Statistics(count, mean, spread), Relief.of_facts(facts, order)
    return Leaves(first, rank, numbering, statistics, lowest, highest, relief), RegionGraph(limited, edges, length)


def _taken(facts: list[Facts], name: str) -> NDArray[Any]:
    """A column of all tiles, taken out of their facts."""
    return np.concatenate([found.pop(name) for found in facts])


def _tile_contacts(
    facts: list[Facts], numbering: Numbering, rank: NDArray[np.int32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32]]]:
    for tile, found in enumerate(facts):
        ends = rank[numbering.globalise(tile, found.pop("edges"))]
        yield _keys(ends), found.pop("length").astype(np.int32)


def _seam_contacts(
    grid: TileGrid, facts: list[Facts], numbering: Numbering, rank: NDArray[np.int32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32]]]:
    for seam, a, b in seam_sides(grid, facts, "label"):
        both = (a > 0) & (b > 0)
        ends = [rank[numbering.globalise(tile, side[both])] for tile, side in ((seam.first, a), (seam.second, b))]
        keys, sides = np.unique(_keys(np.stack(ends, axis=1)), return_counts=True)
        yield keys, sides.astype(np.int32)


def _keys(ends: NDArray[np.int32]) -> NDArray[np.int64]:
    """An edge as one number, the lower leaf in its upper half."""
    keys: NDArray[np.int64] = (ends.min(axis=1).astype(np.int64) << 32) | ends.max(axis=1)
    return keys


def _joined(
    parts: list[tuple[NDArray[np.int64], NDArray[np.int32]]],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Edges sorted by their leaves, each once; two leaves can meet in a tile or on a seam, and never in both."""
    keys, length = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32), length[order]
