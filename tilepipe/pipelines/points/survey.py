"""Where the points that count lie, found by reading them: headers often say something else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import Cloud
from tilepipe.io.clouds.points import PLACES, Chunk, PointFilter, raw_coordinates, read_points
from tilepipe.pipelines.points.in_order import in_order
from tilepipe_kernels.points.point_tiles import SUBCELL_BITS, subcells

BLOCK_BITS = 9
"""A block is 512 cells a side: that of the rasters written."""

_FURTHEST_INDEX = 2.0**31
_MOST_BLOCKS = 1_000_000
"""Blocks with points in one cloud (a few hundred bytes each while they are joined); more are no cloud of a place."""

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Blocks:
    """Blocks of cells with points of one cloud, or of several.

    Attributes
    ----------
    places
        Global row and column of each block, shape (blocks, 2), sorted, each once.
    counts
        Points in each, shape (blocks,).
    lowest, highest
        First and last row and column of the cells with points in each, shape (blocks, 2).
    """

    places: Index
    counts: Index
    lowest: Index
    highest: Index

    def __add__(self, other: Blocks) -> Blocks:
        """Both together."""
        return merged([self, other])

    def take(self, chosen: NDArray[Any]) -> Blocks:
        """Some of the blocks."""
        return Blocks(self.places[chosen], self.counts[chosen], self.lowest[chosen], self.highest[chosen])

    @property
    def box(self) -> Index:
        """First and last row and column of all cells with points, shape (2, 2)."""
        return np.stack([self.lowest.min(axis=0), self.highest.max(axis=0)])


@dataclass(frozen=True)
class Survey:
    """What reading the clouds has told.

    Attributes
    ----------
    blocks
        Of each cloud; None where none of its points counts.
    heights
        Lowest and highest of the points that count, in the unit of the clouds.
    """

    blocks: tuple[Blocks | None, ...]
    heights: tuple[float, float]


def merged(parts: Sequence[Blocks]) -> Blocks:
    """Blocks of several clouds or chunks together."""
    places = np.concatenate([part.places for part in parts])
    order = np.lexsort((places[:, 1], places[:, 0]))
    places = places[order]
    starts = np.flatnonzero(np.any(np.diff(places, axis=0, prepend=places[:1] - 1), axis=1))
    return Blocks(
        places[starts],
        np.add.reduceat(np.concatenate([part.counts for part in parts])[order], starts),
        np.minimum.reduceat(np.concatenate([part.lowest for part in parts])[order], starts),
        np.maximum.reduceat(np.concatenate([part.highest for part in parts])[order], starts),
    )


def survey_clouds(
    clouds: Sequence[Cloud],
    cell: float,
    point_filter: PointFilter,
    chunk_points: int,
    workers: int,
    progress: Callable[[int, int], None],
) -> Survey:
    """Read all clouds for the places of their points.

    Parameters
    ----------
    clouds
        At least one.
    cell
        Side of a cell in CRS units.
    point_filter
        Which points count.
    chunk_points, workers
        Points read at once; threads.
    progress
        Called with the points read and all.

    Raises
    ------
    InputError
        If a cloud is damaged, no point counts, or places are too far from the origin for cells of this size.
    """
    found: list[Blocks | None] = []
    lowest, highest = np.inf, -np.inf
    done, total = 0, sum(cloud.points for cloud in clouds)
    for cloud in clouds:
        own: Blocks | None = None
        chunks = read_points(cloud, PLACES, point_filter, chunk_points, workers > 1)
        for (read, _), part in in_order(partial(_of_chunk, cloud, cell), chunks, workers):
            if part is not None:
                blocks, heights = part
                own = blocks if own is None else own + blocks
                if len(own.counts) > _MOST_BLOCKS:
                    raise InputError(
                        f"{cloud.path}: its points are scattered over more than {_MOST_BLOCKS:,} blocks of "
                        f"{1 << BLOCK_BITS} cells a side; coarsen the resolution, or repair the file"
                    )
                lowest, highest = min(lowest, heights[0]), max(highest, heights[1])
            done += read
            progress(done, total)
        found.append(own)
    if all(blocks is None for blocks in found):
        raise InputError("no point passes the filter; check --classes and --returns")
    return Survey(tuple(found), (lowest, highest))


def _of_chunk(cloud: Cloud, cell: float, chunk: Chunk) -> tuple[Blocks, tuple[float, float]] | None:
    """Blocks and range of heights of the points of a chunk that count, if any."""
    _, points = chunk
    if not len(points):
        return None
    x, y = raw_coordinates(points)
    z = np.asarray(points.Z)
    heights = np.array([int(z.min()), int(z.max())]) * cloud.scales[2] + cloud.offsets[2]
    cells = np.stack([_cells(y, cloud, 1, -cell), _cells(x, cloud, 0, cell)], axis=1)
    places = cells >> BLOCK_BITS
    # points that follow each other mostly lie in one block
    starts = np.flatnonzero(np.any(np.diff(places, axis=0, prepend=places[:1] - 1), axis=1))
    runs = Blocks(
        places[starts],
        np.diff(starts, append=len(cells)),
        np.minimum.reduceat(cells, starts),
        np.maximum.reduceat(cells, starts),
    )
    return merged([runs]), (float(heights.min()), float(heights.max()))


def _cells(raw: NDArray[np.int32], cloud: Cloud, axis: int, cell: float) -> Index:
    """Global rows or columns of points."""
    ends = np.array([int(raw.min()), int(raw.max())]) * cloud.scales[axis] + cloud.offsets[axis]
    if not np.abs(ends / cell).max() < _FURTHEST_INDEX:
        raise InputError(
            f"{cloud.path}: the resolution is too fine for coordinates such as {np.abs(ends).max():.6g}; "
            "coarsen it, or repair the file if it has no points there"
        )
    return subcells(raw, cloud.scales[axis], cloud.offsets[axis], cell) >> SUBCELL_BITS
