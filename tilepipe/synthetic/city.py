"""What a synthetic city is made of: the parameters that name it and the layout that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.synthetic.chart import REACH, SPACING, STREET_WAVES, TERRAIN_WAVES
from tilepipe.synthetic.hashing import mixed, uniform

if TYPE_CHECKING:
    from affine import Affine

#: Slope that each wave of a street family adds to its coordinate; three of them bend a street by up to about
#: 18 degrees.
WAVE_SLOPE = 0.11
#: Shortest and longest wave of the street families and of the terrain, in metres.
STREET_WAVELENGTHS = (280.0, 1300.0)
TERRAIN_WAVELENGTHS = (350.0, 4000.0)
#: Largest area of a city in square metres, so that building ids fit 31 bits.
LARGEST_AREA = 1e11
#: Streams of random numbers that this module draws from.
FRAME_STREAM, WAVE_STREAM = 1, 2


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


class Layout(NamedTuple):
    """A city as the compiled loops see it; positions are metres right of and below pixel (0, 0)'s corner."""

    key: np.uint64
    cos: float
    sin: float
    waves: NDArray[np.float64]
    resolution: float
    trees: float
    cars: float
    voids: float
    first_block: int
    first_block_across: int
    blocks_along: int
    blocks_across: int


@lru_cache(maxsize=32)
def layout_of(city: City) -> Layout:
    """Derive the layout: bearing and waves of the streets, waves of the terrain, numbers of the blocks."""
    key = np.uint64(mixed(np.uint64(city.seed % 2**64)))
    bearing = math.radians(8 + 28 * uniform(key, FRAME_STREAM, 0, 0))
    waves = np.array([_wave(key, number) for number in range(STREET_WAVES + TERRAIN_WAVES)])
    along, across = _chart_ranges(city, bearing, waves)
    return Layout(
        key, math.cos(bearing), math.sin(bearing), waves, float(city.resolution),
        float(city.trees), float(city.cars), float(city.voids),
        along[0], across[0], along[1] - along[0] + 1, across[1] - across[0] + 1,
    )  # fmt: skip


def _wave(key: np.uint64, number: int) -> tuple[float, float, float, float]:
    """Amplitude (m), wave numbers along x and y (rad/m) and phase (rad) of one wave."""
    street = number < STREET_WAVES
    shortest, longest = STREET_WAVELENGTHS if street else TERRAIN_WAVELENGTHS
    steps = STREET_WAVES // 2 if street else TERRAIN_WAVES
    step = (number if street else number - STREET_WAVES) % steps
    fraction = (step + uniform(key, WAVE_STREAM, number, 0)) / steps
    length = shortest * (longest / shortest) ** fraction
    slope = WAVE_SLOPE if street else 0.035 * (0.4 + 0.6 * uniform(key, WAVE_STREAM, number, 1))
    angle = 2 * math.pi * uniform(key, WAVE_STREAM, number, 2)
    wave_number = 2 * math.pi / length
    phase = 2 * math.pi * uniform(key, WAVE_STREAM, number, 3)
    return slope / wave_number, wave_number * math.cos(angle), wave_number * math.sin(angle), phase


def _chart_ranges(city: City, bearing: float, waves: NDArray[np.float64]) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last block index along and across the city, with room to spare."""
    width, height = city.columns * city.resolution, city.rows * city.resolution
    cos, sin = math.cos(bearing), math.sin(bearing)
    half = STREET_WAVES // 2
    ranges = []
    for family, (a, b) in enumerate(((cos, sin), (-sin, cos))):
        corners = [a * x + b * y for x in (0.0, width) for y in (0.0, height)]
        slack = float(waves[family * half : (family + 1) * half, 0].sum()) + 4 * REACH
        low, high = min(corners) - slack, max(corners) + slack
        ranges.append((math.floor(low / SPACING[family]) - 2, math.floor(high / SPACING[family]) + 2))
    return ranges[0], ranges[1]
