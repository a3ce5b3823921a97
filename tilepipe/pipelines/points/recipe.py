"""Point clouds to one raster, streamed: deal the points out to tiles on disk, then grid tile by tile."""

from __future__ import annotations

import math
import os
import tempfile
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import RasterioError

from tilepipe.errors import InputError
from tilepipe.io.cloud_points import Chunk, PointFilter, Returns, Value, read_points
from tilepipe.io.clouds import Cloud, find_clouds
from tilepipe.pipelines.points.plan import GridPlan, plan_grid
from tilepipe_kernels.points.gridding import Method, grid_points
from tilepipe_kernels.points.point_tiles import POINT, sort_by_tile, subcells

Progress = Callable[[str, int, int], None]
Item = TypeVar("Item")
Result = TypeVar("Result")

_BLOCK = 512
_BASE_MEMORY = 256 << 20
_GDAL_CACHE = 64 << 20
_READ_BYTES_PER_POINT, _DEALT_BYTES_PER_POINT = 100, 60


def grid_clouds(
    clouds: Sequence[str | Path],
    out: str | Path,
    *,
    resolution: float = 0.5,
    value: Value = "height",
    method: Method = "nearest",
    void_reach: float = 0.0,
    idw_radius: float | None = None,
    crs: str | CRS | None = None,
    classes: Sequence[int] | None = None,
    returns: Returns = "all",
    overwrite: bool = False,
    memory: int = 8 << 30,
    workers: int | None = None,
    chunk_points: int = 500_000,
    progress: Progress | None = None,
) -> Path:
    """Grid point clouds to one GeoTIFF; the result does not depend on the order of files and points.

    Parameters
    ----------
    clouds
        LAS, LAZ or COPC files, or folders of them, all in one projected CRS; a file named twice counts once.
    out
        The GeoTIFF: float32, nodata NaN, north up, in the CRS of the clouds (without its vertical part), its
        extent that of all points snapped outwards to multiples of the cell side.  Also for intensity, where
        0 is a measurement.  Heights stay in the clouds' own unit, which the band names.
    resolution
        Cell side in metres, also where the CRS counts in feet: it is converted to the unit of the CRS.
    value
        ``height`` or ``intensity``.
    method
        ``nearest``, ``max``, ``min``, ``mean`` or ``idw``, as `tilepipe_kernels.points.gridding.grid_points`
        defines them.
    void_reach
        In metres; a cell without a value takes that of the nearest point (``nearest``) or cell (else) within
        this distance.  0 fills nothing.
    idw_radius
        In metres, for ``idw`` only; None is the cell's diagonal.
    crs
        For clouds that name none.
    classes
        ASPRS classes that count; None is all but noise (7 and 18).  Withheld points never count.
    returns
        ``first``, ``last`` or ``all``.
    overwrite
        Replace ``out`` if it exists.
    memory
        Bytes that may be used.  Points wait on disk beside ``out``, 12 bytes each, not in memory.
    workers
        Threads; None is the number of CPUs.
    chunk_points
        Points read at once.
    progress
        Called with (stage, done, total): stage ``read`` in points, then ``grid`` in tiles.

    Returns
    -------
    Path
        ``out``, which appears only when whole.

    Raises
    ------
    InputError
        For anything that the user can mend: bad files, CRSs, options, too little memory or disk.

    Examples
    --------
    Three points in a row of cells of one metre: two in the first, one in the third.

    >>> import laspy
    >>> import numpy as np
    >>> import rasterio
    >>> import tilepipe
    >>> cloud = laspy.create()
    >>> cloud.x, cloud.y, cloud.z = np.array([[0.2, 0.7, 2.5], [0.5, 0.5, 0.5], [3.0, 4.0, 9.0]])
    >>> cloud.write("cloud.las")
    >>> path = tilepipe.grid_clouds(["cloud.las"], "heights.tif", resolution=1.0, method="max", crs="EPSG:32633")
    >>> with rasterio.open(path) as heights:
    ...     heights.read(1).tolist()
    [[4.0, nan, 9.0]]
    """
    out = Path(out)
    if out.exists() and not overwrite:
        raise InputError(f"{out} exists; pass --overwrite to replace it")
    if not out.parent.is_dir():
        raise InputError(f"the folder {out.parent} does not exist; create it first")
    workers = max(1, workers or os.cpu_count() or 1)
    if returns not in get_args(Returns):
        raise InputError(f"unknown returns {returns!r}; choose one of {', '.join(get_args(Returns))}")
    point_filter = PointFilter(None if classes is None else tuple(classes), returns)
    in_flight = _READ_BYTES_PER_POINT + (workers + 1) * _DEALT_BYTES_PER_POINT
    free = memory - _BASE_MEMORY - chunk_points * in_flight
    paths = find_clouds(clouds)
    plan = plan_grid(paths, resolution, value, method, void_reach, idw_radius, crs, free // workers)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as scratch:
            counts = _deal(plan, Path(scratch), point_filter, chunk_points, workers, progress)
            most = plan.tile_memory(max(counts.values()))
            if most > free:
                needed = (memory - free + most) / (1 << 20)
                raise InputError(f"gridding needs {needed:,.0f} MiB of memory; raise --memory to that")
            raster = Path(scratch) / "raster.tif"
            _grid(plan, Path(scratch), raster, counts, min(workers, free // most), progress)
            os.replace(raster, out)
    except (OSError, RasterioError) as error:
        raise InputError(f"cannot write {out}: {error}; check the disk's space and the permissions") from error
    return out


def _deal(
    plan: GridPlan,
    scratch: Path,
    point_filter: PointFilter,
    chunk_points: int,
    workers: int,
    progress: Progress | None,
) -> dict[int, int]:
    """Append every point to the file of each tile that needs it; return the number of points by tile."""
    counts: dict[int, int] = {}
    done, total = 0, sum(cloud.points for cloud in plan.clouds)
    for cloud in plan.clouds:
        chunks = read_points(cloud, plan.value, plan.quantum, point_filter, chunk_points, workers > 1)
        for (read, *_), (points, starts) in _in_order(partial(_sorted_chunk, plan, cloud), chunks, workers):
            for tile in np.flatnonzero(np.diff(starts)).tolist():
                with open(scratch / f"{tile}.points", "ab") as file:
                    file.write(points[starts[tile] : starts[tile + 1]].data)
                counts[tile] = counts.get(tile, 0) + int(starts[tile + 1] - starts[tile])
            done += read
            if progress is not None:
                progress("read", done, total)
    if not counts:
        raise InputError("no point passes the filter; check --classes and --returns")
    return counts


def _sorted_chunk(plan: GridPlan, cloud: Cloud, chunk: Chunk) -> tuple[NDArray[Any], NDArray[np.int64]]:
    _, x, y, values = chunk
    return sort_by_tile(
        subcells(y, cloud.scales[1], cloud.offsets[1], -plan.cell),
        subcells(x, cloud.scales[0], cloud.offsets[0], plan.cell),
        values,
        origin=plan.origin,
        tiles=plan.tiles,
        side=plan.side,
        margin=plan.margin,
    )


def _grid_tile(plan: GridPlan, scratch: Path, tile: int) -> NDArray[np.float32]:
    path = scratch / f"{tile}.points"
    points = np.fromfile(path, POINT)
    path.unlink()
    ticks = grid_points(points, (plan.side, plan.side), method=plan.method, reach=plan.reach, radius=plan.radius)
    ticks *= plan.quantum
    return ticks.astype(np.float32)


def _in_order(function: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[tuple[Item, Result]]:
    """Results in the order of the items, with at most one more than ``workers`` computed or waiting."""
    waiting: deque[tuple[Item, Future[Result]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for item in items:
            if len(waiting) > workers:
                first, future = waiting.popleft()
                yield first, future.result()
            waiting.append((item, pool.submit(function, item)))
        while waiting:
            first, future = waiting.popleft()
            yield first, future.result()


def _grid(
    plan: GridPlan,
    scratch: Path,
    raster: Path,
    counts: dict[int, int],
    workers: int,
    progress: Progress | None,
) -> None:
    transform = Affine(plan.cell, 0.0, plan.origin[1] * plan.cell, 0.0, -plan.cell, -plan.origin[0] * plan.cell)
    authority = plan.crs.to_authority()
    with (
        rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE),
        rasterio.open(
            raster,
            "w",
            driver="GTiff",
            dtype="float32",
            nodata=math.nan,
            count=1,
            height=plan.shape[0],
            width=plan.shape[1],
            crs=":".join(authority) if authority else plan.crs.to_wkt(),
            transform=transform,
            tiled=True,
            blockxsize=_BLOCK,
            blockysize=_BLOCK,
            compress="deflate",
            predictor=3,
            zlevel=1,
            num_threads=workers,
            bigtiff="if_safer",
            sparse_ok=True,
        ) as dataset,
    ):
        dataset.set_band_description(1, f"{plan.value} ({plan.method})")
        if plan.value == "height":
            dataset.units = (plan.vertical_unit,)
        tiles = sorted(counts)
        checksums: dict[int, int] = {}
        for done, (tile, block) in enumerate(_in_order(partial(_grid_tile, plan, scratch), tiles, workers), 1):
            window = plan.window(tile)
            block = np.ascontiguousarray(block[: window.height, : window.width])
            checksums[tile] = zlib.crc32(block.data)
            dataset.write(block, 1, window=window)
            if progress is not None:
                progress("grid", done, len(tiles))
    _verify(plan, raster, checksums, workers)


def _verify(plan: GridPlan, raster: Path, checksums: dict[int, int], workers: int) -> None:
    """Read the raster back: GDAL tells nobody that a write failed while it closed a file."""
    with (
        rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE),
        rasterio.open(raster, num_threads=workers) as dataset,
    ):
        for tile, checksum in checksums.items():
            if zlib.crc32(dataset.read(1, window=plan.window(tile))) != checksum:
                raise OSError("the raster read back differs from what was written")
    with open(raster, "rb") as file:
        os.fsync(file.fileno())
