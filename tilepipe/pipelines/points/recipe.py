"""Point clouds to one raster, streamed: deal the points out to tiles on disk, then grid tile by tile."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from pyproj import CRS

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import find_clouds
from tilepipe.io.clouds.points import PointFilter, Returns, Value
from tilepipe.io.files.atomic import atomic_write, check_replaceable, clear_leftovers
from tilepipe.io.files.paths import local_output
from tilepipe.pipelines.points.copies import told_of_copies
from tilepipe.pipelines.points.deal import deal_points, grid_tile
from tilepipe.pipelines.points.extent import Extent, find_extent
from tilepipe.pipelines.points.in_order import in_order
from tilepipe.pipelines.points.plan import GridJob, GridPlan, checked_job, on_the_ground, plan_grid
from tilepipe.pipelines.points.survey import Survey, survey_clouds
from tilepipe.pipelines.points.write import tile_writer
from tilepipe_kernels.points.gridding import Method

Progress = Callable[[str, int, int], None]

_BASE_MEMORY = 256 << 20
_READ_BYTES_PER_POINT, _DEALT_BYTES_PER_POINT = 100, 100


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
        LAS, LAZ or COPC files, or folders of them, all in one projected CRS; a file named twice counts once, and so
        does a point that several of them hold: one of the same place, time, return and intensity.
    out
        The GeoTIFF: float32, nodata NaN, north up, in the CRS of the clouds (without its vertical part), its
        extent that of the points that count, whatever the headers say, snapped outwards to multiples of the cell
        side.  Also for intensity, where
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
        Bytes that may be used.  Points wait on disk beside ``out``, 12 bytes each (24 where clouds overlap), not
        in memory.
    workers
        Threads; None is the number of CPUs.
    chunk_points
        Points read at once.
    progress
        Called with (stage, done, total): stages ``survey`` and ``read`` in points, then ``grid`` in tiles.

    Returns
    -------
    Path
        ``out``, which appears only when whole, with ``.aux.xml`` beside it where a GeoTIFF cannot hold the CRS.

    Raises
    ------
    InputError
        For anything that the user can mend: bad files, CRSs, options, too little memory or disk, clouds so far apart
        that the raster would be huge and empty.

    Warns
    -----
    UserWarning
        Where single points have gone astray and are left out: a hundred times sparser than all others, and so far
        from them that the raster would be a hundred times larger.  Where clouds share points that count once, or
        overlap and count coordinates in different steps, so that not all such points can be told.

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
    out = local_output(out)
    check_replaceable(out)
    # of a process that was killed when the raster was there already
    clear_leftovers(out.parent)
    if (out.is_symlink() or out.exists()) and not overwrite:
        raise InputError(f"{out} exists; pass --overwrite to replace it")
    if not out.parent.is_dir():
        raise InputError(f"the folder {out.parent} does not exist; create it first")
    workers = max(1, workers or os.cpu_count() or 1)
    if returns not in get_args(Returns):
        raise InputError(f"unknown returns {returns!r}; choose one of {', '.join(get_args(Returns))}")
    point_filter = PointFilter(None if classes is None else tuple(classes), returns)
    free = memory - _BASE_MEMORY - chunk_points * (_READ_BYTES_PER_POINT + (workers + 1) * _DEALT_BYTES_PER_POINT)
    told = progress or _untold
    paths = find_clouds(clouds)
    if out.exists() and any(out.samefile(path) for path in paths):
        raise InputError(f"{out} is one of the clouds; name another file with --out")
    job = checked_job(paths, resolution, value, method, void_reach, idw_radius, crs)
    survey, extent = _surveyed(job, point_filter, chunk_points, workers, told)
    grounded = on_the_ground(job, extent)
    if grounded != job:
        job = grounded
        survey, extent = _surveyed(job, point_filter, chunk_points, workers, told)
    plan = plan_grid(job, extent, survey.heights, free // workers)
    if extent.warning is not None:
        warnings.warn(extent.warning, stacklevel=2)
    if (copied := told_of_copies(plan)) is not None:
        warnings.warn(copied, stacklevel=2)
    copies: int | None = None
    try:
        with atomic_write(out) as raster:
            scratch = raster.parent
            counts = deal_points(plan, scratch, point_filter, chunk_points, workers, partial(told, "read"))
            most = max(plan.tile_memory(tile, count) for tile, count in counts.items())
            if most > free:
                needed = (memory - free + most) / (1 << 20)
                raise InputError(f"gridding needs {needed:,.0f} MiB of memory; raise --memory to that")
            copies = _grid(plan, scratch, raster, sorted(counts), min(workers, free // most), told)
    except KeyboardInterrupt:
        # once the raster has its name, all that there was still to do is done
        if copies is None or raster.exists():
            raise
    except OSError as error:
        # what keeps the result from being written has been said: this is something else
        raise InputError(f"{error.filename or out}: {error.strerror or error}") from error
    if copies:
        warnings.warn(f"{copies:,} points that several of the clouds hold are counted once", stacklevel=2)
    return out


def _surveyed(
    job: GridJob, point_filter: PointFilter, chunk_points: int, workers: int, progress: Progress
) -> tuple[Survey, Extent]:
    """Where the points of a job lie, in its cells."""
    survey = survey_clouds(job.clouds, job.cell, point_filter, chunk_points, workers, partial(progress, "survey"))
    return survey, find_extent(job.clouds, survey, job.cell, job.resolution)


def _grid(plan: GridPlan, scratch: Path, raster: Path, tiles: Sequence[int], workers: int, progress: Progress) -> int:
    """Write the raster; return the number of points left out as copies of others."""
    copies = 0
    with tile_writer(plan, raster, workers) as writer:
        gridded = in_order(partial(grid_tile, plan, scratch), tiles, workers)
        for done, (tile, (values, repeated)) in enumerate(gridded, 1):
            writer.write(tile, values)
            copies += repeated
            progress("grid", done, len(tiles))
    return copies


def _untold(stage: str, done: int, total: int) -> None:
    """Progress that nobody wants to know."""
