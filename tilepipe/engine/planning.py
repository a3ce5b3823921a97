"""What a run will need, before any work: tiles, halos, and memory against the limit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tilepipe.engine.gathering import most_gathered
from tilepipe.engine.options import RunOptions, format_memory
from tilepipe.engine.pipeline import Pass, Pipeline, Setting, amount
from tilepipe.errors import InputError
from tilepipe.tiling.grid import TileGrid

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


@dataclass(frozen=True)
class PassPlan:
    """One pass: its name, halo in pixels, share of pixels read more than once, memory of all workers in bytes."""

    name: str
    halo: int
    overhead: float
    memory: int


@dataclass(frozen=True)
class Plan:
    """What a run will do and need; where no number of workers was asked for, ``limit`` may hold fewer than wanted."""

    command: str
    shape: tuple[int, int]
    resolution: float
    tile_shape: tuple[int, int]
    tiles: int
    workers: int
    wanted: int
    processes: bool
    passes: tuple[PassPlan, ...]
    seam_memory: int
    gathered_memory: int
    most_gathered: int
    export_memory: int
    limit: int
    elsewhere: tuple[str, ...] = ()

    @property
    def memory(self) -> int:
        """Peak memory in bytes where the raster is what the pipeline is made for."""
        return self.memory_with(self.gathered_memory)

    @property
    def most_memory(self) -> int:
        """Peak memory in bytes whatever the raster holds, noise for example."""
        return max(self.memory, self.memory_with(self.most_gathered))

    def memory_with(self, gathered: int) -> int:
        """Peak memory in bytes when so many are gathered for the whole raster.

        Interpreter, hungriest pass on all workers with halos, seams, what is gathered, export.  What a pass has freed
        stays with the process for the most part, so what comes after it comes on top.
        """
        interpreters = 1 + (self.workers if self.processes else 0)
        tiles = max(item.memory for item in self.passes)
        return _BASE * interpreters + tiles + self.seam_memory + gathered + self.export_memory

    def with_workers(self, workers: int) -> Plan:
        """The plan of the same run with so many workers."""
        passes = (replace(item, memory=item.memory // self.workers * workers) for item in self.passes)
        return replace(self, workers=workers, passes=tuple(passes))

    def workers_within(self, gathered: int) -> int:
        """Most workers, of those planned, that the limit holds when so many bytes are gathered; 0 = not even one."""
        fewer = range(self.workers, 0, -1)
        return next((count for count in fewer if self.with_workers(count).memory_with(gathered) <= self.limit), 0)

    @property
    def least_memory(self) -> int:
        """What is needed besides the tiles, in bytes."""
        return self.memory - max(p.memory for p in self.passes)

    @property
    def has_room(self) -> bool:
        """Whether the limit leaves room for one more process that holds no tile."""
        return self.memory + _BASE <= self.limit

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
                f"export, but --memory is {format_memory(options.memory, up=False)}; use a larger --memory"
            )
        fewer = f", or fewer workers than {self.workers}" if self.workers > 1 else ""
        raise InputError(
            f"the run needs about {format_memory(self.memory)} but --memory is "
            f"{format_memory(options.memory, up=False)}; use a larger --memory "
            f"or a smaller --tile than {options.tile}{fewer}"
        )

    def check_device(self, available: int, options: RunOptions) -> None:
        """Refuse a run whose tiles do not fit together in the memory of the GPU, in bytes.

        Raises
        ------
        InputError
            Says how much is needed and what would fit.
        """
        hungriest = max(self.passes, key=lambda item: item.memory)
        if hungriest.memory > available:
            fewer = f" or fewer workers than {self.workers}" if self.workers > 1 else ""
            raise InputError(
                f"pass {hungriest.name} needs about {format_memory(hungriest.memory)} of the GPU's memory, which has "
                f"{format_memory(available, up=False)}; use a smaller --tile than {options.tile}{fewer}"
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
        most = ""
        if self.most_memory > self.memory:
            most = f", at most {format_memory(self.most_memory)} whatever the raster holds"
        everywhere = self.seam_memory + self.gathered_memory
        lines.append(f"{'export':<34}{format_memory(self.export_memory):>12}")
        lines.append(
            f"peak memory about {format_memory(self.memory)} with {counted(self.workers, 'worker')} "
            f"(libraries {format_memory(_BASE)}, global facts {format_memory(everywhere)}){most}; "
            f"limit {format_memory(self.limit, up=False)}"
        )
        if self.workers < self.wanted:
            lines.append(
                f"{counted(self.workers, 'worker')} of {self.wanted} that the cores allow: --memory holds no more; "
                "raise it, or lower --tile, for more of them"
            )
        lines += [f"reads {name}" for name in self.elsewhere]
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


def plan_run(pipeline: Pipeline, setting: Setting, options: RunOptions) -> Plan:
    """Plan a run in a setting: the passes that it needs, on its tiling.

    Parameters
    ----------
    pipeline
        What is to run.
    setting
        What its passes depend on.
    options
        How to run.

    Raises
    ------
    ValueError, OverflowError
        When the halo of a pass does not exist for these parameters at this resolution.
    """
    grid = pipeline.grid(setting)
    rows, columns = grid.counts
    seams = (rows - 1) * grid.shape[1] + (columns - 1) * grid.shape[0]
    pixels, passes = math.prod(grid.shape), pipeline.needed_passes(setting)
    workers = min(options.resolved_workers, len(grid))
    plan = Plan(
        command=pipeline.name,
        shape=grid.shape,
        resolution=setting.resolution,
        tile_shape=grid.tile_shape,
        tiles=len(grid),
        workers=workers,
        wanted=workers,
        processes=options.executor == "processes",
        passes=tuple(_plan_pass(item, setting, grid, workers) for item in passes),
        seam_memory=2 * seams * _PER_SEAM_PIXEL + len(grid) * _PER_TILE // 16,
        gathered_memory=int(pixels / 1e6 * pipeline.bytes_per_megapixel),
        most_gathered=sum(most_gathered(item, setting) for item in passes),
        export_memory=_EXPORT + _EXPORT_PER_COLUMN * grid.shape[1],
        limit=options.memory,
    )
    if options.workers is not None:
        return plan
    return plan.with_workers(max(1, plan.workers_within(plan.gathered_memory)))


def _plan_pass(declared: Pass, setting: Setting, grid: TileGrid, workers: int) -> PassPlan:
    halo = amount(declared.halo, setting)
    core = math.prod(min(tile, side) for tile, side in zip(grid.tile_shape, grid.shape, strict=True))
    padded = math.prod(min(tile + 2 * halo, side) for tile, side in zip(grid.tile_shape, grid.shape, strict=True))
    memory = padded * amount(declared.bytes_per_pixel, setting) * workers
    return PassPlan(declared.name, halo, padded / core - 1, memory)
