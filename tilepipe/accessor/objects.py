"""Lazy operators of `objects`: means of the squares of a quadtree, and the bare earth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from tilepipe.accessor.blocks import BlockOperators
from tilepipe.errors import InputError
from tilepipe.pipelines.objects.leaf_features import TICKS_PER_METRE
from tilepipe.pipelines.objects.pass_leaves import to_ticks
from tilepipe.tiling.grid import Tile, Window
from tilepipe_kernels.heights import ground
from tilepipe_kernels.regions import quadtree


class ObjectOperators(BlockOperators):
    """Operators on heights."""

    def quadtree(self, *, deviation: float, smallest: int = 1, largest: int = 32) -> xr.DataArray:
        """Means of the squares of a quadtree on variance; see `tilepipe_kernels.regions.quadtree.split`.

        Parameters
        ----------
        deviation
            A square is split while its values deviate by more than this (standard deviation).
        smallest, largest
            Sides of the smallest and the largest square in pixels, powers of two.

        Returns
        -------
        xarray.DataArray of float32
            Mean of the square that each pixel lies in, NaN at nodata.  Values count in whole thousandths; what is
            farther than 30,000 from zero counts as nodata.

        Raises
        ------
        InputError
            ``deviation`` is negative.

        Examples
        --------
        A square of 4 × 4 pixels is split where its heights differ.

        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> heights = np.array([[3.0, 3, 3, 9], [3, 3, 3, 3], [3, 3, 5, 5], [3, 3, 5, 5]])
        >>> squares = xr.DataArray(heights, dims=("y", "x")).tilepipe.quadtree(deviation=0.5, smallest=2, largest=4)
        >>> squares.values.tolist()
        [[3.0, 3.0, 4.5, 4.5], [3.0, 3.0, 4.5, 4.5], [3.0, 3.0, 5.0, 5.0], [3.0, 3.0, 5.0, 5.0]]
        """
        if not deviation >= 0:
            raise InputError(f"deviation must be 0 or more, not {deviation}")

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            return _leaf_means(block, tile, deviation, smallest, largest)

        # squares lie on the global grid, and a square that a chunk cuts is made of all its pixels
        return self.map_blocks("quadtree", function, max(int(largest) - 1, 0), np.float32)

    def ground(self, *, resolution: float, largest_object: float = 80.0) -> xr.DataArray:
        """Height of the bare earth, from heights in metres alone; see `tilepipe_kernels.heights.ground.ground_height`.

        Parameters
        ----------
        resolution
            Side of a pixel in metres.
        largest_object
            What is narrower than this is taken off (m).

        Returns
        -------
        xarray.DataArray of float32
            Height of the ground (m), NaN at nodata; ``heights - ground`` is the height above ground.

        Examples
        --------
        A house of 20 m × 20 m and 8 m in height on even ground.

        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> heights = xr.DataArray(np.full((100, 100), 30.0), dims=("y", "x"))
        >>> heights[40:60, 40:60] = 38
        >>> above = heights - heights.tilepipe.ground(resolution=1.0, largest_object=40)
        >>> float(above[50, 50]), float(above[10, 10])
        (8.0, 0.0)
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            height = ground.ground_height(
                block, resolution=resolution, largest_object=largest_object, origin=tile.padded.origin
            )
            return height[tile.core_in_padded.slices]

        return self.map_blocks("ground", function, ground.halo(resolution, largest_object), np.float32)


def _leaf_means(block: NDArray[Any], tile: Tile, deviation: float, smallest: int, largest: int) -> NDArray[np.float32]:
    """Means of the squares that the core of a block lies in."""
    core, padded = tile.core, tile.padded
    squares = Window(
        core.top // largest * largest,
        core.left // largest * largest,
        min(-(-core.bottom // largest) * largest, padded.bottom),
        min(-(-core.right // largest) * largest, padded.right),
    )
    values = np.ascontiguousarray(block[squares.relative_to(padded).slices], np.float32)
    ticks, _ = to_ticks(values, 1.0, largest)
    labels, leaves = quadtree.split(
        ticks,
        threshold=(deviation * TICKS_PER_METRE) ** 2,
        smallest=smallest,
        largest=largest,
        origin=squares.origin,
    )
    means = np.concatenate([[np.nan], leaves.total / (leaves.count * TICKS_PER_METRE)]).astype(np.float32)
    taken: NDArray[np.float32] = means[labels[core.relative_to(squares).slices]]
    return taken
