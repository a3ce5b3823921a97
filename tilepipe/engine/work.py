"""What a recipe works with: the inputs of a run, its tiles, and the folder of its state."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from tilepipe.engine.gathering import Gathering
from tilepipe.engine.layers import RasterLayer
from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pass, Pipeline, Setting, amount
from tilepipe.engine.progress import Progress, Silent
from tilepipe.engine.request import AlignedRaster, Request, checked_request
from tilepipe.engine.run import Run, open_run
from tilepipe.engine.run_folder import is_unfinished, sweep_finished
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.passes import BoundPass
from tilepipe.engine.tiles.state import StateArray
from tilepipe.engine.warm_up import compiled_beside
from tilepipe.errors import InputError
from tilepipe.io.files.paths import local_output, side_file
from tilepipe.io.rasters.cog import write_cog
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.rasters.raster import Raster
from tilepipe.io.vectors.formats import convert
from tilepipe.tiling.grid import TileGrid, Window
from tilepipe_kernels.core.arrays import Backend, why_no_device
from tilepipe_kernels.core.device_memory import device_memory

Result = TypeVar("Result")


class Work:
    """A run at work, handed to the recipe of its pipeline."""

    def __init__(self, request: Request, run: Run) -> None:
        self.request = request
        self._run = run
        self._gathering = Gathering(request.plan(), request.setting)

    @property
    def raster(self) -> Raster:
        """The main mosaic."""
        return self.request.opened.raster

    @property
    def source(self) -> Any:
        """What opening the inputs has made of the main rasters, where that is not the mosaic."""
        return self.request.opened.source

    def input(self, name: str) -> AlignedRaster | None:
        """A further input, if it was given; only of those that the pipeline declares."""
        _declared(name, [item.name for item in self.request.pipeline.inputs], "input")
        return self.request.opened.inputs.get(name)

    @property
    def setting(self) -> Setting:
        """What the passes depend on."""
        return self.request.setting

    @property
    def parameters(self) -> Any:
        """Parameters of the pipeline."""
        return self.request.parameters

    @property
    def options(self) -> RunOptions:
        """How to run."""
        return self.request.resolved_options

    @property
    def geometry(self) -> Geometry:
        """Grid of the raster."""
        return self.raster.geometry

    @property
    def resolution(self) -> float:
        """Pixel size in metres."""
        return self.geometry.resolution

    @property
    def grid(self) -> TileGrid:
        """Tiling of the raster."""
        return self.request.grid

    @property
    def backend(self) -> Backend:
        """Backend of the passes."""
        return self.request.backend

    @cached_property
    def backend_here(self) -> Backend:
        """Backend of what belongs to no tile, and stays on this machine when a cluster has the tiles."""
        if self.backend == "cupy" and self.options.uses_cluster and why_no_device():
            return "numpy"
        return self.backend

    @property
    def folder(self) -> Path:
        """Folder of the state, where layers are written before they are published together."""
        return self._run.state

    @property
    def progress(self) -> Progress:
        """Told about stages that count by themselves."""
        return self._run.progress

    def state(self, name: str) -> StateArray:
        """A state raster that one of the passes declares."""
        states = {key: state for item in self.request.pipeline.passes for key, state in item.writes.items()}
        declared = states[_declared(name, states, "state")]
        grid = self.grid.coarsened(self.request.pipeline.cell(self.setting)) if declared.per_cell else self.grid
        return StateArray(self.folder / f"{name}.zarr", grid, declared.dtype, declared.fill)

    def over_tiles(self, declared: Pass, context: Any) -> Ledger:
        """Run a pass on all tiles that are not done yet.

        Parameters
        ----------
        declared
            One of the passes of the pipeline.
        context
            Everything that its function needs, picklable.

        Returns
        -------
        Ledger
            Facts of all tiles.

        Raises
        ------
        MemoryLimitError
            When they are so many that what gathers them would need more than the run may use; they are kept.
        """
        if declared not in self.request.pipeline.needed_passes(self.setting):
            raise ValueError(f"pass '{declared.name}' is none of those that the pipeline needs in this setting")
        bound = BoundPass(
            declared.name,
            declared.function,
            context,
            self.grid,
            amount(declared.halo, self.setting),
            {name: self.state(name) for name in declared.writes},
            self.backend if declared.on_device else "numpy",
            self.options.device_memory,
        )
        ledger = self._run.run_pass(bound)
        self._gathering.count(declared, ledger)
        return ledger

    def beside(self, function: Callable[..., Result], *arguments: Any) -> AbstractContextManager[Future[Result]]:
        """Run a function in a thread of its own beside a block, which ends when it has ended."""
        return self._run.beside(function, *arguments)

    def timed(self, name: str) -> AbstractContextManager[None]:
        """Add the wall time of a block to the timings of a stage."""
        return self._run.timed(name)

    def write_raster(self, name: str, read: Callable[[Window], Any]) -> Path:
        """Write a raster layer of the pipeline into the state folder.

        Parameters
        ----------
        name
            Name of a declared layer.
        read
            Gives the values of any window.
        """
        layers = {layer.name: layer for layer in self.request.pipeline.layers if isinstance(layer, RasterLayer)}
        layer = layers[_declared(name, layers, "raster layer")]
        path = self.folder / name
        write_cog(path, read, layer.dtype, self.geometry, nodata=layer.nodata, threads=1)
        return path

    def in_format(self, tables: Sequence[Path]) -> list[Path]:
        """Finished tables in the format asked for; one at a time, since GDAL's options are global."""
        form = self.options.format
        if form == "parquet":
            return list(tables)
        with self.timed("convert"):
            return [convert(path, form) for path in tables]


