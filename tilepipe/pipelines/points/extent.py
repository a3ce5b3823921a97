"""The extent of a raster of points: that of the points that count, without those that have gone astray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import Cloud
from tilepipe.pipelines.points.survey import BLOCK_BITS, Blocks, Index, Survey, merged

_MOST_EMPTY = 100
"""Points so many times sparser, and a raster so many times larger than what its points cover, are hardly meant."""

_MANY_CELLS = 1_000_000_000
"""Rasters of no more cells are made however empty."""


@dataclass(frozen=True)
class Extent:
    """Cells of a raster of points.

    Attributes
    ----------
    origin
        Global row and column of the first cell.
    shape
        Rows and columns.
    points
        Number of points inside.
    boxes
        Of each cloud with points inside, first and last row and column of its cells, shape (clouds, 2, 2).
    owners
        Number of the cloud that each box belongs to.
    warning
        Says which points have gone astray and lie outside; None where none has.
    """

    origin: tuple[int, int]
    shape: tuple[int, int]
    points: int
    boxes: Index
    owners: tuple[int, ...]
    warning: str | None


@dataclass(frozen=True)
class _Places:
    """Sets of blocks that touch each other, in the order of their first blocks.

    ``first`` is the row and column of the first block of each, ``density`` its points in a block, ``lowest`` and
    ``highest`` the box of its cells.
    """

    first: Index
    points: Index
    density: NDArray[np.float64]
    lowest: Index
    highest: Index

    def box(self, chosen: NDArray[Any]) -> Index:
        """First and last row and column of the cells of some places."""
        return np.stack([self.lowest[chosen].min(axis=0), self.highest[chosen].max(axis=0)])

    def distances(self, box: Index) -> NDArray[np.float64]:
        """Cells between each place and a box."""
        gaps = np.maximum(0, np.maximum(self.lowest - box[1], box[0] - self.highest))
        distances: NDArray[np.float64] = np.hypot(gaps[:, 0], gaps[:, 1])
        return distances


def find_extent(clouds: Sequence[Cloud], survey: Survey, cell: float, resolution: float) -> Extent:
    """Extent of the points of a survey.

    Blocks with points that touch each other are a place.  The points of a place have gone astray if they are a hundred
    times sparser than those of the place with the most points, and the raster would be a hundred times larger for
    them: they lie outside the extent.

    Raises
    ------
    InputError
        If the raster would be huge and nearly empty all the same, for the places lie far apart.
    """
    places = _places(merged([blocks for blocks in survey.blocks if blocks is not None]))
    dense = places.density * _MOST_EMPTY >= places.density[places.points.argmax()]
    box = places.box(dense)
    larger = _cells(np.minimum(places.lowest, box[0]), np.maximum(places.highest, box[1])) / _cells(*box)
    astray = ~dense & (larger > _MOST_EMPTY)
    box = places.box(~astray)
    covered = float((places.points / places.density)[~astray].sum()) * (1 << 2 * BLOCK_BITS)
    describe = _Words(clouds, survey, places, cell, resolution)
    cells = float(_cells(*box))
    if cells > max(_MANY_CELLS, _MOST_EMPTY * covered):
        raise InputError(describe.too_empty(~astray, cells, covered))
    (top, left), (bottom, right) = box.tolist()
    inside = {number: part.box for number, blocks in enumerate(survey.blocks) if (part := _inside(blocks, box))}
    return Extent(
        (top, left),
        (bottom - top + 1, right - left + 1),
        int(places.points[~astray].sum()),
        np.array(list(inside.values())),
        tuple(inside),
        describe.astray(astray, box) if astray.any() else None,
    )


def _places(blocks: Blocks) -> _Places:
    """Blocks that touch each other by a side or a corner."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = blocks.places[:, 0], blocks.places[:, 1]
    keys = (rows << 32) + columns
    pairs = []
    for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
        wanted = ((rows + down) << 32) + columns + right
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        touching = np.flatnonzero(keys[found] == wanted)
        pairs.append(np.stack([touching, found[touching]]))
    one, other = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(keys), len(keys)))
    label = connected_components(graph, directed=False)[1]
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    points = np.add.reduceat(blocks.counts[order], starts)
    return _Places(
        first=blocks.places[order[starts]],
        points=points,
        density=points / np.diff(starts, append=len(order)),
        lowest=np.minimum.reduceat(blocks.lowest[order], starts),
        highest=np.maximum.reduceat(blocks.highest[order], starts),
    )


def _cells(lowest: Index, highest: Index) -> NDArray[np.float64]:
    """Number of cells of boxes, in floats, which do not overflow."""
    cells: NDArray[np.float64] = np.prod((highest - lowest + 1).astype(np.float64), axis=-1)
    return cells


def _inside(blocks: Blocks | None, box: Index) -> Blocks | None:
    """Blocks of a cloud that lie in a box, None where there are none."""
    if blocks is None:
        return None
    inside = ((blocks.lowest >= box[0]) & (blocks.highest <= box[1])).all(axis=1)
    return blocks.take(inside) if inside.any() else None


def _points(number: int) -> str:
    return f"{number:,} {'point' if number == 1 else 'points'}"


@dataclass(frozen=True)
class _Words:
    """Messages that name places by files, coordinates and kilometres."""

    clouds: Sequence[Cloud]
    survey: Survey
    places: _Places
    cell: float
    resolution: float

    def named(self, place: int) -> str:
        """The first cloud that has points at a place."""
        first = self.places.first[place]
        holders = (
            cloud.path
            for cloud, blocks in zip(self.clouds, self.survey.blocks, strict=True)
            if blocks is not None and (blocks.places == first).all(axis=1).any()
        )
        return str(next(holders))

    def at(self, place: int) -> str:
        """Coordinates of a place in whole units of the CRS."""
        row, column = self.places.lowest[place].tolist()
        return f"x {column * self.cell:.0f}, y {-row * self.cell:.0f}"

    def kilometres(self, cells: float) -> str:
        """A distance in cells as kilometres."""
        return f"{cells * self.resolution / 1000:,.1f} km"

    def astray(self, astray: NDArray[np.bool_], box: Index) -> str:
        """Which points lie outside the extent, and how far."""
        distances = np.where(astray, self.places.distances(box), -1.0)
        farthest, number = int(distances.argmax()), int(self.places.points[astray].sum())
        several = f" at {astray.sum():,} places, the farthest" if astray.sum() > 1 else ""
        return (
            f"{self.named(farthest)}: {_points(number)}{several} at {self.at(farthest)}, "
            f"{self.kilometres(distances[farthest])} from all others, {'is' if number == 1 else 'are'} left out"
        )

    def too_empty(self, kept: NDArray[np.bool_], cells: float, covered: float) -> str:
        """Which places lie far apart, and what can be done."""
        largest = int(np.where(kept, self.places.points, -1).argmax())
        own = self.places.box(np.array([largest]))
        distances = np.where(kept, self.places.distances(own), -1.0)
        farthest = int(distances.argmax())
        coarsest = math.ceil(self.resolution * math.sqrt(cells / _MANY_CELLS))
        return (
            f"{self.named(farthest)}: {_points(self.places.points[farthest])} at {self.at(farthest)}, "
            f"{self.kilometres(distances[farthest])} from most of {self.named(largest)}: the raster would have "
            f"{cells / 1e9:,.0f} Gpx, {cells / covered:,.0f} times what the clouds cover; grid clouds of one place at "
            f"a time, check the CRS of those that lie astray, or set --resolution {coarsest} or coarser"
        )
