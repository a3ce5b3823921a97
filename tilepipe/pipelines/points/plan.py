"""What gridding will do: options and headers checked before any point is read, then extent and tiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.windows import Window

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import Cloud, read_cloud
from tilepipe.io.clouds.crs import common_crs
from tilepipe.io.clouds.points import Value
from tilepipe.io.crs.ground import CLOUDS, ground_metres
from tilepipe.io.crs.systems import map_unit
from tilepipe.io.rasters.raster_crs import check_raster_crs
from tilepipe.pipelines.points.extent import Extent
from tilepipe_kernels.points.gridding import BYTES_PER_CELL, BYTES_PER_POINT, METHODS, Method
from tilepipe_kernels.points.gridding import halo as gridding_halo
from tilepipe_kernels.points.point_tiles import MAXIMUM_SIDE

_TILE, _SMALLEST_TILE = 1024, 512

MARK = np.dtype([("print", "<u8"), ("cloud", "<u4")])
"""What tells a point of a tile from its copies: fingerprint, and number of the cloud that it comes from."""

_BYTES_PER_MARK = MARK.itemsize + 48
"""Memory of a tile for a point's mark, its sorting included."""

_WEIGHING: tuple[Method, ...] = ("mean", "idw")
"""Methods for which it matters how often a point is there."""


@dataclass(frozen=True)
class GridJob:
    """What is asked for, checked; lengths are in cells but for ``resolution`` (m) and ``cell`` (CRS units)."""

    clouds: tuple[Cloud, ...]
    crs: CRS
    vertical_unit: str
    value: Value
    method: Method
    resolution: float
    cell: float
    reach: float
    radius: float

    @property
    def margin(self) -> int:
        """Cells around a tile on which it depends."""
        return gridding_halo(self.method, self.reach, self.radius)


