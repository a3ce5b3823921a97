"""Lazy operators of `streets`: diffusion, regions, ridge lines, medial axis, openings and closings of masks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from tilepipe.accessor.blocks import BlockOperators, even_grid, meant
from tilepipe.io.rasters.packing import Packing, packing_of
from tilepipe.io.rasters.sources.arrays import ARRAY
from tilepipe.pipelines.streets.reconcile_regions import SUMMED, Regions, reconcile_regions
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe.tiling.seams import border_facts, raster_borders, touches_seam
from tilepipe_kernels.image import diffusion, morphology
from tilepipe_kernels.network import skeleton
from tilepipe_kernels.regions import growing, region_table
from tilepipe_kernels.ridges.links import link_points
from tilepipe_kernels.ridges.points import line_points
from tilepipe_kernels.ridges.ridges import halo as ridges_halo


class StreetOperators(BlockOperators):
    """Operators on greys and on masks of streets."""

    def diffuse(
        self,
        *,
        steps: int = 50,
        time_step: float = 0.5,
        conductance: float = 0.01,
        gradient_sigma: float = 1.0,
        fidelity: float = 0.5,
        model: diffusion.Model = "curvature",
    ) -> xr.DataArray:
        """Nonlinear diffusion of grey levels 0–255; see `tilepipe_kernels.image.diffusion.diffuse`.

        Returns
        -------
        xarray.DataArray of float32
            Smoothed raster.

        Examples
        --------
        >>> import dask.array
        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> greys = xr.DataArray(dask.array.from_array(np.tile([[40.0, 200.0]], (64, 32)), chunks=32), dims=("y", "x"))
        >>> smooth = greys.tilepipe.diffuse(steps=5)
        >>> smooth.chunks == greys.chunks, smooth.dtype.name  # nothing is computed yet
        (True, 'float32')
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            return diffusion.diffuse(
                block,
                steps=steps,
                time_step=time_step,
                conductance=conductance,
                gradient_sigma=gradient_sigma,
                fidelity=fidelity,
                model=model,
                core=tile.core_in_padded.as_tuple(),
            )

        return self.map_blocks("diffuse", function, diffusion.halo(steps, gradient_sigma, model), np.float32)

    def grow_regions(self, *, tolerance: float, minimum_size: int = 1, maximum: float = np.inf) -> xr.DataArray:
        """Regions of pixels whose neighbours differ by at most ``tolerance``, across all chunks.

        Parameters
        ----------
        tolerance
            Largest difference of two 4-adjacent pixels of one region.
        minimum_size
            Fewest pixels of a region.
        maximum
            Only values up to this belong to a region.

        Returns
        -------
        xarray.DataArray of uint32
            Region 1, 2, … in the order of their first pixels; 0 = none.

        Raises
        ------
        InputError
            The chunks are uneven.

        Examples
        --------
        Two streets that an array's chunks cut: each is one region, whatever chunk it lies in.

        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> greys = xr.DataArray(np.repeat([[40], [200], [40], [200]], 6, axis=1), dims=("y", "x")).chunk(y=2, x=3)
        >>> greys.tilepipe.grow_regions(tolerance=10, maximum=100).values[:, ::5].tolist()
        [[1, 1], [0, 0], [2, 2], [0, 0]]
        """
        grow = _Growing(tolerance, minimum_size, maximum, packing_of(self._array, ARRAY))
        data = self._array.data
        if hasattr(data, "dask"):
            return self._like("grow_regions", _grow_lazily(data, grow, even_grid(data)))
        whole = TileGrid(data.shape, data.shape)
        labels, facts = grow.block(np.asarray(data), whole.tile(0), whole)
        return self._like("grow_regions", grow.publish(labels, grow.reconcile(whole, [facts]), 0))

    def ridge_lines(self, *, sigma: float, low: float, dark: bool = True) -> xr.DataArray:
        """Steger's line points that are linked to lines; see `tilepipe_kernels.ridges.points.line_points`.

        Returns
        -------
        xarray.DataArray of float32
            Line response (grey per pixel²) at the pixels of lines, 0 elsewhere.

        Examples
        --------
        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> greys = xr.DataArray(np.full((21, 40), 200.0), dims=("y", "x"))
        >>> greys[10] = 100  # a street one pixel wide
        >>> lines = greys.tilepipe.ridge_lines(sigma=1.2, low=5.0)
        >>> np.flatnonzero((lines > 0).any("x")).tolist()
        [10]
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            points = line_points(block, sigma, low=low, dark=dark)
            linked = points.take(np.flatnonzero(link_points(points)))
            response = np.zeros(block.shape, np.float32)
            response[linked.row, linked.col] = linked.response
            return response[tile.core_in_padded.slices]

        return self.map_blocks("ridge_lines", function, ridges_halo(sigma), np.float32)

    def medial_axis(self, *, half_width: int, separation: float = 5.0) -> xr.DataArray:
        """Euclidean skeleton of a mask; see `tilepipe_kernels.network.skeleton.medial_axis`.

        Parameters
        ----------
        half_width
            Half the width of the widest place that has an axis, pixels.
        separation
            Least distance of the two borders that the axis touches, pixels.

        Returns
        -------
        xarray.DataArray of bool
            The skeleton, one pixel wide.

        Examples
        --------
        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> street = xr.DataArray(np.zeros((15, 60), bool), dims=("y", "x"))
        >>> street[4:11] = True
        >>> axis = street.tilepipe.medial_axis(half_width=6)
        >>> np.flatnonzero(axis.any("x")).tolist()  # the middle of rows 4 to 10
        [7]
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            mask = np.nan_to_num(block) != 0
            axis = skeleton.medial_axis(mask, cap=half_width, separation=separation, origin=tile.padded.origin)
            return axis[tile.core_in_padded.slices]

        return self.map_blocks("medial_axis", function, skeleton.halo(half_width), np.bool_)

    def open_mask(self, *, radius: float) -> xr.DataArray:
        """Opening of a mask by a disc of ``radius`` pixels.

        Examples
        --------
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> mask = xr.DataArray([[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [1, 1, 1, 1, 1], [1, 1, 1, 0, 0]], dims=("y", "x"))
        >>> mask.tilepipe.open_mask(radius=1).astype(int).values.tolist()  # the driveway is shortened
        [[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [1, 1, 1, 1, 0], [1, 1, 1, 0, 0]]
        """
        return self._morphology("open_mask", morphology.open_mask, radius)

    def close_mask(self, *, radius: float) -> xr.DataArray:
        """Closing of a mask by a disc of ``radius`` pixels.

        Examples
        --------
        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> street = xr.DataArray(np.ones((5, 9), bool), dims=("y", "x"))
        >>> street[:, 4] = False  # a gap of one pixel
        >>> bool(street.tilepipe.close_mask(radius=1)[2, 4])
        True
        """
        return self._morphology("close_mask", morphology.close_mask, radius)

    def _morphology(
        self, name: str, kernel: Callable[[NDArray[Any], float], NDArray[np.bool_]], radius: float
    ) -> xr.DataArray:
        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            return kernel(np.nan_to_num(block) != 0, radius)[tile.core_in_padded.slices]

        return self.map_blocks(name, function, morphology.halo(radius), np.bool_)


