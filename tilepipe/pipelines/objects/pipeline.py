"""The pipeline `objects`: lidar heights in, object polygons and their boundaries out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pipeline, Setting
from tilepipe.engine.planning import Plan
from tilepipe.engine.progress import Progress
from tilepipe.engine.request import plan_pipeline
from tilepipe.engine.work import run_pipeline
from tilepipe.errors import InputError
from tilepipe.pipelines.objects import INPUTS, SUMMARY
from tilepipe.pipelines.objects.layers import BOUNDARIES, BUILDINGS, CONVERGENCE, OBJECTS, REGIONS
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.pass_borders import BORDERS
from tilepipe.pipelines.objects.pass_leaves import LEAVES
from tilepipe.pipelines.objects.recipe import recipe
from tilepipe_kernels.regions.quadtree_sums import LARGEST_SIDE

_PER_MEGAPIXEL = 100_000 * 250
"""Leaves of a city at half a metre, and what graph, sampler and tables hold of each in bytes: 250 were measured."""


def _largest_leaf(setting: Setting) -> tuple[int, int]:
    """Side of the largest square, twice: no tile cuts one."""
    _, largest = setting.parameters.leaf_sides(setting.resolution)
    return largest, largest


def _check(setting: Setting) -> None:
    """Refuse squares that are too large to count in.

    Raises
    ------
    InputError
        Says how large a leaf may be.
    """
    if _largest_leaf(setting)[0] > LARGEST_SIDE:
        given, most = setting.parameters.largest_leaf, LARGEST_SIDE * setting.resolution
        raise InputError(f"parameter largest_leaf={given:g}: at most {most:g} m at this resolution")


PIPELINE = Pipeline(
    name="objects",
    summary=SUMMARY,
    inputs=INPUTS,
    heights=True,
    parameters=ObjectParameters,
    cell=_largest_leaf,
    check=_check,
    passes=(LEAVES, BORDERS),
    recipe=recipe,
    layers=(REGIONS, BUILDINGS, OBJECTS, BOUNDARIES, CONVERGENCE),
    seeded=True,
    bytes_per_megapixel=_PER_MEGAPIXEL,
    pictures="tilepipe.pipelines.objects.pictures:pictures",
    warm_up="tilepipe.pipelines.objects.warm_up:warm_up",
)


def objects(
    rasters: Sequence[Any] | Any,
    out: str | Path,
    *,
    params: ObjectParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Find objects in lidar heights, and the probability of every boundary between them.

    Parameters
    ----------
    rasters
        Heights (DSM) in the unit of their band, else of their CRS: one or many paths (GeoTIFF, COG, VRT, Zarr) or
        xarray arrays, one mosaic.
    out
        Folder of the run; receives ``regions.tif``, ``objects.parquet``, ``boundaries.parquet``,
        ``buildings.parquet``, ``convergence.json`` (diagnostics of the sampler; a warning says when it has not
        converged) and ``run.toml``.
    params
        Parameters of the method.
    crs
        ``EPSG:n`` for inputs that name no CRS.
    band
        Band to use where a raster has several.
    options
        Tiles, workers, memory: how, not what; and the seed of the sampler.
    progress
        Told about the progress.

    Returns
    -------
    list of Path
        The published layers.

    Raises
    ------
    InputError
        When an input or a parameter cannot be used.
    TileError
        When tiles failed; the finished ones are kept for the next try.

    Examples
    --------
    Two blocks of 8 m and 12 m in height, each of 20 m × 20 m.

    >>> import geopandas
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> heights = np.zeros((128, 128), np.float32)
    >>> heights[20:60, 20:60], heights[20:60, 60:100] = 8, 12
    >>> centres = {"y": 5820000 - 0.5 * np.arange(128), "x": 392000 + 0.5 * np.arange(128)}
    >>> options = tilepipe.RunOptions(tile=128, workers=1)
    >>> _ = tilepipe.objects(xr.DataArray(heights, centres, ("y", "x")), "run", crs="EPSG:32633", options=options)
    >>> geopandas.read_parquet("run/objects.parquet").area.round().tolist()  # the ground and the two blocks
    [3296.0, 400.0, 400.0]
    """
    return run_pipeline(PIPELINE, rasters, out, params=params, crs=crs, band=band, options=options, progress=progress)


def plan_objects(
    rasters: Sequence[Any] | Any,
    *,
    params: ObjectParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `objects`.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> y, x = 5820000 - 0.5 * np.arange(3000), 392000 + 0.5 * np.arange(4000)
    >>> heights = xr.DataArray(np.zeros((3000, 4000), np.float32), {"y": y, "x": x}, ("y", "x"))
    >>> plan = tilepipe.plan_objects(heights, crs="EPSG:32633", options=tilepipe.RunOptions(tile=1024, workers=2))
    >>> plan.tiles, plan.resolution, plan.memory < 8 << 30
    (12, 0.5, True)
    """
    return plan_pipeline(PIPELINE, rasters, params=params, crs=crs, band=band, options=options)
