"""What gridding will do, settled from options and headers before any point is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from pyproj import CRS
from rasterio.windows import Window

from tilepipe.errors import InputError
from tilepipe.io.cloud_points import Value, value_quantum
from tilepipe.io.clouds import Cloud, common_crs, metres_per_unit, read_cloud
from tilepipe_kernels.points.gridding import BYTES_PER_CELL, BYTES_PER_POINT, METHODS, Method
from tilepipe_kernels.points.gridding import halo as gridding_halo
from tilepipe_kernels.points.point_tiles import MAXIMUM_SIDE, subcells

_TILE, _SMALLEST_TILE = 1024, 512
_FURTHEST_INDEX = 2.0**31

_MANY_CELLS, _MOST_EMPTY = 1_000_000_000, 100
"""A raster of more cells than this, and more than so many times those of its clouds, is hardly meant."""


@dataclass(frozen=True)
class GridPlan:
    """Everything about a gridding job that is known from the headers.

    Attributes
    ----------
    cell
        Side of a cell in CRS units.
    origin
        Global row and column of the raster's first cell; rows count southwards from the origin of the CRS.
    shape
        Rows and columns of the raster.
    side, margin
        Of a tile, in cells.
    reach, radius
        Void reach and IDW radius in cells.
    """

    clouds: tuple[Cloud, ...]
    crs: CRS
    vertical_unit: str
    value: Value
    method: Method
    quantum: float
    cell: float
    origin: tuple[int, int]
    shape: tuple[int, int]
    side: int
    margin: int
    reach: float
    radius: float

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles down and across."""
        return -(-self.shape[0] // self.side), -(-self.shape[1] // self.side)

    def window(self, tile: int) -> Window:
        """Cells of the raster that a tile covers."""
        row, column = (index * self.side for index in divmod(tile, self.tiles[1]))
        height, width = min(self.side, self.shape[0] - row), min(self.side, self.shape[1] - column)
        return Window(column, row, width, height)

    def tile_memory(self, points: int) -> int:
        """Bytes that gridding a tile of so many points needs."""
        cells = (self.side + 2 * self.margin) ** 2
        return cells * BYTES_PER_CELL + points * BYTES_PER_POINT


def plan_grid(
    paths: Sequence[Path],
    resolution: float,
    value: Value,
    method: Method,
    void_reach: float,
    idw_radius: float | None,
    crs: str | CRS | None,
    memory: int,
) -> GridPlan:
    """Check the options and the headers, and choose the raster's extent and the tiles.

    ``memory`` is what one worker may use, in bytes; the tiles shrink to fit it where points lie evenly.  The
    other parameters, and the errors, are those of `tilepipe.pipelines.points.recipe.grid_clouds`.
    """
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
    horizontal, vertical_unit = common_crs(clouds, crs)
    cell = resolution / metres_per_unit(horizontal)
    origin, shape = _extent(clouds, cell, resolution)
    reach = void_reach / resolution
    radius = (math.sqrt(2) if idw_radius is None else idw_radius / resolution) if method == "idw" else 0.0
    margin = gridding_halo(method, reach, radius)
    density = sum(cloud.points for cloud in clouds) / (shape[0] * shape[1])
    side = _TILE
    while side < 4 * margin:
        side *= 2
    while side > _SMALLEST_TILE and _tile_memory(side + 2 * margin, density) > memory:
        side //= 2
    if side + 2 * margin > MAXIMUM_SIDE:
        raise InputError(f"a reach of {margin} cells is too far; shorten it or coarsen the resolution")
    return GridPlan(
        clouds=clouds,
        crs=horizontal,
        vertical_unit=vertical_unit,
        value=value,
        method=method,
        quantum=value_quantum(clouds, value),
        cell=cell,
        origin=origin,
        shape=shape,
        side=side,
        margin=margin,
        reach=reach,
        radius=radius,
    )


def _tile_memory(padded_side: int, density: float) -> int:
    """Bytes for a padded tile with twice as many points per cell as on average."""
    return padded_side**2 * (BYTES_PER_CELL + math.ceil(2 * density * BYTES_PER_POINT))


def _extent(clouds: Sequence[Cloud], cell: float, resolution: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Global row and column of the first cell, and the shape, of the raster that holds all clouds."""
    boxes = np.array([_box(cloud, cell) for cloud in clouds])
    (top, left), (bottom, right) = boxes[:, :, 0].min(axis=0).tolist(), boxes[:, :, 1].max(axis=0).tolist()
    shape = bottom - top + 1, right - left + 1
    covered = int(np.prod(boxes[:, :, 1] - boxes[:, :, 0] + 1, axis=1).sum())
    if math.prod(shape) > max(_MANY_CELLS, _MOST_EMPTY * covered):
        centres = boxes.mean(axis=2)
        astray = int(np.hypot(*(centres - centres.mean(axis=0)).T).argmax())
        distances = np.hypot(*(centres - centres[astray]).T) * resolution / 1000
        raise InputError(
            f"{clouds[astray].path} and {clouds[int(distances.argmax())].path} lie {distances.max():,.0f} km apart: "
            f"the raster would have {math.prod(shape) / 1e9:,.0f} Gpx, {math.prod(shape) // covered:,} times what the "
            "clouds cover; grid clouds of one place at a time, and check the CRS of those that lie astray"
        )
    return (top, left), shape


def _box(cloud: Cloud, cell: float) -> list[list[int]]:
    """First and last of the global rows, and of the columns, of a cloud's bounding box."""
    box: list[list[int]] = []
    for axis, side in ((1, -cell), (0, cell)):
        raw, scale, offset = (
            np.array([cloud.lowest[axis], cloud.highest[axis]]),
            cloud.scales[axis],
            cloud.offsets[axis],
        )
        if np.abs((raw * scale + offset) / cell).max() >= _FURTHEST_INDEX:
            raise InputError("the resolution is too fine for the CRS's coordinates; coarsen it")
        box.append(sorted((subcells(raw, scale, offset, side) >> 16).tolist()))
    return box
