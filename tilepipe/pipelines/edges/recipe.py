"""The edges pipeline (Barbosa 1994): an aerial photograph in, its segmentation, line field and edge lines out."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tilepipe.engine.ledger import Ledger
from tilepipe.engine.options import RunOptions
from tilepipe.engine.passes import Pass
from tilepipe.engine.pipeline import Job, as_list
from tilepipe.engine.planning import Plan, plan_passes
from tilepipe.engine.progress import Progress
from tilepipe.engine.run import STATE, Record, Run
from tilepipe.engine.state import StateArray
from tilepipe.io.cog import write_cog
from tilepipe.pipelines.edges.parameters import EdgeParameters, edge_parameters
from tilepipe.pipelines.edges.pass_bands import PRINCIPAL_COMPONENT, Photograph, open_photograph, sample_bands
from tilepipe.pipelines.edges.pass_fields import NODATA, FieldContext, bytes_per_pixel, count_fields, find_fields, halo
from tilepipe.pipelines.edges.pass_levels import CountContext, LevelScale, count_greys, edge_threshold, level_scale
from tilepipe.pipelines.edges.tables import write_edges, write_nevatia_babu
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid
from tilepipe.tiling.histograms import added

SUMMARY = "edges.json"

_PER_MEGAPIXEL = 12_000_000
"""Lines of a city at half a metre and edge elements in bytes per Mpx, while tables are made of them."""

_WITHOUT_LINES = {
    "edges": "lower minimum_length or raise levels (--set)",
    "nevatia_babu": "raise edge_share or lower minimum_edge_length (--set)",
}
"""What to do when a table has no line."""

_MOST_UNRESOLVED = 1e-4
"""Share of sites that still want to change above which a warning is due."""


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
    """
    return _prepare(rasters, params, crs, band, options).run(out, progress)


