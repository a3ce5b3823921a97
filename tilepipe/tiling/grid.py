"""Windows, tiles and seams of a raster: frozen values made of integers only.

All windows are half-open in global pixel coordinates (rows down, columns right), so neighbouring cores share no
pixel and together cover the raster exactly once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """A half-open rectangle of pixels: rows ``top:bottom``, columns ``left:right``.

    Examples
    --------
    >>> from tilepipe.tiling.grid import Window
    >>> core = Window(top=512, left=0, bottom=1024, right=512)
    >>> core.shape, core.origin
    ((512, 512), (512, 0))
    >>> core.padded(8, shape=(2000, 2000))  # the raster ends at column 0
    Window(top=504, left=0, bottom=1032, right=520)
    """

    top: int
    left: int
    bottom: int
    right: int

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.bottom - self.top

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.right - self.left

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, columns)``."""
        return self.rows, self.columns

    @property
    def origin(self) -> tuple[int, int]:
        """Global row and column of the first pixel."""
        return self.top, self.left

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of this window into an array that starts at pixel (0, 0)."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def intersection(self, other: Window) -> Window:
        """The common part; it has no pixels (``rows`` or ``columns`` ≤ 0 clipped to 0) when the two are apart.

        Examples
        --------
        >>> from tilepipe.tiling.grid import Window
        >>> Window(0, 0, 100, 100).intersection(Window(60, 80, 200, 200)).shape
        (40, 20)
        >>> Window(0, 0, 100, 100).intersection(Window(100, 0, 200, 100)).is_empty  # half-open: they share no pixel
        True
        """
        top, left = max(self.top, other.top), max(self.left, other.left)
        return Window(top, left, max(top, min(self.bottom, other.bottom)), max(left, min(self.right, other.right)))

    def padded(self, halo: int, shape: tuple[int, int]) -> Window:
        """This window grown by ``halo`` pixels on each side, clipped to a raster of ``shape``."""
        return Window(
            max(0, self.top - halo),
            max(0, self.left - halo),
            min(shape[0], self.bottom + halo),
            min(shape[1], self.right + halo),
        )

    def relative_to(self, outer: Window) -> Window:
        """This window in the coordinates of a block read from ``outer``.

        Examples
        --------
        >>> import numpy as np
        >>> from tilepipe.tiling.grid import Window
        >>> core, padded = Window(8, 8, 12, 12), Window(6, 6, 14, 14)
        >>> block = np.zeros(padded.shape)
        >>> block[core.relative_to(padded).slices].shape
        (4, 4)
        """
        return Window(self.top - outer.top, self.left - outer.left, self.bottom - outer.top, self.right - outer.left)

    def as_tuple(self) -> tuple[int, int, int, int]:
        """``(top, bottom, left, right)``, the order in which kernels take a core."""
        return self.top, self.bottom, self.left, self.right

    @property
    def is_empty(self) -> bool:
        """Whether it holds no pixel."""
        return self.rows <= 0 or self.columns <= 0


@dataclass(frozen=True, slots=True)
class Tile:
    """A unit of work: ``core`` is written, ``padded`` (core and halo, clipped to the raster) is read.

    Examples
    --------
    >>> from tilepipe.tiling.grid import TileGrid
    >>> tile = TileGrid((1000, 1500), (512, 512)).tile(4, halo=10)
    >>> tile.name, tile.core.as_tuple(), tile.padded.as_tuple()
    ('r0001c0001', (512, 1000, 512, 1024), (502, 1000, 502, 1034))
    """

    number: int
    row: int
    column: int
    core: Window
    padded: Window

    @property
    def core_in_padded(self) -> Window:
        """The core in the coordinates of the block read from ``padded``."""
        return self.core.relative_to(self.padded)

    @property
    def name(self) -> str:
        """Short name used in messages and file names, from the tile's row and column."""
        return f"r{self.row:04d}c{self.column:04d}"


@dataclass(frozen=True, slots=True)
class Seam:
    """The edge shared by two cores: tile ``first`` lies above (``vertical=False``) or left of tile ``second``."""

    first: int
    second: int
    vertical: bool


