"""Lazy operators on xarray arrays: ``import tilepipe.accessor`` and then ``array.tilepipe.diffuse(…)``.

Every operator keeps chunks, coordinates, attributes and CRS, computes nothing by itself when the array is lazy (over
dask), and gives the same values whatever the chunks are: each chunk is computed with its halo.  Greys and lengths of
pixels are those of the kernels; nodata is NaN or the array's own nodata value.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from tilepipe.errors import InputError
from tilepipe.grid import Tile, TileGrid, Window
from tilepipe.ledger import Facts
from tilepipe.regions import SUMMED, Regions, reconcile_regions
from tilepipe.seams import edge_facts, raster_borders, touches_seam
from tilepipe.sources import as_block, nodata_of
from tilepipe_kernels import diffusion, growing, morphology, region_table, ridges, skeleton

BlockFunction = Callable[[NDArray[Any], Tile], NDArray[Any]]

_NODATA = ("_FillValue", "missing_value", "fill_value", "nodata", "nodatavals")
_PACKING = ("dtype", "rasterio_dtype", "scale_factor", "add_offset")


@xr.register_dataarray_accessor("tilepipe")
class TilepipeAccessor:
    """Operators of tilepipe on a raster with two dimensions (rows, columns)."""

    def __init__(self, array: xr.DataArray) -> None:
        if array.ndim != 2:
            raise InputError(f"tilepipe works on arrays of two dimensions, not {array.ndim}: select a band first")
        self._array = array

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
        """Nonlinear diffusion of grey levels 0–255; see `tilepipe_kernels.diffusion.diffuse`.

        Returns
        -------
        xarray.DataArray of float32
            Smoothed raster.
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

        return self._map(function, diffusion.halo(steps, gradient_sigma, model), np.float32)

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
        """
        grow = _Growing(tolerance, minimum_size, maximum, nodata_of(self._array))
        data = self._array.data
        if not hasattr(data, "dask"):
            tile = TileGrid(data.shape, data.shape).tile(0)
            labels, facts = grow.block(np.asarray(data), tile, TileGrid(data.shape, data.shape))
            return self._like(grow.publish(labels, grow.reconcile(TileGrid(data.shape, data.shape), [facts]), 0))
        return self._like(_grow_lazily(data, grow, _grid_of(data)))

    def ridge_lines(self, *, sigma: float, low: float, dark: bool = True) -> xr.DataArray:
        """Steger's line points that are linked to lines; see `tilepipe_kernels.line_points.line_points`.

        Returns
        -------
        xarray.DataArray of float32
            Line response (grey per pixel²) at the pixels of lines, 0 elsewhere.
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            points = ridges.line_points(block, sigma, low=low, dark=dark)
            linked = points.take(np.flatnonzero(ridges.link_points(points)))
            response = np.zeros(block.shape, np.float32)
            response[linked.row, linked.col] = linked.response
            return response[tile.core_in_padded.slices]

        return self._map(function, ridges.halo(sigma), np.float32)

    def medial_axis(self, *, half_width: int, separation: float = 5.0) -> xr.DataArray:
        """Euclidean skeleton of a mask; see `tilepipe_kernels.skeleton.medial_axis`.

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
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            mask = np.nan_to_num(block) != 0
            axis = skeleton.medial_axis(mask, cap=half_width, separation=separation, origin=tile.padded.origin)
            return axis[tile.core_in_padded.slices]

        return self._map(function, skeleton.halo(half_width), np.bool_)

    def open_mask(self, *, radius: float) -> xr.DataArray:
        """Opening of a mask by a disc of ``radius`` pixels."""
        return self._morphology(morphology.open_mask, radius)

    def close_mask(self, *, radius: float) -> xr.DataArray:
        """Closing of a mask by a disc of ``radius`` pixels."""
        return self._morphology(morphology.close_mask, radius)

    def _morphology(self, kernel: Callable[[NDArray[Any], float], NDArray[np.bool_]], radius: float) -> xr.DataArray:
        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            return kernel(np.nan_to_num(block) != 0, radius)[tile.core_in_padded.slices]

        return self._map(function, morphology.halo(radius), np.bool_)

    def _map(self, function: BlockFunction, halo: int, dtype: DTypeLike) -> xr.DataArray:
        """Apply a local function to every chunk and its halo."""
        data, nodata = self._array.data, nodata_of(self._array)

        def on_pieces(pieces: list[list[NDArray[Any]]], tile: Tile) -> NDArray[Any]:
            return function(_blanked(np.block(pieces), nodata), tile)

        if not hasattr(data, "dask"):
            return self._like(on_pieces([[np.asarray(data)]], TileGrid(data.shape, data.shape).tile(0)))
        import dask
        import dask.array as da

        delayed, tiles = dask.delayed(on_pieces, pure=False), _chunk_tiles(data, halo)
        chunks = data.to_delayed(optimize_graph=False)
        blocks = [
            [
                da.from_delayed(delayed(_pieces(chunks, tiles, tile), tile), shape=tile.core.shape, dtype=dtype)
                for tile in row
            ]
            for row in tiles
        ]
        return self._like(da.block(blocks))

    def _like(self, data: Any) -> xr.DataArray:
        """The array with other values: same dims, coordinates, CRS and attributes but those of the nodata value."""
        result = self._array.copy(data=data)
        marked = False
        for name in _NODATA:
            marked |= name in result.attrs or name in result.encoding
            result.attrs.pop(name, None)
        # how the input was packed on disk does not suit other values
        for name in _NODATA + _PACKING:
            result.encoding.pop(name, None)
        if marked and result.dtype.kind == "f":
            result.attrs["_FillValue"] = np.nan
        return result


def _blanked(block: NDArray[Any], nodata: float | None) -> NDArray[Any]:
    """A block with NaN where it holds the array's nodata value."""
    return block if nodata is None or block.dtype.kind == "b" else as_block(block, nodata)


