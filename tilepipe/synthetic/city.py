"""A synthetic city: the parameters that name it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from tilepipe.errors import InputError
from tilepipe_kernels.city.layout import Layout, city_layout

if TYPE_CHECKING:
    from affine import Affine

#: Largest area of a city in square metres, so that building ids fit 31 bits.
LARGEST_AREA = 1e11


@dataclass(frozen=True)
class City:
    """A synthetic city: its pixels follow from these values and their global rows and columns.

    Parameters
    ----------
    seed
        Any integer; another seed is another city.
    rows, columns
        Size of its rasters in pixels.
    resolution
        Ground size of a pixel in metres.
    crs
        Projected coordinate reference system in metres.
    west, north
        Coordinates of the outer corner of pixel (0, 0) in that system, in metres.
    trees, cars, voids
        Density of trees, parked cars and missing returns, relative to the usual 1; from 0 to 2.
    speckle
        Relative standard deviation of the gamma speckle of the intensity; from 0 to 1.

    Raises
    ------
    InputError
        When a size, density or the speckle is out of range.

    Examples
    --------
    >>> from tilepipe.synthetic import City
    >>> city = City(seed=7, rows=1024, columns=2048, resolution=0.25)
    >>> city.shape, city.bounds
    ((1024, 2048), (392000.0, 5819744.0, 392512.0, 5820000.0))
    """

    seed: int = 0
    rows: int = 2048
    columns: int = 2048
    resolution: float = 0.5
    crs: str = "EPSG:32633"
    west: float = 392_000.0
    north: float = 5_820_000.0
    trees: float = 1.0
    cars: float = 1.0
    voids: float = 1.0
    speckle: float = 0.16

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"a city needs at least one row and column, not {self.rows} x {self.columns}")
        if not 0.05 <= self.resolution <= 20:
            raise InputError(f"resolution must be 0.05 to 20 m, not {self.resolution}")
        if self.rows * self.columns * self.resolution**2 > LARGEST_AREA:
            raise InputError(
                f"a city of {self.columns} × {self.rows} pixels is too large; make fewer or smaller pixels"
            )
        for name in ("trees", "cars", "voids"):
            if not 0 <= getattr(self, name) <= 2:
                raise InputError(f"{name} must be 0 to 2, not {getattr(self, name)}")
        if not 0 <= self.speckle <= 1:
            raise InputError(f"speckle must be 0 to 1, not {self.speckle}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north border in the coordinate reference system."""
        return (
            self.west,
            self.north - self.rows * self.resolution,
            self.west + self.columns * self.resolution,
            self.north,
        )

    @property
    def transform(self) -> Affine:
        """Affine map from (column, row) to (x, y) of the coordinate reference system."""
        from affine import Affine

        return Affine(self.resolution, 0.0, self.west, 0.0, -self.resolution, self.north)


@lru_cache(maxsize=32)
def layout_of(city: City) -> Layout:
    """The layout of a city, made once."""
    return city_layout(city.seed, city.shape, city.resolution, city.trees, city.cars, city.voids)