def _declared(name: str, declared: Collection[str], kind: str) -> str:
    """The name of something that the pipeline declares."""
    if name not in declared:
        raise ValueError(f"the pipeline declares no {kind} '{name}'; it declares {', '.join(declared) or 'none'}")
    return name


def _whole_layers(pipeline: Pipeline, paths: Iterable[Path]) -> list[Path]:
    """What a recipe has returned and the files beside it, once it is certain that all of it can be published.

    Raises
    ------
    InputError
        When a file is no layer of the pipeline, or was never written.
    """
    layers, names = list(paths), {name for layer in pipeline.layers for name in layer.files}
    for path in layers:
        if path.name not in names:
            raise InputError(f"the recipe of {pipeline.name} returns {path.name}, which is none of its layers")
        if not path.is_file():
            raise InputError(f"the recipe of {pipeline.name} returns {path.name}, but has not written it")
    return [file for path in layers for file in (path, side_file(path)) if file.is_file()]


def run_pipeline(
    pipeline: Pipeline,
    rasters: Any,
    out: str | Path,
    *,
    inputs: Mapping[str, Any] | None = None,
    params: BaseModel | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Run a pipeline, or resume it, in a folder.

    Parameters
    ----------
    pipeline
        What to run.
    out
        Folder of the run; receives the layers of the pipeline and ``run.toml``, the record that repeats it.
    progress
        Told about the progress.
    rasters, inputs, params, crs, band, options
        As for `tilepipe.engine.request.plan_pipeline`.

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
    folder = local_output(out).absolute()
    request = checked_request(pipeline, rasters, inputs or {}, params, crs, band, options)
    sources = request.opened.sources
    options = request.resolved_options
    plan = request.plan()
    plan.check(options)
    if request.backend == "cupy" and not options.uses_cluster:
        plan.check_device(device_memory(), options)
    record = request.record(folder)
    # a second process that compiles is in no plan
    here = request.backend == "numpy" and not options.uses_cluster
    warm_up = pipeline.warm_up if here and plan.has_room else ""
    published: list[Path] = []
    try:
        with (
            compiled_beside(warm_up),
            open_run(folder, record, request.identity(), options, progress or Silent(), request.uses, sources) as run,
        ):
            layers = _whole_layers(pipeline, pipeline.recipe(Work(request, run)))
            for source in sources:
                source.check()
            published += [folder / layer.name for layer in layers]
            run.publish(layers, record)
    except KeyboardInterrupt:
        if not published or is_unfinished(folder):
            raise
        # its record has appeared, so the run is finished and all that it still had to do is this
        sweep_finished(folder)
    return published
