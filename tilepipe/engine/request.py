"""A checked request: the opened inputs, parameters and options of one run of a pipeline, before any work."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from tilepipe import __version__
from tilepipe.engine.inputs import Given, as_list, given_inputs
from tilepipe.engine.options import RunOptions
from tilepipe.engine.parameters import checked_parameters
from tilepipe.engine.pipeline import Pipeline, Setting
from tilepipe.engine.planning import Plan, plan_run
from tilepipe.engine.run_folder import Record, Uses
from tilepipe.engine.unchanged import INPUT_FILES
from tilepipe.errors import InputError
from tilepipe.io.files.paths import absolute_name
from tilepipe.io.rasters.bands import Choice
from tilepipe.io.rasters.raster import Raster, check_aligned, open_bands, open_raster
from tilepipe.io.rasters.raster_crs import check_raster_crs
from tilepipe.io.rasters.sources.source import Source
from tilepipe.io.vectors.gdal_tables import check_format
from tilepipe.tiling.grid import TileGrid, Window
from tilepipe_kernels.core.arrays import Backend


@dataclass(frozen=True)
class AlignedRaster:
    """A raster on the pixel grid of the main one, and the window of the main one's pixels that it covers."""

    raster: Raster
    window: Window

    def read(self, window: Window) -> NDArray[np.float32]:
        """Values of a window in pixels of the main raster, float32; NaN where this one has none or does not reach."""
        wanted = window.relative_to(self.window)
        part = wanted.intersection(Window(0, 0, *self.raster.shape))
        values = np.full(window.shape, np.nan, np.float32)
        if not part.is_empty:
            values[part.relative_to(wanted).slices] = self.raster.read(part)
        return values


@dataclass(frozen=True)
class Opened:
    """Inputs that have been opened and checked.

    Attributes
    ----------
    raster
        The main mosaic.
    inputs
        Further rasters by name.
    found
        What opening has told of them; goes into the record.
    source
        What the pipeline reads instead of `raster`, if it is not the mosaic itself.
    """

    raster: Raster
    inputs: Mapping[str, AlignedRaster] = field(default_factory=dict)
    found: Mapping[str, Any] = field(default_factory=dict)
    source: Any = None

    @property
    def sources(self) -> list[Source]:
        """All files and arrays that are read."""
        rasters = [self.raster, *(item.raster for item in self.inputs.values())]
        return list({id(member.source): member.source for raster in rasters for member in raster.members}.values())

    @property
    def elsewhere(self) -> tuple[str, ...]:
        """What is read on the network, and files that a VRT takes for raw pixels, whatever they are."""
        return tuple(dict.fromkeys(name for source in self.sources for name in source.elsewhere))


OpenInputs = Callable[[list[Any], Mapping[str, Given], Any, str | None, int | None], Opened]
"""Opens ``(rasters, further inputs, parameters, crs, band)``."""


def open_mosaic(
    rasters: list[Any], inputs: Mapping[str, Given], parameters: Any, crs: str | None, band: int | None
) -> Opened:
    """Open the main rasters as one mosaic, and each further input aligned to it.

    Raises
    ------
    InputError
        When a raster cannot be used, or a further one lies on other pixels or somewhere else.
    """
    raster = open_raster(rasters, crs=crs, band=band)
    further: dict[str, AlignedRaster] = {}
    for name, given in inputs.items():
        chosen = None if given.band is None else (given.band,)
        other = open_bands(given.rasters, Choice(chosen, option=given.declared.band_option), crs=crs)
        role = f"{name.removesuffix('s')} raster"
        window = check_aligned(other, raster, role)
        if window.intersection(Window(0, 0, *raster.shape)).is_empty:
            raise InputError(f"{other.names[0]}: the {role} does not overlap {raster.names[0]}")
        further[name] = AlignedRaster(other, window)
    return Opened(raster, further)


def checked_request(
    pipeline: Pipeline,
    rasters: Any,
    inputs: Mapping[str, Any],
    params: BaseModel | Mapping[str, Any] | None,
    crs: str | None,
    band: int | None,
    options: RunOptions | None,
) -> Request:
    """Open and check everything before any work; arguments and errors as for `plan_pipeline`."""
    kind = pipeline.parameters
    parameters = params if isinstance(params, kind) else checked_parameters(kind, dict(params or {}))
    given = given_inputs(pipeline.inputs, inputs)
    opened = (pipeline.open_inputs or open_mosaic)(as_list(rasters), given, parameters, crs, band)
    bands = {item.declared.band_option: item.band for item in given.values() if item.band is not None}
    request = Request(pipeline, opened, parameters, options or RunOptions(), crs, band, bands)
    if pipeline.heights:
        opened.raster.check_heights()
    for item in pipeline.inputs:
        if item.heights and item.name in opened.inputs:
            opened.inputs[item.name].raster.check_heights()
    text, name = opened.raster.geometry.crs, opened.raster.names[0]
    check_format(request.options.format, text, name)
    check_raster_crs(text, name)
    if pipeline.check:
        pipeline.check(request.setting)
    try:
        request.plan()
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        pixels = f"{request.setting.resolution:g}"
        raise InputError(f"the parameters do not suit pixels of {pixels} m: {error}") from None
    return request


def setting_of_record(pipeline: Pipeline, record: Record) -> Setting:
    """Setting of a run from its record alone.

    Raises
    ------
    InputError
        When the record lacks something that every record of a run holds.
    """
    raster, inputs, options = (record.get(name, {}) for name in ("raster", "inputs", "options"))
    if missing := [name for name in ("shape", "pixel", "metres") if name not in raster]:
        raise InputError(f"the record of the run is damaged: its [raster] has no {missing[0]}")
    known = {item.name for item in pipeline.inputs}
    return Setting(
        parameters=checked_parameters(pipeline.parameters, record.get("parameters", {})),
        shape=tuple(raster["shape"]),
        resolution=raster["pixel"] * raster["metres"],
        tile=RunOptions(tile=options.get("tile", RunOptions.tile)).tile,
        inputs=frozenset(known & set(inputs)),
        found=raster,
    )