def _chunk_tiles(data: Any, halo: int) -> list[list[Tile]]:
    """The chunks of a dask array as tiles, row by row."""
    rows, columns = (np.concatenate([[0], np.cumsum(sizes)]).tolist() for sizes in data.chunks)
    tiles: list[list[Tile]] = []
    number = 0
    for i in range(len(rows) - 1):
        tiles.append([])
        for j in range(len(columns) - 1):
            core = Window(rows[i], columns[j], rows[i + 1], columns[j + 1])
            tiles[-1].append(Tile(number, i, j, core, core.padded(halo, data.shape)))
            number += 1
    return tiles


def _pieces(chunks: NDArray[Any], tiles: list[list[Tile]], tile: Tile) -> list[list[Any]]:
    """The parts of the chunks around a tile that make up its padded window; every chunk is computed only once."""
    import dask

    cut = dask.delayed(operator.getitem, pure=True)
    found: list[list[Any]] = []
    for i, row in enumerate(tiles):
        if row[0].core.bottom <= tile.padded.top or row[0].core.top >= tile.padded.bottom:
            continue
        found.append([])
        for j, other in enumerate(row):
            part = tile.padded.intersection(other.core)
            if not part.is_empty:
                chunk = chunks[i, j]
                found[-1].append(chunk if part == other.core else cut(chunk, part.relative_to(other.core).slices))
    return found


def _grid_of(data: Any) -> TileGrid:
    """The tiling of a dask array with even chunks."""
    sizes = tuple(max(sizes) for sizes in data.chunks)
    grid = TileGrid(tuple(data.shape), sizes)
    if grid.counts != tuple(len(sizes) for sizes in data.chunks) or any(
        size != sizes[0] for sizes in data.chunks for size in sizes[:-1]
    ):
        raise InputError(f"chunks {data.chunks} are uneven: rechunk to equal chunks first, for example .chunk(1024)")
    return grid


class _Growing:
    """Region growing on blocks, its reconciliation and the publication of ids."""

    def __init__(self, tolerance: float, minimum_size: int, maximum: float, nodata: float | None) -> None:
        self.tolerance, self.minimum_size, self.maximum, self.nodata = tolerance, minimum_size, maximum, nodata

    def block(self, block: NDArray[Any], tile: Tile, grid: TileGrid) -> tuple[NDArray[np.int32], Facts]:
        """Labels of a block and what the reconciliation needs."""
        values = np.ascontiguousarray(_blanked(block, self.nodata), np.float32)
        labels = growing.grow_regions(values, self.tolerance, maximum=self.maximum)
        borders, count = raster_borders(grid, tile.number), int(labels.max(initial=0))
        table = region_table.region_table(labels, values, count, borders=borders)
        row, column = np.divmod(table.first, labels.shape[1])
        facts: Facts = {name: getattr(table, name) for name in SUMMED}
        facts["first"] = (row + tile.core.top) * grid.shape[1] + column + tile.core.left
        facts["contacts"] = region_table.region_contacts(labels, touches_seam(labels, count, borders))
        return labels, facts | edge_facts("label", labels) | edge_facts("grey", values)

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
