"""Points dealt out to files of tiles, and a tile gridded from its file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.io.clouds.cloud import Cloud
from tilepipe.io.clouds.points import (
    IDENTITY,
    VALUES,
    Chunk,
    PointFilter,
    identities,
    raw_coordinates,
    read_points,
    ticks,
)
from tilepipe.pipelines.points.in_order import in_order
from tilepipe.pipelines.points.plan import MARK, GridPlan
from tilepipe_kernels.points.duplicates import counted_once
from tilepipe_kernels.points.gridding import grid_points
from tilepipe_kernels.points.point_tiles import POINT, SUBCELL_BITS, sort_by_tile, subcells

_Dealt = tuple[NDArray[Any], NDArray[Any] | None, NDArray[np.int64]]
"""Points of a chunk by tile, their marks where clouds overlap, and where each tile starts."""


def deal_points(
    plan: GridPlan,
    scratch: Path,
    point_filter: PointFilter,
    chunk_points: int,
    workers: int,
    progress: Callable[[int, int], None],
) -> dict[int, int]:
    """Append every point to the file of each tile that needs it; return the number of points by tile."""
    counts: dict[int, int] = {}
    clouds = plan.job.clouds
    fields = IDENTITY if plan.overlapping.any() else VALUES
    done, total = 0, sum(cloud.points for cloud in clouds)
    for number, cloud in enumerate(clouds):
        chunks = read_points(cloud, fields, point_filter, chunk_points, workers > 1)
        for (read, _), (points, marks, starts) in in_order(partial(_dealt, plan, number, cloud), chunks, workers):
            for tile in np.flatnonzero(np.diff(starts)).tolist():
                own = slice(starts[tile], starts[tile + 1])
                _append(_points_file(scratch, tile), points[own])
                if marks is not None and plan.overlapping[tile]:
                    _append(_marks_file(scratch, tile), marks[own])
                counts[tile] = counts.get(tile, 0) + own.stop - own.start
            done += read
            progress(done, total)
    return {tile: int(count) for tile, count in counts.items()}


def grid_tile(plan: GridPlan, scratch: Path, tile: int) -> tuple[NDArray[np.float32], int]:
    """Values of a tile, and the number of the points in it that were left out as copies."""
    path = _points_file(scratch, tile)
    points = np.fromfile(path, POINT)
    path.unlink()
    copies = 0
    if plan.overlapping[tile]:
        path = _marks_file(scratch, tile)
        marks = np.fromfile(path, MARK)
        path.unlink()
        kept = counted_once(marks["print"], marks["cloud"])
        copies = _in_core(plan, points[~kept])
        points = points[kept]
    job = plan.job
    values = grid_points(points, (plan.side, plan.side), method=job.method, reach=job.reach, radius=job.radius)
    values *= plan.quantum
    return values.astype(np.float32), copies


def _dealt(plan: GridPlan, number: int, cloud: Cloud, chunk: Chunk) -> _Dealt:
    _, read = chunk
    job, extent = plan.job, plan.extent
    x, y = raw_coordinates(read)
    rows = subcells(y, cloud.scales[1], cloud.offsets[1], -job.cell)
    columns = subcells(x, cloud.scales[0], cloud.offsets[0], job.cell)
    inside = _inside(rows, columns, plan)
    if inside is not None:
        rows, columns, read = rows[inside], columns[inside], read[inside]
    values = ticks(cloud, read, job.value, plan.quantum)
    marked = plan.overlapping.any()
    points, starts = sort_by_tile(
        rows,
        columns,
        np.arange(len(values), dtype=np.int32) if marked else values,
        origin=extent.origin,
        tiles=plan.tiles,
        side=plan.side,
        margin=job.margin,
    )
    if not marked:
        return points, None, starts
    # what was dealt out are the numbers of the points, which their values and marks follow
    order = points["value"]
    marks = np.empty(len(order), MARK)
    marks["print"], marks["cloud"] = identities(cloud, read, job.clouds)[order], number
    points["value"] = values[order]
    return points, marks, starts


def _inside(rows: NDArray[np.int64], columns: NDArray[np.int64], plan: GridPlan) -> NDArray[np.bool_] | None:
    """Which points lie in the raster; None where none has gone astray."""
    if plan.extent.warning is None:
        return None
    row, column = (rows >> SUBCELL_BITS) - plan.extent.origin[0], (columns >> SUBCELL_BITS) - plan.extent.origin[1]
    height, width = plan.extent.shape
    return (row >= 0) & (row < height) & (column >= 0) & (column < width)


def _in_core(plan: GridPlan, points: NDArray[Any]) -> int:
    """Number of points that lie in a tile itself, not in its margin."""
    first, last = plan.job.margin, plan.job.margin + plan.side
    row, column = points["row"], points["column"]
    return int(((row >= first) & (row < last) & (column >= first) & (column < last)).sum())


def _append(path: Path, records: NDArray[Any]) -> None:
    with open(path, "ab") as file:
        file.write(records.data)


def _points_file(scratch: Path, tile: int) -> Path:
    return scratch / f"{tile}.points"


def _marks_file(scratch: Path, tile: int) -> Path:
    return scratch / f"{tile}.marks"
