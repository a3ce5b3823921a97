"""The pipeline `edges`: an aerial photograph in, its segmentation and its edges out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pipeline
from tilepipe.engine.planning import Plan
from tilepipe.engine.progress import Progress
from tilepipe.engine.request import Opened, plan_pipeline
from tilepipe.engine.work import run_pipeline
from tilepipe.pipelines.edges import INPUTS, SUMMARY
from tilepipe.pipelines.edges.layers import EDGES, IMAGE_SUMMARY, LINES, NEVATIA_BABU, SEGMENTS
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_bands import BANDS, open_photograph
from tilepipe.pipelines.edges.pass_fields import FIELDS
from tilepipe.pipelines.edges.pass_levels import LEVELS
from tilepipe.pipelines.edges.recipe import recipe

_PER_MEGAPIXEL = 18_000_000
"""Lines of a city at half a metre and edge elements in bytes per Mpx, while tables are made of them."""


def _open(
    rasters: list[Any], _: Mapping[str, Any], parameters: EdgeParameters, crs: str | None, band: int | None
) -> Opened:
    """The bands of a photograph on one pixel grid."""
    photograph = open_photograph(rasters, crs=crs, band=band, grey=parameters.grey)
    return Opened(photograph.raster, found={"grey": photograph.conversion}, source=photograph)


PIPELINE = Pipeline(
    name="edges",
    summary=SUMMARY,
    inputs=INPUTS,
    parameters=EdgeParameters,
    open_inputs=_open,
    passes=(BANDS, LEVELS, FIELDS),
    recipe=recipe,
    layers=(SEGMENTS, LINES, EDGES, NEVATIA_BABU, IMAGE_SUMMARY),
    seeded=True,
    bytes_per_megapixel=_PER_MEGAPIXEL,
    pictures="tilepipe.pipelines.edges.pictures:pictures",
    warm_up="tilepipe.pipelines.edges.warm_up:warm_up",
)


def edges(
    rasters: Sequence[Any] | Any,
    out: str | Path,
    *,
    params: EdgeParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Segment an aerial photograph and find its edges, by a Bayesian model and by the classical method.

    Parameters
    ----------
    rasters
        Photograph of one or many bands: one or many paths (GeoTIFF, COG, VRT, Zarr) or xarray arrays, one mosaic.
    out
        Folder of the run; receives ``segments.tif`` (levels, 255 = nodata), ``lines.tif`` (line field: 1 = edge below
        the pixel, 2 = edge to its right, 3 = both), ``edges.parquet``, ``nevatia_babu.parquet``, ``edges.json``
        (grey levels, energy, sweeps of annealing, what the cap on rounds has left) and ``run.toml``.
    params
        Parameters of the method.
    crs
        ``EPSG:n`` for inputs that name no CRS.
    band
        The only band to use; all by default.
    options
        Tiles, workers, memory: how, not what; and the seed of annealing.
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
    A bright roof of 20 m × 15 m on dark ground.

    >>> import geopandas
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> from tilepipe_kernels.core.random import normals
    >>> grey = 60 + 3 * normals(np.arange(128 * 128).reshape(128, 128), seed=0)
    >>> grey[40:70, 30:70] += 120
    >>> centres = {"y": 5820000 - 0.5 * np.arange(128), "x": 392000 + 0.5 * np.arange(128)}
    >>> options = tilepipe.RunOptions(tile=128, workers=1)
    >>> photograph = xr.DataArray(grey, centres, ("y", "x"))
    >>> _ = tilepipe.edges(photograph, "run", params={"levels": 2}, crs="EPSG:32633", options=options)
    >>> round(geopandas.read_parquet("run/edges.parquet").length.sum())  # metres, around the roof
    70
    """
    return run_pipeline(PIPELINE, rasters, out, params=params, crs=crs, band=band, options=options, progress=progress)


def plan_edges(
    rasters: Sequence[Any] | Any,
    *,
    params: EdgeParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `edges`.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> y, x = 5820000 - 0.5 * np.arange(3000), 392000 + 0.5 * np.arange(4000)
    >>> photograph = xr.DataArray(np.zeros((3000, 4000), np.uint8), {"y": y, "x": x}, ("y", "x"))
    >>> plan = tilepipe.plan_edges(photograph, crs="EPSG:32633", options=tilepipe.RunOptions(tile=1024, workers=2))
    >>> plan.tiles, plan.resolution, plan.memory < 8 << 30
    (12, 0.5, True)
    """
    return plan_pipeline(PIPELINE, rasters, params=params, crs=crs, band=band, options=options)
