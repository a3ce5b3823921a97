"""The layout of a city: what all its pixels follow from, as compiled loops take it.

A window is ``(first_row, first_column, rows, columns)`` in global pixels and may reach over the city's border.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.chart import REACH, SPACING, STREET_WAVES, TERRAIN_WAVES
from tilepipe_kernels.city.hashing import mixed, uniform

Window = tuple[int, int, int, int]

#: Slope that each wave of a street family adds to its coordinate; three of them bend a street by up to about
#: 18 degrees.
WAVE_SLOPE = 0.11
#: Shortest and longest wave of the street families and of the terrain, in metres.
STREET_WAVELENGTHS = (280.0, 1300.0)
TERRAIN_WAVELENGTHS = (350.0, 4000.0)
#: Streams of random numbers that this module draws from.
FRAME_STREAM, WAVE_STREAM = 1, 2


class Layout(NamedTuple):
    """A city as the compiled loops see it; positions are metres right of and below pixel (0, 0)'s corner.

    Attributes
    ----------
    key
        Key of all random numbers.
    cos, sin
        Cosine and sine of the bearing of the streets.
    waves
        Shape (11, 4): amplitude (m), wave numbers along x and y (rad/m) and phase (rad) of the waves that bend the
        streets and make the terrain.
    resolution
        Ground size of a pixel in metres.
    trees, cars, voids
        Density of trees, parked cars and missing returns, relative to the usual 1.
    first_block, first_block_across, blocks_along, blocks_across
        Indices of the first block and numbers of the blocks along and across the city, with room to spare.
    """

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


def city_layout(
    seed: int, shape: tuple[int, int], resolution: float, trees: float = 1.0, cars: float = 1.0, voids: float = 1.0
) -> Layout:
    """Derive the layout: bearing and waves of the streets, waves of the terrain, numbers of the blocks.

    Parameters
    ----------
    seed
        Any integer; another seed is another city.
    shape
        Rows and columns of its rasters.
    resolution
        Ground size of a pixel in metres.
    trees, cars, voids
        Density of trees, parked cars and missing returns, relative to the usual 1.

    Returns
    -------
    Layout
        What the loops of this package take.

    Examples
    --------
    >>> from tilepipe_kernels.city.layout import city_layout
    >>> small, large = city_layout(3, (100, 100), 0.5), city_layout(3, (4000, 4000), 0.5)
    >>> small.waves.shape, bool((small.waves == large.waves).all()), small.blocks_along < large.blocks_along
    ((11, 4), True, True)
    """
    key = np.uint64(mixed(np.uint64(seed % 2**64)))
    bearing = math.radians(8 + 28 * uniform(key, FRAME_STREAM, 0, 0))
    waves = np.array([_wave(key, number) for number in range(STREET_WAVES + TERRAIN_WAVES)])
    width, height = shape[1] * resolution, shape[0] * resolution
    along, across = _chart_ranges(width, height, bearing, waves)
    return Layout(
        key, math.cos(bearing), math.sin(bearing), waves, float(resolution), float(trees), float(cars), float(voids),
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


def _chart_ranges(
    width: float, height: float, bearing: float, waves: NDArray[np.float64]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last block index along and across a city of this width and height in metres, with room to spare."""
    cos, sin = math.cos(bearing), math.sin(bearing)
    half = STREET_WAVES // 2
    ranges = []
    for family, (a, b) in enumerate(((cos, sin), (-sin, cos))):
        corners = [a * x + b * y for x in (0.0, width) for y in (0.0, height)]
        slack = float(waves[family * half : (family + 1) * half, 0].sum()) + 4 * REACH
        low, high = min(corners) - slack, max(corners) + slack
        ranges.append((math.floor(low / SPACING[family]) - 2, math.floor(high / SPACING[family]) + 2))
    return ranges[0], ranges[1]