def plan_edges(
    rasters: Sequence[Any] | Any,
    *,
    params: EdgeParameters | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work; arguments and errors as for `edges`."""
    return _prepare(rasters, params, crs, band, options).plan()


def pass_sizes(record: Record) -> dict[str, int]:
    """Number of tiles of each pass of an unfinished run, from its record."""
    grid = TileGrid(tuple(record["raster"]["shape"]), tuple(record["raster"]["tile"]))
    names = ["levels", "fields"]
    if record["raster"].get("grey") == PRINCIPAL_COMPONENT:
        names.insert(0, "bands")
    return dict.fromkeys(names, len(grid))


def _prepare(rasters: Any, params: Any, crs: str | None, band: int | None, options: RunOptions | None) -> _Job:
    """Open and check everything before any work."""
    parameters = params if isinstance(params, EdgeParameters) else edge_parameters(dict(params or {}))
    photograph = open_photograph(as_list(rasters), crs=crs, band=band, grey=parameters.grey)
    return _Job(photograph.raster, parameters, options or RunOptions(), crs, band, photograph=photograph)


@dataclass(frozen=True)
class _Job(Job):
    """A checked request: its tiling, its passes and its reconciliations."""

    command = "edges"
    rasters = ("segments.tif", "lines.tif", SUMMARY)
    tables = ("edges", "nevatia_babu")
    seeded = True

    parameters: EdgeParameters
    photograph: Photograph = field(kw_only=True)

    def layers(self, run: Run) -> list[Path]:
        photograph = self.grey(run)
        counts = list(run.run_pass(self.levels_pass(photograph)).each())
        scale = level_scale(added(counts, "grey"), added(counts, "difference"), self.parameters, self.raster.names[0])
        finding = self.fields_pass(run.state, photograph, scale, self.threshold(counts))
        fields = run.run_pass(finding)
        with run.beside(self.write_rasters, run, finding.context) as rasters:
            tables = self.write_tables(run, fields)
            summary = self.write_summary(run, photograph, scale, fields)
            return [*rasters.result(), *tables, summary]

    @property
    def grid(self) -> TileGrid:
        """Square tiles of the size asked for."""
        return TileGrid(self.raster.shape, self.tile_shape)

    @property
    def tile_shape(self) -> tuple[int, int]:
        return self.options.tile, self.options.tile

    def grey(self, run: Run) -> Photograph:
        """The photograph with the weights of its bands, which a principal component needs a pass for."""
        if self.photograph.weights is not None:
            return self.photograph
        job = Pass("bands", sample_bands, self.photograph, self.grid, halo=0, bytes_per_pixel=16)
        return self.photograph.with_principal_component(run.run_pass(job).each())

    def levels_pass(self, photograph: Photograph) -> Pass:
        context = CountContext(photograph, self.parameters.nevatia_babu, self.backend)
        return self.device_pass("levels", count_greys, context, context.halo, bytes_per_pixel=24)

    def threshold(self, counts: list[Facts]) -> float:
        """Threshold of the classical method, global."""
        if not self.parameters.nevatia_babu:
            return 0.0
        return edge_threshold(added(counts, "edge"), self.parameters.edge_share)

    def fields_pass(self, state: Path, photograph: Photograph, scale: LevelScale, threshold: float) -> Pass:
        levels = StateArray(state / "levels.zarr", self.grid, "uint8", NODATA)
        lines = StateArray(state / "lines.zarr", self.grid, "uint8", NODATA)
        context = FieldContext(
            photograph, scale, self.parameters, levels, lines, threshold, self.options.seed, self.backend
        )
        writes = {"levels": levels, "lines": lines}
        per_pixel = bytes_per_pixel(self.parameters)
        return self.device_pass(
            "fields", find_fields, context, halo(self.parameters), writes, bytes_per_pixel=per_pixel
        )

    def write_rasters(self, run: Run, context: FieldContext) -> list[Path]:
        """Write both fields into the state folder."""
        with run.timed("export rasters"):
            paths = []
            for name, array in (("segments.tif", context.levels), ("lines.tif", context.lines)):
                path = run.state / name
                write_cog(path, array.read, "uint8", self.raster.geometry, nodata=NODATA, threads=1)
                paths.append(path)
            return paths

    def write_tables(self, run: Run, fields: Ledger) -> list[Path]:
        """Write the tables of both methods into the state folder; warn of one without lines."""
        geometry, workers = self.raster.geometry, self.options.workers
        writers: dict[str, Callable[..., int]] = {"edges": partial(write_edges, workers=workers)}
        if self.parameters.nevatia_babu:
            writers["nevatia_babu"] = write_nevatia_babu

        def write(name: str) -> int:
            with run.timed(f"reconcile {name}"):
                return writers[name](run.state / f"{name}.parquet", fields, geometry, self.parameters)

        with ThreadPoolExecutor(min(len(writers), workers)) as pool:
            found = dict(zip(writers, pool.map(write, writers), strict=True))
        for name, count in found.items():
            if not count:
                warnings.warn(f"{name} has no line; {_WITHOUT_LINES[name]}", stacklevel=4)
        return self.convert(run, [run.state / f"{name}.parquet" for name in writers])

    def write_summary(self, run: Run, photograph: Photograph, scale: LevelScale, fields: Ledger) -> Path:
        """Write what the whole image says of itself; warn when the cap on rounds has left much."""
        found, model = count_fields(fields.each()), self.parameters.model(scale.noise)
        annealing = self.parameters.optimiser == "annealing"
        sites = 3 * self.raster.shape[0] * self.raster.shape[1]
        if found.unresolved > _MOST_UNRESOLVED * sites:
            sweeps = f"{self.parameters.sweeps} sweeps and " if annealing else ""
            warnings.warn(
                f"{found.unresolved:,} of {sites:,} sites still wanted to change after {sweeps}"
                f"{self.parameters.rounds} rounds; use --set rounds=n with a larger n",
                stacklevel=4,
            )
        values = {
            "grey": photograph.conversion,
            "band_weights": photograph.weights,
            "grey_range": [scale.darkest, scale.brightest],
            "level_values": [scale.darkest + mean / 255 * (scale.brightest - scale.darkest) for mean in scale.means],
            "noise_in_levels": scale.noise,
            "energy": found.terms.total(model),
            "energy_of_levels": found.terms.intensity(model),
            "energy_of_lines": found.terms.lines(model),
            # rounds of descent come after the sweeps
            **({"sweeps": self.parameters.sweeps} if annealing else {}),
            "most_rounds": self.parameters.rounds,
            "unresolved_sites": found.unresolved,
        }
        path = run.state / SUMMARY
        path.write_text(json.dumps(values, indent=1) + "\n")
        return path

    def record(self, out: str | Path) -> Record:
        """Everything as resolved, for ``run.toml``."""
        record = super().record(out)
        record["raster"]["grey"] = self.photograph.conversion
        return record

    def plan(self) -> Plan:
        """What a run will do and need."""
        nowhere = Path(STATE)
        scale = LevelScale(0.0, 1.0, (0.0, 255.0), 1.0)
        passes = [self.levels_pass(self.photograph), self.fields_pass(nowhere, self.photograph, scale, 0.0)]
        if self.photograph.weights is None:
            passes.insert(0, Pass("bands", sample_bands, self.photograph, self.grid, halo=0, bytes_per_pixel=16))
        return plan_passes("edges", self.raster, passes, self.options, _PER_MEGAPIXEL)
