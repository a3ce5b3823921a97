"""What a run will need, before any work: tiles, halos, and memory against the limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tilepipe.engine.options import RunOptions, format_memory
from tilepipe.engine.passes import Pass
from tilepipe.errors import InputError
from tilepipe.io.raster import Raster

_BASE = 500 << 20
"""Memory of the interpreter, the libraries and the kernels, compiled on first use."""

_EXPORT = 160 << 20
"""Memory of the libraries that write layers and of GDAL's cache."""

_EXPORT_PER_COLUMN = 16 << 10
"""Strips of the layer being written and of its overviews, in bytes per column of the raster."""

_PER_SEAM_PIXEL = 160
"""Global facts (edges of cores, region table, seam graph) per pixel of the seams, in bytes."""

_PER_TILE = 1 << 20
"""Global facts that do not depend on the tile's size, in bytes."""

_PER_MEGAPIXEL = 800_000
"""Fragment tables and the batch of lines being written, in bytes per Mpx of raster."""


@dataclass(frozen=True)
class PassPlan:
    """One pass: its name, halo in pixels, share of pixels read more than once, memory of all workers in bytes."""

    name: str
    halo: int
    overhead: float
    memory: int


@dataclass(frozen=True)
class Plan:
    """What a run will do and need."""

    command: str
    shape: tuple[int, int]
    resolution: float
    tile_shape: tuple[int, int]
    tiles: int
    workers: int
    processes: bool
    passes: tuple[PassPlan, ...]
    global_memory: int
    export_memory: int
    limit: int

    @property
    def memory(self) -> int:
        """Peak memory in bytes: interpreter, hungriest pass on all workers with halos, global facts, export.

        What a pass has freed stays with the process for the most part, so the export comes on top of it.
        """
        interpreters = 1 + (self.workers if self.processes else 0)
        return _BASE * interpreters + max(p.memory for p in self.passes) + self.global_memory + self.export_memory

    @property
    def least_memory(self) -> int:
        """What is needed besides the tiles, in bytes."""
        return self.memory - max(p.memory for p in self.passes)

    def check(self, options: RunOptions) -> None:
        """Refuse a run that needs more memory than allowed.

        Raises
        ------
        InputError
            Says how much is needed and which tile size or number of workers would fit.
        """
        if self.memory <= options.memory:
            return
        if self.least_memory > options.memory:
            raise InputError(
                f"the run needs at least {format_memory(self.least_memory)} whatever the tiles, for libraries and "
                f"export, but --memory is {format_memory(options.memory)}; use a larger --memory"
            )
        fewer = f", or fewer workers than {self.workers}" if self.workers > 1 else ""
        raise InputError(
            f"the run needs about {format_memory(self.memory)} but --memory is {format_memory(options.memory)}; "
            f"use a larger --memory or a smaller --tile than {options.tile}{fewer}"
        )

    def check_device(self, available: int, options: RunOptions) -> None:
        """Refuse a run whose tiles do not fit together in the memory of the GPU, in bytes.

        Raises
        ------
        InputError
            Says how much is needed and what would fit.
        """
        job = max(self.passes, key=lambda item: item.memory)
        if job.memory > available:
            fewer = f" or fewer workers than {self.workers}" if self.workers > 1 else ""
            raise InputError(
                f"pass {job.name} needs about {format_memory(job.memory)} of the GPU's memory, which has "
                f"{format_memory(available)}; use a smaller --tile than {options.tile}{fewer}"
            )

    def text(self) -> str:
        """The plan for people: widths before heights."""
        rows, columns = self.shape
        tiles = f"{counted(self.tiles, 'tile')} of {self.tile_shape[1]} × {self.tile_shape[0]}"
        lines = [
            f"{self.command}: {columns:,} × {rows:,} pixels of {self.resolution:.3g} m "
            f"({rows * columns / 1e6:.1f} Mpx), {tiles}",
            f"{'pass':<12}{'halo (px)':>10}{'read twice':>12}{'memory':>12}",
        ]
        for item in self.passes:
            lines.append(f"{item.name:<12}{item.halo:>10}{item.overhead:>12.0%}{format_memory(item.memory):>12}")
        lines.append(f"{'export':<34}{format_memory(self.export_memory):>12}")
        lines.append(
            f"peak memory about {format_memory(self.memory)} with {counted(self.workers, 'worker')} "
            f"(libraries {format_memory(_BASE)}, global facts {format_memory(self.global_memory)}); "
            f"limit {format_memory(self.limit)}"
        )
        if self.memory > self.limit:
            lines.append("this is more than --memory allows: the run would be refused")
        return "\n".join(lines)


def counted(number: int, thing: str) -> str:
    """A number of things in words: 1 tile, 2 tiles.

    Examples
    --------
    >>> from tilepipe.engine.planning import counted
    >>> counted(1, "tile"), counted(12, "tile")
    ('1 tile', '12 tiles')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"


def plan_passes(
    command: str,
    raster: Raster,
    passes: Sequence[Pass],
    options: RunOptions,
    per_megapixel: int = _PER_MEGAPIXEL,
) -> Plan:
    """Plan a run of several passes on one tiling; ``per_megapixel`` bytes are held for the whole raster."""
    grid = passes[0].grid
    rows, columns = grid.counts
    seams = (rows - 1) * grid.shape[1] + (columns - 1) * grid.shape[0]
    megapixels = math.prod(grid.shape) / 1e6
    global_memory = int(2 * seams * _PER_SEAM_PIXEL + len(grid) * _PER_TILE // 16 + megapixels * per_megapixel)
    workers = min(options.workers, len(grid))
    plans = tuple(
        PassPlan(
            job.name,
            job.halo,
            math.prod(min(t + 2 * job.halo, s) for t, s in zip(grid.tile_shape, grid.shape, strict=True))
            / math.prod(min(t, s) for t, s in zip(grid.tile_shape, grid.shape, strict=True))
            - 1,
            job.memory() * workers,
        )
        for job in passes
    )
    return Plan(
        command,
        grid.shape,
        raster.geometry.resolution,
        grid.tile_shape,
        len(grid),
        workers,
        options.executor == "processes",
        plans,
        global_memory,
        _EXPORT + _EXPORT_PER_COLUMN * grid.shape[1],
        options.memory,
    )
