"""The objects pipeline (Galvanin et al. 2007): lidar heights in, object polygons and their boundaries out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tilepipe.engine.device import fitting
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
from tilepipe.io.raster import open_raster
from tilepipe.pipelines.objects import pass_borders, pass_leaves
from tilepipe.pipelines.objects.diagnostics import as_text, diagnose, warning
from tilepipe.pipelines.objects.parameters import ObjectParameters, object_parameters
from tilepipe.pipelines.objects.reconcile_buildings import Buildings, find_buildings
from tilepipe.pipelines.objects.reconcile_leaves import Leaves, reconcile_leaves
from tilepipe.pipelines.objects.reconcile_regions import Merged, merge_regions
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.core.arrays import Backend, why_no_device
from tilepipe_kernels.regions.merging import RegionGraph
from tilepipe_kernels.regions.quadtree import LARGEST_SIDE

_PER_MEGAPIXEL = 100_000 * 250
"""Leaves of a city at half a metre, and what graph, sampler and tables hold of each in bytes: 250 were measured."""

_PLAUSIBLE = -500.0, 9000.0
"""Heights on land in metres."""

CONVERGENCE = "convergence.json"


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
    """
    return _prepare(rasters, params, crs, band, options).run(out, progress)


def plan_objects(
    rasters: Sequence[Any] | Any,
    *,
    params: ObjectParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `objects`."""
    return _prepare(rasters, params, crs, band, options).plan()


def pass_sizes(record: Record) -> dict[str, int]:
    """Number of tiles of each pass of an unfinished run, from its record."""
    grid = TileGrid(tuple(record["raster"]["shape"]), tuple(record["raster"]["tile"]))
    return dict.fromkeys(("leaves", "borders"), len(grid))


def _prepare(rasters: Any, params: Any, crs: str | None, band: int | None, options: RunOptions | None) -> _Job:
    """Open and check everything before any work."""
    parameters = params if isinstance(params, ObjectParameters) else object_parameters(dict(params or {}))
    raster = open_raster(as_list(rasters), crs=crs, band=band)
    job = _Job(raster, parameters, options or RunOptions(), crs, band)
    _, largest = parameters.leaf_sides(job.resolution)
    if largest > LARGEST_SIDE:
        most = LARGEST_SIDE * job.resolution
        raise InputError(f"parameter largest_leaf={parameters.largest_leaf:g}: at most {most:g} m at this resolution")
    return job


@dataclass(frozen=True)
class _Job(Job):
    """A checked request: its tiling, its passes and its reconciliations."""

    command = "objects"
    rasters = ("regions.tif", CONVERGENCE)
    tables = ("objects", "boundaries", "buildings")
    seeded = True

    parameters: ObjectParameters

    def layers(self, run: Run) -> list[Path]:
        leaves, merged = self.merge(run, *self.reconcile(run, run.run_pass(self.leaves_pass(run.state))))
        tracing = self.borders_pass(run.state, tuple(leaves.numbering.offsets.tolist()))
        with (
            run.beside(self.write_raster, run, tracing.context) as raster,
            run.beside(self.find_buildings, run, leaves, merged) as buildings,
        ):
            borders = run.run_pass(tracing)
            tables = self.write_tables(run, borders, leaves, merged, buildings.result())
            return [raster.result(), *tables, self.write_convergence(run, merged)]

    @property
    def grid(self) -> TileGrid:
        """Tiles of whole largest leaves, so that no leaf is cut by a seam."""
        _, largest = self.parameters.leaf_sides(self.resolution)
        side = max(largest, self.options.tile // largest * largest)
        return TileGrid(self.raster.shape, (side, side))

    @property
    def tile_shape(self) -> tuple[int, int]:
        return self.grid.tile_shape

    def labels(self, state: Path) -> StateArray:
        return StateArray(state / "labels.zarr", self.grid, "int32")

    def leaves_pass(self, state: Path) -> Pass:
        labels = self.labels(state)
        context = pass_leaves.LeafContext(self.raster, self.parameters, self.grid, labels, self.backend)
        return self.device_pass(
            "leaves", pass_leaves.find_leaves, context, context.halo, {"labels": labels}, bytes_per_pixel=60
        )  # fmt: skip

    def reconcile(self, run: Run, ledger: Ledger) -> tuple[Leaves, RegionGraph]:
        """Leaves of the raster and their graph.

        Raises
        ------
        InputError
            When the raster holds only nodata.
        """
        with run.timed("reconcile leaves"):
            facts = ledger.all_facts()
            absurd = sum(int(found["absurd"][0]) for found in facts)
            leaves, graph = reconcile_leaves(self.grid, facts, self.parameters.split_deviation**2)
            if not leaves.first.size:
                raise InputError(
                    f"{self.raster.names[0]}: holds nothing but nodata; check the file and its nodata value"
                )
            self._warn_of_heights(leaves, absurd)
            return leaves, graph

    def _warn_of_heights(self, leaves: Leaves, absurd: int) -> None:
        """Say what heights can hardly be meant: another unit, or a nodata value that nobody has declared."""
        name, advice = self.raster.names[0], "check the unit of the heights and the nodata value"
        if absurd:
            warnings.warn(
                f"{name}: {absurd:,} pixels hold no possible height and count as nodata; {advice}", stacklevel=4
            )
        low, high = float(leaves.lowest.min()), float(leaves.highest.max())
        if low < _PLAUSIBLE[0] or high > _PLAUSIBLE[1]:
            warnings.warn(f"{name}: heights from {low:,.0f} to {high:,.0f} m; {advice}", stacklevel=4)

    @cached_property
    def graph_backend(self) -> Backend:
        """Backend of the region graph, which belongs to no tile and stays here when a cluster has the tiles."""
        if self.backend == "cupy" and self.options.uses_cluster and why_no_device():
            return "numpy"
        return self.backend

    def merge(self, run: Run, leaves: Leaves, graph: RegionGraph) -> tuple[Leaves, Merged]:
        """The leaves and their merged regions, whose ids go to the state for the next pass."""
        with run.timed("merge"):
            given_up = [graph]
            del graph  # nobody holds the graph of the leaves any more once it has merged
            advice = "use larger leaves (smallest_leaf) or --backend numpy"
            with fitting("the region graph", advice, self.graph_backend):
                merged = merge_regions(
                    given_up.pop(),
                    leaves.first,
                    self.parameters,
                    resolution=self.resolution,
                    seed=self.options.seed,
                    workers=self.options.workers,
                    tell=run.progress,
                    backend=self.graph_backend,
                )
            np.save(run.state / "lookup.npy", leaves.lookup((merged.region + 1).astype(np.uint32)))
            return leaves, merged

    def find_buildings(self, run: Run, leaves: Leaves, merged: Merged) -> Buildings | None:
        """Buildings among the regions, if they are asked for."""
        if leaves.relief is None:
            return None
        with run.timed("buildings"):
            return find_buildings(
                leaves,
                leaves.relief,
                merged,
                self.parameters,
                resolution=self.resolution,
                seed=self.options.seed,
                backend=self.graph_backend,
            )

    def borders_pass(self, state: Path, offsets: tuple[int, ...]) -> Pass:
        context = pass_borders.RegionContext(self.grid, self.labels(state), state / "lookup.npy", offsets)
        return Pass("borders", pass_borders.trace_borders, context, self.grid, halo=1, bytes_per_pixel=40)

    def write_raster(self, run: Run, context: pass_borders.RegionContext) -> Path:
        """Write ``regions.tif`` into the state folder."""
        with run.timed("export raster"):
            path = run.state / "regions.tif"
            write_cog(path, context.read, "uint32", self.raster.geometry, nodata=0, threads=1)
            return path

    def write_tables(
        self, run: Run, borders: Ledger, leaves: Leaves, merged: Merged, buildings: Buildings | None
    ) -> list[Path]:
        """Write the tables into the state folder."""
        with run.timed("polygons"):
            geometry, workers = self.raster.geometry, self.options.workers
            paths = pass_borders.write_tables(
                run.state, borders, leaves, merged, buildings, geometry, self.parameters, workers
            )
        return self.convert(run, paths)

    def write_convergence(self, run: Run, merged: Merged) -> Path:
        """Write the sampler's diagnostics into the state folder; warn when it has not converged."""
        found = diagnose(merged.first, fixed_variance=self.parameters.variance is not None)
        if (text := warning(found)) is not None:
            warnings.warn(text, stacklevel=3)
        path = run.state / CONVERGENCE
        path.write_text(as_text(found))
        return path

    def plan(self) -> Plan:
        """What a run will do and need."""
        nowhere = Path(STATE)
        passes = [self.leaves_pass(nowhere), self.borders_pass(nowhere, ())]
        return plan_passes("objects", self.raster, passes, self.options, _PER_MEGAPIXEL)