class _Growing:
    """Region growing on blocks, its reconciliation and the publication of ids."""

    def __init__(self, tolerance: float, minimum_size: int, maximum: float, packing: Packing) -> None:
        self.tolerance, self.minimum_size, self.maximum, self.packing = tolerance, minimum_size, maximum, packing

    def block(self, block: NDArray[Any], tile: Tile, grid: TileGrid) -> tuple[NDArray[np.int32], Facts]:
        """Labels of a block and what the reconciliation needs."""
        values = np.ascontiguousarray(meant(block, self.packing), np.float32)
        labels = growing.grow_regions(values, self.tolerance, maximum=self.maximum)
        borders, count = raster_borders(grid, tile.number), int(labels.max(initial=0))
        table = region_table.region_table(labels, values, count, borders=borders)
        row, column = np.divmod(table.first, labels.shape[1])
        facts: Facts = {name: getattr(table, name) for name in SUMMED}
        facts["first"] = (row + tile.core.top) * grid.shape[1] + column + tile.core.left
        facts["contacts"] = region_table.region_contacts(labels, touches_seam(labels, count, borders))
        return labels, facts | border_facts("label", labels) | border_facts("grey", values)

    def reconcile(self, grid: TileGrid, facts: list[Facts]) -> tuple[Regions, NDArray[np.uint32]]:
        """Regions of the whole raster and the id of every local label."""
        regions = reconcile_regions(grid, facts, tolerance=self.tolerance, rectangle=(1.0, 1.0))
        return regions, regions.lookup(regions.area >= self.minimum_size)

    @staticmethod
    def publish(labels: NDArray[np.int32], found: tuple[Regions, NDArray[np.uint32]], number: int) -> NDArray[Any]:
        """Ids of a block."""
        regions, lookup = found
        start, stop = regions.numbering.offsets[number : number + 2]
        return region_table.select_labels(labels, np.concatenate([np.zeros(1, np.uint32), lookup[start:stop]]))


def _grow_lazily(data: Any, grow: _Growing, grid: TileGrid) -> Any:
    import dask
    import dask.array as da

    block = dask.delayed(grow.block, nout=2, pure=False)
    chunks = data.to_delayed(optimize_graph=False).ravel()
    found = [block(chunk, tile, grid) for chunk, tile in zip(chunks, grid.tiles(), strict=True)]
    regions = dask.delayed(grow.reconcile, pure=False)(grid, [facts for _, facts in found])
    publish = dask.delayed(grow.publish, pure=False)
    rows, columns = grid.counts
    return da.block(
        [
            [
                da.from_delayed(
                    publish(found[number][0], regions, number),
                    shape=grid.tile(number).core.shape,
                    dtype=np.uint32,
                )
                for number in range(i * columns, (i + 1) * columns)
            ]
            for i in range(rows)
        ]
    )
