"""A pipeline as one object: its inputs, its passes, its layers, and the recipe that strings them together.

Command line, plan, status, report, scores and documentation follow from the object alone, so that a package of others
adds a pipeline by declaring one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from tilepipe.engine.inputs import Input
from tilepipe.engine.layers import Layer, RasterLayer, TableLayer
from tilepipe.engine.tiles.passes import TileFunction
from tilepipe.tiling.grid import TileGrid

if TYPE_CHECKING:
    from tilepipe.engine.request import OpenInputs
    from tilepipe.engine.work import Work

DEFAULT_PICTURES = "tilepipe.report.default:pictures"


@dataclass(frozen=True)
class Setting:
    """What the passes of a run depend on: known before any work, and from the record of a run alone.

    Attributes
    ----------
    parameters
        Of the pipeline.
    shape
        Rows and columns of the raster.
    resolution
        Pixel size in metres.
    tile
        Side of a tile in pixels, as asked for.
    inputs
        Names of the further inputs that were given.
    found
        What opening the inputs has told, by the names that it has in the record.
    """

    parameters: Any
    shape: tuple[int, int]
    resolution: float
    tile: int
    inputs: frozenset[str] = frozenset()
    found: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class State:
    """A raster that a pass leaves for later ones.

    Attributes
    ----------
    dtype
        Type of its values.
    fill
        Value of what has not been written.
    per_cell
        Whether it has a value for each cell of the pipeline (see `Pipeline.cell`) instead of each pixel.
    """

    dtype: str
    fill: int = 0
    per_cell: bool = False


Amount = int | Callable[[Setting], int]
"""A number of pixels or bytes, or how it follows from the setting."""

_UNDECLARED = -1


@dataclass(frozen=True)
class Gathered:
    """Facts of a pass that what follows it holds for the whole raster at once.

    Attributes
    ----------
    items
        What they are, for people: ``leaves``.
    rows
        The fact, of all that the pass leaves, of which each row is one of them.
    bytes_per_row
        Most that is held for each until the end of the run, in bytes; what is made of it counts too.
    most
        Most of them that a raster can have, whatever it holds.
    """

    items: str
    rows: str
    bytes_per_row: Amount
    most: Callable[[Setting], int]


def _always(_: Setting) -> bool:
    return True


def _one_pixel(_: Setting) -> tuple[int, int]:
    return 1, 1


@dataclass(frozen=True)
class Pass:
    """A computation that runs on every tile.

    Attributes
    ----------
    name
        Name in messages, progress, plans and the state folder.
    function
        Module-level function ``function(context, tile) -> facts``; it writes state by `engine.tiles.state.write_state`.
    halo
        Width in pixels that the function reads around the core of a tile; 0 where it reads nothing.
    bytes_per_pixel
        Peak working memory of the function per pixel that it reads.
    writes
        State that the function fills, by name.
    gathers
        What of its facts is held for the whole raster at once: counted, against ``--memory``, when the pass is done.
    fewer
        What a user can set to have less of it, in a few words.
    needed
        Whether a run has this pass; by default every run.
    on_device
        Whether the function works on arrays of the run's backend; else it works on the host.
    """

    name: str
    function: TileFunction
    halo: Amount = _UNDECLARED
    bytes_per_pixel: Amount = _UNDECLARED
    writes: Mapping[str, State] = field(default_factory=dict)
    gathers: tuple[Gathered, ...] = ()
    fewer: str = ""
    needed: Callable[[Setting], bool] = _always
    on_device: bool = True


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A way from rasters to layers.

    Attributes
    ----------
    name
        Name of its command.
    summary
        One line for ``--help``.
    parameters
        Model of its parameters; their descriptions are the documentation.
    passes
        All passes that a run may have, in their order.
    layers
        All layers that a run may publish.
    recipe
        What a run does: passes, reconciliations between them, and the files of its layers in the state folder.
    inputs
        Rasters beside the main ones.
    heights
        Whether the values of the main rasters are heights: their unit must then be a known length.
    cell
        Rows and columns of the cells, in pixels, that no tile may cut; by default single pixels.
    open_inputs
        Opens and checks what was given; by default the main rasters as one mosaic and the others aligned to it.
    check
        Raises `InputError` for a setting that the method cannot work with.
    seeded
        Whether results depend on ``--seed``.
    bytes_per_megapixel
        What reconciliations hold for the whole raster where it is what the pipeline is made for; of other content
        more is held, see `Gathered`.
    pictures
        ``module:function`` that draws a finished run, ``function(folder) -> list of paths``; by default its layers over
        its input.
    warm_up
        ``module:function`` that calls the kernels which a run calls last, on data of its own; where kernels have to be
        compiled, a second process does so with these.  None by default.
    operators
        ``module:class`` of lazy operators on arrays, a `tilepipe.accessor.blocks.BlockOperators`; none by default.

    Raises
    ------
    ValueError
        When two passes, layers or inputs have one name, or a pass does not say what it reads or needs.
    """

    name: str
    summary: str
    parameters: type[BaseModel]
    passes: tuple[Pass, ...]
    layers: tuple[Layer, ...]
    recipe: Callable[[Work], Iterable[Path]]
    inputs: tuple[Input, ...] = ()
    heights: bool = False
    cell: Callable[[Setting], tuple[int, int]] = _one_pixel
    open_inputs: OpenInputs | None = None
    check: Callable[[Setting], None] | None = None
    seeded: bool = False
    bytes_per_megapixel: int = 800_000
    pictures: str = DEFAULT_PICTURES
    warm_up: str = ""
    operators: str = ""

    def __post_init__(self) -> None:
        for kind, names in (
            ("pass", [item.name for item in self.passes]),
            ("state", [name for item in self.passes for name in item.writes]),
            ("layer", [layer.name for layer in self.layers]),
            ("input", [name for item in self.inputs for name in {item.name, item.option, item.band_option}]),
        ):
            if twice := [name for name, count in Counter(names).items() if count > 1]:
                raise ValueError(f"pipeline '{self.name}' declares the {kind} '{twice[0]}' twice")
        if not self.passes:
            raise ValueError(f"pipeline '{self.name}' declares no pass")
        for item in self.passes:
            where = f"pass '{item.name}' of pipeline '{self.name}'"
            if not _is_amount(item.halo):
                raise ValueError(f"{where} has no halo: give the pixels that it reads around a tile, 0 for none")
            if not _is_amount(item.bytes_per_pixel):
                raise ValueError(f"{where} has no bytes_per_pixel: give its working memory for each pixel it reads")

    def grid(self, setting: Setting) -> TileGrid:
        """Tiling of the raster: tiles of whole cells, nearly of the size asked for."""
        rows, columns = (max(side, setting.tile // side * side) for side in self.cell(setting))
        return TileGrid(setting.shape, (rows, columns))

    def needed_passes(self, setting: Setting) -> list[Pass]:
        """Passes of a run in this setting, in their order."""
        return [item for item in self.passes if item.needed(setting)]

    @property
    def scored(self) -> list[TableLayer]:
        """Tables that can be scored, the best first."""
        return [layer for layer in self.layers if isinstance(layer, TableLayer) and layer.scored]

    @property
    def extent(self) -> RasterLayer | None:
        """Raster whose nodata is that of the input."""
        return next((layer for layer in self.layers if isinstance(layer, RasterLayer)), None)


def _is_amount(value: object) -> bool:
    return callable(value) or (isinstance(value, int) and value >= 0)


def amount(value: Amount, setting: Setting) -> int:
    """A number of pixels or bytes in a setting."""
    return value(setting) if callable(value) else value
