"""Gridding of point clouds, and its peers; one point per cell on average, at random."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure.contest import Call, Case, Contestant
from tilepipe_kernels.points.gridding import Method, grid_points
from tilepipe_kernels.points.gridding import halo as gridding_halo
from tilepipe_kernels.points.point_tiles import sort_by_tile, subcells

CELL, SCALE = 0.5, 0.001
CHUNK = 500_000
"""Points dealt out to tiles at once, as `tilepipe grid` does."""
REACH = 3.0
"""In cells; of 1,000 random cells without a point fewer than one is farther from the next point."""


@lru_cache(maxsize=1)
def _points(size: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Rows, columns and heights as a LAS file holds them: integers of a millimetre."""
    random = np.random.default_rng(5)
    along = size * CELL / SCALE
    y, x = (random.integers(0, int(along), size**2, np.int32) for _ in range(2))
    z = (100_000 + 20_000 * np.sin(x * (20 / along)) + random.normal(0, 50, size**2)).astype(np.int32)
    return y, x, z


def gridding_case(size: int, method: Method) -> Case:
    """Points to cells of half a metre with voids filled; three integers a point in, one double a cell out."""
    peers = {
        "nearest": [Contestant("scipy cKDTree", lambda: _tree(size), note="of the nearest point, at any distance")],
        "mean": [Contestant("bincount and EDT fill", lambda: _bincount(size), serial=True)],
    }
    return Case(
        f"gridding, {method}",
        "Mpoints/s",
        size**2 / 1e6,
        size**2 * (12 + 8),
        [
            Contestant(
                "tilepipe grid_points",
                lambda: _ours(size, method),
                ours=True,
                note="tiling of points included",
            ),
            *peers[method],
        ],
        aim=15,
    )


def _ours(size: int, method: Method) -> Call:
    y, x, z = _points(size)
    margin = gridding_halo(method, REACH)
    side = 1 << max(1, (size // 2 - 1).bit_length())
    tiles = -(-size // side)

    def dealt(start: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
        rows, columns = (subcells(raw[start : start + CHUNK], SCALE, 0.0, CELL) for raw in (y, x))
        values = z[start : start + CHUNK]
        return sort_by_tile(rows, columns, values, origin=(0, 0), tiles=(tiles, tiles), side=side, margin=margin)

    def run(workers: int) -> Any:
        with ThreadPoolExecutor(workers) as pool:
            chunks = list(pool.map(dealt, range(0, size**2, CHUNK)))

            def tile(number: int) -> NDArray[np.float64]:
                own = np.concatenate([points[starts[number] : starts[number + 1]] for points, starts in chunks])
                return grid_points(own, (side, side), method=method, reach=REACH)

            return list(pool.map(tile, range(tiles**2)))

    return run


def _tree(size: int) -> Call:
    from scipy.spatial import cKDTree

    y, x, z = _points(size)
    row, column = np.mgrid[0:size, 0:size]
    centres = np.column_stack([row.ravel() + 0.5, column.ravel() + 0.5])

    def run(workers: int) -> Any:
        places = np.column_stack([y, x]) * (SCALE / CELL)
        tree = cKDTree(places, balanced_tree=False, compact_nodes=False)
        return z[tree.query(centres, workers=workers)[1]].reshape(size, size)

    return run


def _bincount(size: int) -> Call:
    from scipy.ndimage import distance_transform_edt

    y, x, z = _points(size)

    def run(workers: int) -> Any:
        cell = (y * (SCALE / CELL)).astype(np.int64) * size + (x * (SCALE / CELL)).astype(np.int64)
        count, total = np.bincount(cell, minlength=size**2), np.bincount(cell, z, size**2)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(size, size)
        nearest = distance_transform_edt(count.reshape(size, size) == 0, return_distances=False, return_indices=True)
        return mean[tuple(nearest)]

    return run
