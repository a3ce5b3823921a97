"""What every pipeline does around its own passes: check, begin or resume a run, publish, remember."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel

from tilepipe import __version__
from tilepipe.engine.options import RunOptions
from tilepipe.engine.passes import Pass, TileFunction
from tilepipe.engine.planning import Plan
from tilepipe.engine.progress import Progress, Silent
from tilepipe.engine.run import Record, Run, absolute_name, open_run
from tilepipe.engine.state import StateArray
from tilepipe.io.formats import convert
from tilepipe.io.raster import Raster
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.core.arrays import Backend, device_memory

PICTURES = ("quicklook.png", "quicklook_detail.png", "quicklook_buildings.png", "report.html")


@dataclass(frozen=True)
class Job(ABC):
    """A checked request to run a pipeline.

    Attributes
    ----------
    raster
        The input mosaic.
    parameters
        Of the method.
    options
        How to run.
    crs, band
        As asked for.
    others
        Further rasters by the name that the record's inputs give them.
    """

    command: ClassVar[str]
    rasters: ClassVar[tuple[str, ...]]
    tables: ClassVar[tuple[str, ...]]
    seeded: ClassVar[bool]

    raster: Raster
    parameters: BaseModel
    options: RunOptions
    crs: str | None
    band: int | None
    others: dict[str, Raster] = field(default_factory=dict, kw_only=True)

    @abstractmethod
    def plan(self) -> Plan:
        """What a run will do and need."""

    @abstractmethod
    def layers(self, run: Run) -> list[Path]:
        """Passes and reconciliations; returns the finished layers in the state folder."""

    @cached_property
    def backend(self) -> Backend:
        """The backend of the passes, as resolved."""
        return self.options.resolved_backend()

    @property
    def resolution(self) -> float:
        """Pixel size in metres."""
        return self.raster.geometry.resolution

    @property
    @abstractmethod
    def tile_shape(self) -> tuple[int, int]:
        """Rows and columns of a tile."""

    @property
    @abstractmethod
    def grid(self) -> TileGrid:
        """Tiling of the raster."""

    def device_pass(
        self,
        name: str,
        function: TileFunction,
        context: Any,
        halo: int,
        writes: Mapping[str, StateArray] | None = None,
        *,
        bytes_per_pixel: int,
    ) -> Pass:
        """A pass that works on arrays of the run's backend; its context has been told the same one."""
        return Pass(
            name, function, context, self.grid, halo, writes or {}, bytes_per_pixel, self.backend,
            self.options.device_memory,
        )  # fmt: skip

    def run(self, out: str | Path, progress: Progress | None) -> list[Path]:
        """Run or resume in a folder; returns the published layers."""
        plan = self.plan()
        plan.check(self.options)
        if self.backend == "cupy" and not self.options.uses_cluster:
            plan.check_device(device_memory(), self.options)
        record = self.record(out)
        with open_run(Path(out).absolute(), record, self.identity(), self.options, progress or Silent()) as run:
            layers = self.layers(run)
            run.publish(layers, record, keep=self._all_names())
            return [run.folder / layer.name for layer in layers]

    def convert(self, run: Run, tables: Sequence[Path]) -> list[Path]:
        """Finished tables in the format asked for; one at a time, since GDAL's options are global."""
        form = self.options.format
        if form == "parquet":
            return list(tables)
        with run.timed("convert"):
            return [convert(path, form) for path in tables]

    def _all_names(self) -> tuple[str, ...]:
        tables = [f"{name}.{suffix}" for name in self.tables for suffix in ("parquet", "gpkg", "fgb", "geojson")]
        return (*self.rasters, *tables, *PICTURES)

    def identity(self) -> Record:
        """Everything that decides the state on disk."""
        sources = [member.source for raster in (self.raster, *self.others.values()) for member in raster.members]
        of_device = {"backend": self.backend} if self.backend == "cupy" else {}
        return (
            {
                "command": self.command,
                "version": __version__,
                "sources": [f"{absolute_name(source.name)} {source.stamp}" for source in sources],
                "raster": asdict(self.raster.geometry) | {"tile": list(self.tile_shape), "band": self.band},
                "parameters": self.parameters.model_dump(),
            }
            | ({"seed": self.options.seed} if self.seeded else {})
            | of_device
        )

    def record(self, out: str | Path) -> Record:
        """Everything as resolved, for ``run.toml``."""
        options = asdict(self.options) | {"backend": self.backend}
        options.pop("overwrite")
        inputs: dict[str, Any] = {"rasters": [absolute_name(name) for name in self.raster.names]}
        inputs |= {key: [absolute_name(name) for name in raster.names] for key, raster in self.others.items()}
        return {
            "command": self.command,
            "version": __version__,
            "out": str(Path(out).absolute()),
            "inputs": inputs | {"crs": self.crs, "band": self.band},
            "raster": asdict(self.raster.geometry) | {"tile": list(self.tile_shape)},
            "options": options,
            "parameters": self.parameters.model_dump(),
        }


def as_list(items: Any) -> list[Any]:
    """One or many inputs as a list."""
    return list(items) if isinstance(items, (list, tuple)) else [items]
