"""The streets pipeline (Mendes & Dal Poz 2012): lidar intensity in, street regions and centerlines out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.ledger import Ledger
from tilepipe.engine.options import RunOptions
from tilepipe.engine.passes import Pass
from tilepipe.engine.pipeline import Job, as_list
from tilepipe.engine.planning import Plan, plan_passes
from tilepipe.engine.progress import Progress
from tilepipe.engine.run import STATE, Record, Run
from tilepipe.engine.state import StateArray
from tilepipe.errors import InputError
from tilepipe.io.cog import write_cog
from tilepipe.io.raster import check_aligned, open_raster
from tilepipe.pipelines.streets import pass_lines, pass_segment
from tilepipe.pipelines.streets.parameters import StreetParameters, street_parameters
from tilepipe.pipelines.streets.pass_levels import CountContext, GreyScale, count_values, grey_scale
from tilepipe.pipelines.streets.pass_responses import Thresholds, count_responses, line_thresholds
from tilepipe.pipelines.streets.reconcile_regions import Regions, reconcile_regions
from tilepipe.pipelines.streets.tables import LineScale, write_centerlines
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid, Window
from tilepipe.tiling.numbering import Numbering
from tilepipe_kernels.image.grey_levels import NO_REGION
from tilepipe_kernels.network.build import NetworkRules

_MOST_REGIONS = 1 << 24
"""Region ids travel with the points of lines as float32."""

LINE_LAYERS = {"centerlines": pass_lines.RIDGE, "skeleton": pass_lines.AXIS}


def streets(
    rasters: Sequence[Any] | Any,
    out: str | Path,
    *,
    height: Sequence[Any] | None = None,
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
    """
    return _prepare(rasters, height, params, crs, band, options).run(out, progress)


