"""Lazy operators on xarray arrays: ``import tilepipe.accessor`` and then ``array.tilepipe.diffuse(…)``.

Every operator keeps chunks, coordinates, attributes and CRS, computes nothing by itself when the array is lazy (over
dask), and gives the same values whatever the chunks are: each chunk is computed with its halo.  Greys and lengths of
pixels are those of the kernels; nodata is NaN or the array's own nodata value.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from tilepipe.errors import InputError
from tilepipe.grid import Tile, TileGrid, Window
from tilepipe.ledger import Facts
from tilepipe.object_leaves import to_ticks
from tilepipe.object_relief import TICKS_PER_METRE
from tilepipe.regions import SUMMED, Regions, reconcile_regions
from tilepipe.seams import edge_facts, raster_borders, touches_seam
from tilepipe.sources import as_block, nodata_of
from tilepipe_kernels import (
    diffusion,
    grey_levels,
    ground,
    growing,
    intensity_field,
    line_field,
    morphology,
    nevatia_babu,
    quadtree,
    region_table,
    ridges,
    skeleton,
)
from tilepipe_kernels.edge_model import EdgeModel

BlockFunction = Callable[[NDArray[Any], Tile], NDArray[Any]]

_NO_LEVEL = 255
"""Level and line elements at nodata."""

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

    def quadtree(self, *, deviation: float, smallest: int = 1, largest: int = 32) -> xr.DataArray:
        """Means of the squares of a quadtree on variance; see `tilepipe_kernels.quadtree.split`.

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
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            return _leaf_means(block, tile, deviation, smallest, largest)

        # squares lie on the global grid, and a square that a chunk cuts is made of all its pixels
        return self._map(function, max(int(largest) - 1, 0), np.float32)

    def ground(self, *, resolution: float, largest_object: float = 80.0) -> xr.DataArray:
        """Height of the bare earth, from heights in metres alone; see `tilepipe_kernels.ground.ground_height`.

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
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            height = ground.ground_height(
                block, resolution=resolution, largest_object=largest_object, origin=tile.padded.origin
            )
            return height[tile.core_in_padded.slices]

        return self._map(function, ground.halo(resolution, largest_object), np.float32)

    def segment(
        self, *, means: Sequence[float], method: intensity_field.Method = "parallel", rounds: int = 24, **weights: Any
    ) -> xr.DataArray:
        """Levels of grey values by a Bayesian model; see `tilepipe_kernels.intensity_field.intensity_field`.

        Parameters
        ----------
        means
            Grey value of each level, ascending, two at least.
        method
            ``parallel`` (HCF in rounds), ``messages``, ``icm`` or ``annealing``.
        rounds
            Most rounds; twice as many pixels around a chunk are read.
        weights
            Of the energy: ``potential``, ``beta``, ``sigma``; see `tilepipe_kernels.edge_model.EdgeModel`.

        Returns
        -------
        xarray.DataArray of uint8
            Level 0, 1, …; 255 = nodata.
        """
        greys, model = np.array(means, np.float64), _edge_model(len(means), weights)

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            observed = grey_levels.to_levels(np.ascontiguousarray(block, np.float32), greys)
            found = intensity_field.intensity_field(
                observed, model, method=method, rounds=rounds, origin=tile.padded.origin
            )
            return found.labels[tile.core_in_padded.slices]

        return self._map(function, intensity_field.halo(rounds, method=method), np.uint8)

    def line_field(
        self, *, levels: int, method: line_field.Method = "parallel", rounds: int = line_field.ROUNDS, **weights: Any
    ) -> xr.DataArray:
        """Line elements between the pixels of an array of levels; see `tilepipe_kernels.line_field.line_field`.

        Parameters
        ----------
        levels
            Number of levels.
        method
            ``parallel`` (HCF in rounds), ``icm`` or ``annealing``.
        rounds
            Most rounds; they set how far around a chunk is read.
        weights
            Of the energy: ``alpha``, ``gamma``, ``xi``, ``zeta``; see `tilepipe_kernels.edge_model.EdgeModel`.

        Returns
        -------
        xarray.DataArray of uint8
            1 = edge below the pixel, 2 = edge to its right, 3 = both, 255 = nodata.
        """
        model = _edge_model(levels, weights)

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            labels = np.where(np.isnan(block), _NO_LEVEL, block).astype(np.uint8)
            found = line_field.line_field(labels, model, method=method, rounds=rounds, origin=tile.padded.origin)
            lines = found.horizontal | found.vertical << 1
            lines[labels == _NO_LEVEL] = _NO_LEVEL
            return lines[tile.core_in_padded.slices]

        # one more, for the elements to the pixels of the neighbours
        return self._map(function, line_field.halo(model, rounds, method=method) + 1, np.uint8)

    def nevatia_babu(self, *, threshold: float = 0.0) -> xr.DataArray:
        """Thinned edge elements by six masks; see `tilepipe_kernels.nevatia_babu.thin_edges`.

        Parameters
        ----------
        threshold
            Least step across an edge, in the unit of the array.

        Returns
        -------
        xarray.DataArray of float32
            Step across the edge at edge elements, 0 elsewhere.
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            magnitude, direction = nevatia_babu.edge_responses(block)
            elements = nevatia_babu.thin_edges(magnitude, direction, threshold * nevatia_babu.STEP_RESPONSE)
            step = np.where(elements != nevatia_babu.NO_DIRECTION, magnitude / nevatia_babu.STEP_RESPONSE, 0)
            return step.astype(np.float32)[tile.core_in_padded.slices]

        return self._map(function, nevatia_babu.halo(), np.float32)

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


def _edge_model(levels: int, weights: dict[str, Any]) -> EdgeModel:
    """The energy of the operators of edges.

    Raises
    ------
    InputError
        A weight is unknown or out of its range.
    """
    try:
        return EdgeModel(levels=levels, **weights)
    except (TypeError, ValueError) as error:
        raise InputError(f"model of the edges: {str(error).removeprefix('EdgeModel.__init__() ')}") from None


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