@dataclass(frozen=True)
class GridPlan:
    """Everything about a gridding job that is known before its points are dealt out.

    Attributes
    ----------
    job
        What is asked for.
    quantum
        Size of a value's tick.
    extent
        Global row and column of the raster's first cell (rows count southwards from the origin of the CRS), and its
        rows and columns.
    side
        Of a tile, in cells.
    overlapping
        For each tile whether several clouds may hold the same points there.
    """

    job: GridJob
    quantum: float
    extent: Extent
    side: int
    overlapping: NDArray[np.bool_]

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles down and across."""
        return _tiles(self.extent, self.side)

    def window(self, tile: int) -> Window:
        """Cells of the raster that a tile covers."""
        rows, columns = self.extent.shape
        row, column = (index * self.side for index in divmod(tile, self.tiles[1]))
        return Window(column, row, min(self.side, columns - column), min(self.side, rows - row))

    def tile_memory(self, tile: int, points: int) -> int:
        """Bytes that gridding a tile of so many points needs."""
        cells = (self.side + 2 * self.job.margin) ** 2
        of_point = BYTES_PER_POINT + (_BYTES_PER_MARK if self.overlapping[tile] else 0)
        return cells * BYTES_PER_CELL + points * of_point


def checked_job(
    paths: Sequence[Path],
    resolution: float,
    value: Value,
    method: Method,
    void_reach: float,
    idw_radius: float | None,
    crs: str | CRS | None,
) -> GridJob:
    """Check options and headers; parameters and errors are those of `tilepipe.pipelines.points.recipe.grid_clouds`."""
    if not (math.isfinite(resolution) and resolution > 0):
        raise InputError(f"the resolution must be a positive number of metres, not {resolution}")
    if not (math.isfinite(void_reach) and void_reach >= 0):
        raise InputError(f"the void reach must be 0 or more metres, not {void_reach}")
    if idw_radius is not None and not (math.isfinite(idw_radius) and idw_radius > 0):
        raise InputError(f"the IDW radius must be a positive number of metres, not {idw_radius}")
    if value not in get_args(Value):
        raise InputError(f"unknown value {value!r}; choose one of {', '.join(get_args(Value))}")
    if method not in METHODS:
        raise InputError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")
    clouds = tuple(read_cloud(path) for path in paths)
    horizontal, vertical_unit = common_crs(clouds, crs, heights=value == "height")
    check_raster_crs(horizontal, str(clouds[0].path))
    radius = (math.sqrt(2) if idw_radius is None else idw_radius / resolution) if method == "idw" else 0.0
    job = GridJob(
        clouds=clouds,
        crs=horizontal,
        vertical_unit=vertical_unit,
        value=value,
        method=method,
        resolution=resolution,
        cell=resolution / map_unit(horizontal),
        reach=void_reach / resolution,
        radius=radius,
    )
    if _side(job) + 2 * job.margin > MAXIMUM_SIDE:
        raise InputError(
            f"a reach of {job.margin} cells is too far; shorten --void-reach or --idw-radius, or coarsen --resolution"
        )
    return job


def on_the_ground(job: GridJob, extent: Extent) -> GridJob:
    """The job with cells of its resolution on the ground, where the map is stretched over the extent of the points.

    Raises
    ------
    InputError
        As for `tilepipe.io.crs.ground.ground_metres`.
    """
    (top, left), (rows, columns) = extent.origin, extent.shape
    bounds = left * job.cell, -(top + rows) * job.cell, (left + columns) * job.cell, -top * job.cell
    return replace(job, cell=job.resolution / ground_metres(job.crs, bounds, str(job.clouds[0].path), CLOUDS))


def plan_grid(job: GridJob, extent: Extent, heights: tuple[float, float], memory: int) -> GridPlan:
    """Choose the tiles.

    ``heights`` are the lowest and the highest; ``memory`` is what one worker may use, in bytes: the tiles shrink to
    fit it where points lie evenly.
    """
    side, density = _side(job), extent.points / math.prod(extent.shape)
    while side > _SMALLEST_TILE and _even_memory(side + 2 * job.margin, density) > memory:
        side //= 2
    return GridPlan(job, _quantum(job, heights), extent, side, _overlapping(job, extent, side))


def _side(job: GridJob) -> int:
    """Side of a tile that is wide for its margin."""
    side = _TILE
    while side < 4 * job.margin:
        side *= 2
    return side


def _even_memory(padded_side: int, density: float) -> int:
    """Bytes for a padded tile with twice as many points per cell as on average."""
    return padded_side**2 * (BYTES_PER_CELL + math.ceil(2 * density * BYTES_PER_POINT))


def _quantum(job: GridJob, heights: tuple[float, float]) -> float:
    """Size of a value's tick: 1 for intensity, for heights the finest z scale (coarser if int32 needs it)."""
    if job.value == "intensity":
        return 1.0
    quantum = min(cloud.scales[2] for cloud in job.clouds)
    while max(map(abs, heights)) / quantum >= 2**31 - 1:
        quantum *= 10
    return quantum


def _tiles(extent: Extent, side: int) -> tuple[int, int]:
    return -(-extent.shape[0] // side), -(-extent.shape[1] // side)


def _overlapping(job: GridJob, extent: Extent, side: int) -> NDArray[np.bool_]:
    """For each tile whether the boxes of two clouds meet in it or its margin, and copies of points would weigh."""
    tiles = _tiles(extent, side)
    result = np.zeros(tiles, np.bool_)
    boxes = extent.boxes if job.method in _WEIGHING else extent.boxes[:0]
    for number, box in enumerate(boxes):
        lowest = np.maximum(box[0], boxes[number + 1 :, 0])
        highest = np.minimum(box[1], boxes[number + 1 :, 1])
        common = (lowest <= highest).all(axis=1)
        first = np.maximum(lowest[common] - extent.origin - job.margin, 0) // side
        last = (highest[common] - extent.origin + job.margin) // side
        for (top, left), (bottom, right) in zip(first.tolist(), last.tolist(), strict=True):
            result[top : bottom + 1, left : right + 1] = True
    return result.ravel()