def plan_streets(
    rasters: Sequence[Any] | Any,
    *,
    height: Sequence[Any] | None = None,
    params: StreetParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `streets`."""
    return _prepare(rasters, height, params, crs, band, options).plan()


def pass_sizes(record: Record) -> dict[str, int]:
    """Number of tiles of each pass of an unfinished run, from its record."""
    grid = TileGrid(tuple(record["raster"]["shape"]), tuple(record["raster"]["tile"]))
    names = ["levels", "segment", "lines"]
    if record["parameters"].get("thresholds") == "histogram":
        names.insert(2, "responses")
    return dict.fromkeys(names, len(grid))


def _prepare(
    rasters: Any, height: Any, params: Any, crs: str | None, band: int | None, options: RunOptions | None
) -> _Job:
    """Open and check everything before any work."""
    parameters = params if isinstance(params, StreetParameters) else street_parameters(dict(params or {}))
    raster = open_raster(as_list(rasters), crs=crs, band=band)
    heights = None
    if height:
        dsm = open_raster(as_list(height), crs=crs)
        window = check_aligned(dsm, raster, "height raster")
        if window.intersection(Window(0, 0, *raster.shape)).is_empty:
            raise InputError(f"{dsm.names[0]}: the height raster does not overlap {raster.names[0]}")
        heights = pass_segment.Heights(dsm, window)
    others = {"heights": heights.raster} if heights else {}
    job = _Job(raster, parameters, options or RunOptions(), crs, band, heights=heights, others=others)
    try:
        job.plan()
    except (ValueError, OverflowError) as error:
        raise InputError(f"the parameters do not suit pixels of {job.resolution:g} m: {error}") from None
    return job


@dataclass(frozen=True)
class _Job(Job):
    """A checked request: its tiling, its passes and its reconciliations."""

    command = "streets"
    rasters = ("streets.tif",)
    tables = tuple(LINE_LAYERS)
    seeded = False

    parameters: StreetParameters
    heights: pass_segment.Heights | None = field(default=None, kw_only=True)

    def layers(self, run: Run) -> list[Path]:
        levels = run.run_pass(self.levels_pass())
        scale = grey_scale(levels.each(), self.parameters, self.raster.names[0])
        segmented = run.run_pass(self.segment_pass(run.state, scale))
        regions = self.reconcile(run, segmented.all_facts())
        thresholds = self.thresholds(run, scale, regions)
        centering = self.lines_pass(run.state, scale, regions, thresholds.low)
        with run.beside(self.write_raster, run, centering.context) as raster:
            fragments = run.run_pass(centering)
            lines = self.write_lines(run, fragments, thresholds)
            return [raster.result(), *lines]

    @property
    def rectangle(self) -> tuple[int, int]:
        return self.parameters.rectangle_rows, self.parameters.rectangle_columns

    @property
    def grid(self) -> TileGrid:
        """Tiles of whole rectangles, so that no rectangle is cut by a seam."""
        rows, columns = (max(side, self.options.tile // side * side) for side in self.rectangle)
        return TileGrid(self.raster.shape, (rows, columns))

    @property
    def tile_shape(self) -> tuple[int, int]:
        return self.grid.tile_shape

    def state_arrays(self, state: Path) -> dict[str, StateArray]:
        coarse = self.grid.coarsened(self.rectangle)
        return {
            "labels": StateArray(state / "labels.zarr", coarse, "uint32"),
            "grey": StateArray(state / "grey.zarr", self.grid, "uint16", NO_REGION),
        }

    def levels_pass(self) -> Pass:
        return self.device_pass("levels", count_values, CountContext(self.raster, self.backend), 1, bytes_per_pixel=16)

    def segment_pass(self, state: Path, scale: GreyScale) -> Pass:
        arrays = self.state_arrays(state)
        context = pass_segment.SegmentContext(
            self.raster, self.heights, scale, self.parameters, self.grid, arrays["labels"], arrays["grey"], self.backend
        )
        halo = pass_segment.halo(self.parameters, self.resolution, heights=self.heights is not None)
        writes = {name: arrays[name] for name in ("labels", "grey")}
        return self.device_pass("segment", pass_segment.segment, context, halo, writes, bytes_per_pixel=40)

    def reconcile(self, run: Run, facts: list[Facts]) -> Regions:
        """Regions of the raster; their published ids go to the state for the next pass."""
        with run.timed("reconcile regions"):
            p, r = self.parameters, self.resolution
            rows, columns = self.rectangle
            coarse = self.grid.coarsened(self.rectangle)
            regions = reconcile_regions(coarse, facts, tolerance=p.tolerance, rectangle=(rows * r, columns * r))
            selected = select(regions, p)
            if np.count_nonzero(selected) >= _MOST_REGIONS:
                raise InputError(f"more than {_MOST_REGIONS:,} street regions; raise minimum_size or minimum_contour")
            np.save(run.state / "lookup.npy", regions.lookup(selected))
            return regions

    def _line_context(self, state: Path, scale: GreyScale, regions: Regions, low: float) -> pass_lines.LineContext:
        offsets = tuple(regions.numbering.offsets.tolist())
        arrays = self.state_arrays(state)
        return pass_lines.LineContext(
            parameters=self.parameters,
            scale=scale,
            grid=self.grid,
            lookup=state / "lookup.npy",
            offsets=offsets,
            resolution=self.resolution,
            low=low,
            backend=self.backend,
            **arrays,
        )

    def thresholds(self, run: Run, scale: GreyScale, regions: Regions) -> Thresholds:
        """Thresholds of the line response and the noise of the grey levels, both global."""
        responses: list[Facts] = []
        if self.parameters.thresholds == "histogram":
            context = self._line_context(run.state, scale, regions, low=1e-6)
            halo = pass_lines.halo(self.parameters, self.resolution)
            job = self.device_pass("responses", count_responses, context, halo, bytes_per_pixel=40)
            responses = run.run_pass(job).all_facts()
        return line_thresholds(self.parameters, scale, self.resolution, responses)

    def lines_pass(self, state: Path, scale: GreyScale, regions: Regions, low: float) -> Pass:
        context = self._line_context(state, scale, regions, low)
        halo = pass_lines.halo(self.parameters, self.resolution)
        return self.device_pass("lines", pass_lines.find_lines, context, halo, bytes_per_pixel=60)

    def write_raster(self, run: Run, context: pass_lines.LineContext) -> Path:
        """Write ``streets.tif`` into the state folder; needs the regions only, so it runs beside the pass."""
        with run.timed("export raster"):
            path = run.state / "streets.tif"
            read = partial(pass_lines.published_regions, context)
            write_cog(path, read, "uint32", self.raster.geometry, nodata=pass_lines.NODATA, threads=1)
            return path

    def write_lines(self, run: Run, fragments: Ledger, thresholds: Thresholds) -> list[Path]:
        """Write the tables of both ways to centerlines into the state folder, side by side."""
        with ThreadPoolExecutor(min(len(LINE_LAYERS), self.options.workers)) as pool:
            paths = list(pool.map(partial(self._write_table, run, fragments, thresholds), LINE_LAYERS))
        return self.convert(run, paths)

    def _write_table(self, run: Run, fragments: Ledger, thresholds: Thresholds, name: str) -> Path:
        with run.timed(f"reconcile {name}"):
            prefix, path = LINE_LAYERS[name], run.state / f"{name}.parquet"
            rules, margin = self._rules(prefix, thresholds)
            write_centerlines(path, fragments, self.grid, prefix, rules, self._line_scale(thresholds), margin)
            return path

    def _line_scale(self, thresholds: Thresholds) -> LineScale:
        return LineScale(self.raster.geometry, thresholds.sigma, thresholds.noise, self.parameters.simplification)

    def _rules(self, prefix: str, thresholds: Thresholds) -> tuple[NetworkRules, int]:
        """Cleaning rules of one way to centerlines in pixels, and the width of the raster's border zone."""
        p = self.parameters
        pixels = 1 / self.resolution
        rules = NetworkRules(
            contraction=max(2.0, p.junction_distance * pixels),
            maximum_gap=p.maximum_gap * pixels,
            maximum_angle=min(max(p.maximum_gap_angle, 1.0), 89.0),
            minimum_branch=p.minimum_branch * pixels,
            minimum_length=p.minimum_length * pixels,
        )
        if prefix == pass_lines.RIDGE:
            return replace(rules, high=thresholds.high), int(np.ceil(thresholds.sigma))
        return rules, 2

    def plan(self) -> Plan:
        """What a run will do and need."""
        nowhere = Path(STATE)
        scale = GreyScale(0.0, 1.0, 0.0, 0.0, 1.0, 0.0)
        nothing, none = np.empty(0), np.empty(0, np.int64)
        regions = Regions(none, nothing, nothing, nothing, none, Numbering(np.zeros(1, np.int64)))
        passes = [
            self.levels_pass(),
            self.segment_pass(nowhere, scale),
            self.lines_pass(nowhere, scale, regions, 1.0),
        ]
        return plan_passes("streets", self.raster, passes, self.options)


def select(regions: Regions, parameters: StreetParameters) -> NDArray[np.bool_]:
    """Which regions are streets: by size, contour length, elongation and mean width (step 3 of the method)."""
    p = parameters
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            (regions.area >= p.minimum_size)
            & (regions.contour >= p.minimum_contour)
            & (regions.contour <= p.maximum_contour)
            & (regions.elongation >= p.minimum_elongation)
            & (regions.mean_width <= p.maximum_mean_width)
        )
