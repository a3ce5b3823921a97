"""The pipeline `streets`: lidar intensity in, street regions and centerlines out."""

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
from tilepipe.pipelines.streets import INPUTS, SUMMARY
from tilepipe.pipelines.streets.layers import CENTERLINES, REGIONS, SKELETON
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.pipelines.streets.pass_levels import LEVELS
from tilepipe.pipelines.streets.pass_lines import LINES
from tilepipe.pipelines.streets.pass_responses import RESPONSES
from tilepipe.pipelines.streets.pass_segment import SEGMENT
from tilepipe.pipelines.streets.recipe import recipe


def _rectangle(setting: Setting) -> tuple[int, int]:
    """Rows and columns of a rectangle: no tile cuts one."""
    return setting.parameters.rectangle_rows, setting.parameters.rectangle_columns


PIPELINE = Pipeline(
    name="streets",
    summary=SUMMARY,
    parameters=StreetParameters,
    inputs=INPUTS,
    cell=_rectangle,
    passes=(LEVELS, SEGMENT, RESPONSES, LINES),
    recipe=recipe,
    # lines of a city at half a metre
    bytes_per_megapixel=2_000_000,
    layers=(REGIONS, CENTERLINES, SKELETON),
    pictures="tilepipe.pipelines.streets.pictures:pictures",
    warm_up="tilepipe.pipelines.streets.warm_up:warm_up",
)


def streets(
    rasters: Sequence[Any] | Any,
    out: str | Path,
    *,
    height: Sequence[Any] | None = None,
    height_band: int | None = None,
    params: StreetParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Extract street regions and street centerlines from lidar intensity.

    Parameters
    ----------
    rasters
        Intensity: one or many paths (GeoTIFF, COG, VRT, Zarr) or xarray arrays, one mosaic; streets are dark.
    out
        Folder of the run; receives ``streets.tif``, ``centerlines.parquet``, ``skeleton.parquet`` and ``run.toml``.
    height
        Height raster (DSM) on the same pixel grid, to leave out trees and roofs.
    height_band
        Band to use where the height raster has several.
    params
        Parameters of the method.
    crs
        ``EPSG:n`` for inputs that name no CRS.
    band
        Band to use where a raster has several.
    options
        Tiles, workers, memory: how, not what.
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
    A synthetic city of 256 m × 256 m.

    >>> import geopandas
    >>> import tilepipe
    >>> from tilepipe.synthetic import City, write_city
    >>> city = write_city("city", City(rows=512, columns=512), layers=["intensity"])
    >>> layers = tilepipe.streets(city["intensity"], out="run", options=tilepipe.RunOptions(tile=512, workers=1))
    >>> [path.name for path in layers]
    ['streets.tif', 'centerlines.parquet', 'skeleton.parquet']
    >>> geopandas.read_parquet("run/centerlines.parquet").length.sum().item() > 500  # metres
    True
    """
    return run_pipeline(
        PIPELINE,
        rasters,
        out,
        inputs={"heights": height, "height_band": height_band},
        params=params,
        crs=crs,
        band=band,
        options=options,
        progress=progress,
    )


def plan_streets(
    rasters: Sequence[Any] | Any,
    *,
    height: Sequence[Any] | None = None,
    height_band: int | None = None,
    params: StreetParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `streets`.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> y, x = 5820000 - 0.5 * np.arange(3000), 392000 + 0.5 * np.arange(4000)
    >>> intensity = xr.DataArray(np.zeros((3000, 4000), np.uint8), {"y": y, "x": x}, ("y", "x"))
    >>> plan = tilepipe.plan_streets(intensity, crs="EPSG:32633", options=tilepipe.RunOptions(tile=1024, workers=2))
    >>> plan.tiles, plan.resolution, plan.memory < 8 << 30
    (12, 0.5, True)
    """
    return plan_pipeline(
        PIPELINE,
        rasters,
        inputs={"heights": height, "height_band": height_band},
        params=params,
        crs=crs,
        band=band,
        options=options,
    )