@dataclass(frozen=True)
class Request:
    """One run of a pipeline, checked.

    Attributes
    ----------
    pipeline
        What to run.
    opened
        Its inputs.
    parameters
        Of the method.
    options
        How to run.
    crs, band
        As asked for.
    bands
        Of further inputs, as asked for, by the names of the options.
    """

    pipeline: Pipeline
    opened: Opened
    parameters: Any
    options: RunOptions
    crs: str | None
    band: int | None
    bands: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def setting(self) -> Setting:
        """What the passes depend on."""
        raster, opened = self.opened.raster, self.opened
        return Setting(
            self.parameters,
            raster.shape,
            raster.geometry.resolution,
            self.options.tile,
            frozenset(opened.inputs),
            opened.found,
        )

    @cached_property
    def grid(self) -> TileGrid:
        """Tiling of the raster."""
        return self.pipeline.grid(self.setting)

    @cached_property
    def backend(self) -> Backend:
        """The backend of the passes, as resolved."""
        return self.options.resolved_backend()

    @cached_property
    def resolved_options(self) -> RunOptions:
        """How the run is carried out: with a number of workers, whether or not one was asked for."""
        plan = self.plan()
        # what belongs to no tile may use more threads than there are tiles
        workers = plan.workers if plan.workers < plan.wanted else self.options.resolved_workers
        return replace(self.options, workers=workers)

    def plan(self) -> Plan:
        """What a run will do and need."""
        return replace(plan_run(self.pipeline, self.setting, self.options), elsewhere=self.opened.elsewhere)

    @property
    def uses(self) -> Uses:
        """Files that the run reads, those behind a VRT among them, and names of those that it may publish."""
        inputs = (path for source in self.opened.sources for path in source.paths)
        return Uses(tuple(dict.fromkeys(inputs)), tuple(name for item in self.pipeline.layers for name in item.files))

    def identity(self) -> Record:
        """Everything that decides the state on disk."""
        sources = self.opened.sources
        of_device = {"backend": self.backend} if self.backend == "cupy" else {}
        own_code = {} if _is_own(self.pipeline) else {"code": _fingerprint(self.pipeline)}
        return (
            {
                "command": self.pipeline.name,
                "version": __version__,
                "sources": [absolute_name(source.name) for source in sources],
                INPUT_FILES: [line for source in sources for line in source.lines],
                "raster": asdict(self.opened.raster.geometry)
                | {"tile": list(self.grid.tile_shape), "band": self.band}
                | dict(self.bands),
                "parameters": self.parameters.model_dump(),
            }
            | ({"seed": self.options.seed} if self.pipeline.seeded else {})
            | of_device
            | own_code
        )

    def record(self, out: str | Path) -> Record:
        """Everything as resolved, for ``run.toml``."""
        options = asdict(self.resolved_options) | {"backend": self.backend}
        options.pop("overwrite")
        raster = self.opened.raster
        inputs: dict[str, Any] = {"rasters": [absolute_name(name) for name in raster.names]}
        for key, item in self.opened.inputs.items():
            inputs[key] = [absolute_name(name) for name in item.raster.names]
        return {
            "command": self.pipeline.name,
            "version": __version__,
            "out": str(Path(out).absolute()),
            "elsewhere": list(self.opened.elsewhere) or None,
            "inputs": inputs | {"crs": self.crs, "band": self.band} | dict(self.bands),
            "raster": asdict(raster.geometry) | {"tile": list(self.grid.tile_shape)} | dict(self.opened.found),
            "options": options,
            "parameters": self.parameters.model_dump(),
        }


def _is_own(pipeline: Pipeline) -> bool:
    """Whether the version of tilepipe says what the pipeline's code is."""
    # code typed in has no module
    return (pipeline.recipe.__module__ or "").partition(".")[0] == __name__.partition(".")[0]


def _fingerprint(pipeline: Pipeline) -> str:
    """Hash of the files in which the recipe and the tile functions stand: no run is resumed by other code."""
    functions: list[Callable[..., Any]] = [pipeline.recipe, *(item.function for item in pipeline.passes)]
    files = sorted({file for function in functions if (file := inspect.getsourcefile(function))})
    return hashlib.sha256(b"".join(Path(file).read_bytes() for file in files)).hexdigest()[:16]


def plan_pipeline(
    pipeline: Pipeline,
    rasters: Any,
    *,
    inputs: Mapping[str, Any] | None = None,
    params: BaseModel | Mapping[str, Any] | None = None,
    crs: str | None = None,
    band: int | None = None,
    options: RunOptions | None = None,
) -> Plan:
    """Tiles, passes, halos and memory of a run, before any work.

    Parameters
    ----------
    pipeline
        What is to run.
    rasters
        One or many paths (GeoTIFF, COG, VRT, Zarr) or xarray arrays, one mosaic.
    inputs
        Further rasters by the names that the pipeline declares, None where there are none; and which of their bands
        to use, by the name of the option, such as ``height_band``.
    params
        Parameters of the method.
    crs
        ``EPSG:n`` for inputs that name no CRS.
    band
        Band to use where a raster has several.
    options
        Tiles, workers, memory: how, not what.

    Raises
    ------
    InputError
        When an input or a parameter cannot be used.
    """
    return checked_request(pipeline, rasters, inputs or {}, params, crs, band, options).plan()