@dataclass(frozen=True, slots=True)
class TileGrid:
    """A raster of ``shape`` cut into tiles of ``tile_shape`` (rows, columns); the last ones may be smaller.

    Examples
    --------
    A raster of 1000 × 1500 pixels is cut into two rows of three tiles.

    >>> from tilepipe.tiling.grid import TileGrid
    >>> grid = TileGrid((1000, 1500), (512, 512))
    >>> grid.counts
    (2, 3)
    >>> [tile.core.shape for tile in grid.tiles()]
    [(512, 512), (512, 512), (512, 476), (488, 512), (488, 512), (488, 476)]
    >>> grid.number_at(600, 1400)
    5
    """

    shape: tuple[int, int]
    tile_shape: tuple[int, int]

    def __post_init__(self) -> None:
        if min(self.shape) < 1 or min(self.tile_shape) < 1:
            raise ValueError(f"raster {self.shape} and tile {self.tile_shape} must have at least one pixel a side")

    @property
    def counts(self) -> tuple[int, int]:
        """Number of tile rows and tile columns."""
        return -(-self.shape[0] // self.tile_shape[0]), -(-self.shape[1] // self.tile_shape[1])

    def __len__(self) -> int:
        return self.counts[0] * self.counts[1]

    def tile(self, number: int, halo: int = 0) -> Tile:
        """Tile ``number`` (row-major) with a halo of ``halo`` pixels."""
        row, column = divmod(number, self.counts[1])
        height, width = self.tile_shape
        whole = Window(0, 0, *self.shape)
        core = Window(row * height, column * width, (row + 1) * height, (column + 1) * width).intersection(whole)
        return Tile(number, row, column, core, core.padded(halo, self.shape))

    def tiles(self, halo: int = 0) -> Iterator[Tile]:
        """All tiles in row-major order."""
        return (self.tile(number, halo) for number in range(len(self)))

    def number_at(self, row: int, column: int) -> int:
        """Number of the tile whose core holds the global pixel (row, column)."""
        return (row // self.tile_shape[0]) * self.counts[1] + column // self.tile_shape[1]

    def overlapping(self, window: Window) -> Iterator[Tile]:
        """Tiles whose cores share pixels with ``window``, in row-major order.

        Examples
        --------
        >>> from tilepipe.tiling.grid import TileGrid, Window
        >>> grid = TileGrid((1000, 1500), (512, 512))
        >>> [tile.number for tile in grid.overlapping(Window(500, 500, 520, 520))]  # about a corner of four tiles
        [0, 1, 3, 4]
        """
        for row in range(window.top // self.tile_shape[0], -(-window.bottom // self.tile_shape[0])):
            for column in range(window.left // self.tile_shape[1], -(-window.right // self.tile_shape[1])):
                yield self.tile(row * self.counts[1] + column)

    def seams(self) -> Iterator[Seam]:
        """All seams: for each tile the one below it, then the one to its right.

        Examples
        --------
        >>> from tilepipe.tiling.grid import TileGrid
        >>> for seam in TileGrid((1000, 1000), (512, 512)).seams():
        ...     print(seam.first, "beside" if seam.vertical else "above", seam.second)
        0 above 2
        0 beside 1
        1 above 3
        2 beside 3
        """
        rows, columns = self.counts
        for number in range(len(self)):
            row, column = divmod(number, columns)
            if row + 1 < rows:
                yield Seam(number, number + columns, vertical=False)
            if column + 1 < columns:
                yield Seam(number, number + 1, vertical=True)

    def coarsened(self, factor: tuple[int, int]) -> TileGrid:
        """The same tiling on the grid of ``factor[0] × factor[1]`` rectangles; tiles must hold whole rectangles.

        Raises
        ------
        ValueError
            When ``tile_shape`` is not a multiple of ``factor``.

        Examples
        --------
        >>> from tilepipe.tiling.grid import TileGrid
        >>> TileGrid((1000, 1500), (512, 512)).coarsened((32, 32))
        TileGrid(shape=(32, 47), tile_shape=(16, 16))
        """
        if self.tile_shape[0] % factor[0] or self.tile_shape[1] % factor[1]:
            raise ValueError(f"tile {self.tile_shape} is not a multiple of the rectangle {factor}")
        return TileGrid(
            (-(-self.shape[0] // factor[0]), -(-self.shape[1] // factor[1])),
            (self.tile_shape[0] // factor[0], self.tile_shape[1] // factor[1]),
        )
