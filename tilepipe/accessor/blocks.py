"""What all lazy operators share: chunks with their halos, nodata, and what an array carries beside its values."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from tilepipe.errors import InputError
from tilepipe.io.rasters.packing import HOW_STORED, Packing, packing_of
from tilepipe.io.rasters.sources.arrays import ARRAY, check_chunks
from tilepipe.io.rasters.sources.axes import map_order, rows_first
from tilepipe.tiling.grid import Tile, TileGrid, Window

BlockFunction = Callable[[NDArray[Any], Tile], NDArray[Any]]
"""From a block with its halo to the values of its core."""

_NODATA = ("_FillValue", "missing_value", "fill_value", "nodata", "nodatavals")
_STORAGE = ("dtype", "rasterio_dtype", "_Unsigned")


class BlockOperators:
    """An array of two dimensions and how a function of blocks becomes an operator on it."""

    def __init__(self, array: xr.DataArray) -> None:
        if array.ndim != 2:
            raise InputError(f"tilepipe works on arrays of two dimensions, not {array.ndim}: select a band first")
        check_chunks(array, ARRAY)
        # operators count in rows and columns, so that a pixel's right is that of the map
        self._array, self._dims = rows_first(array), array.dims

    def map_blocks(
        self, name: str, function: BlockFunction, halo: int, dtype: DTypeLike, nodata: float | None = None
    ) -> xr.DataArray:
        """Apply a local function, the operator ``name``, to every chunk and its halo.

        The function gets the values that are meant, scaled if the array is packed, with NaN for nodata; ``nodata`` is
        what it gives there itself, where this is not NaN.
        """
        # squares, cells and directions are those of the map, whichever way the array runs
        order = map_order(self._array)
        data, packing = _ordered(self._array.data, order), packing_of(self._array, ARRAY)

        def on_pieces(pieces: list[list[NDArray[Any]]], tile: Tile) -> NDArray[Any]:
            return function(meant(np.block(pieces), packing), tile)

        if not hasattr(data, "dask"):
            whole = TileGrid(data.shape, data.shape).tile(0)
            return self._like(name, _ordered(on_pieces([[np.asarray(data)]], whole), order), nodata)
        import dask
        import dask.array as da

        on_pieces.__name__ = name  # what the tasks are called on a dashboard
        delayed, tiles = dask.delayed(on_pieces, pure=False), _chunk_tiles(data, halo)
        chunks = data.to_delayed(optimize_graph=False)
        blocks = [
            [
                da.from_delayed(delayed(_pieces(chunks, tiles, tile), tile), shape=tile.core.shape, dtype=dtype)
                for tile in row
            ]
            for row in tiles
        ]
        return self._like(name, _ordered(da.block(blocks), order), nodata)

    def _like(self, name: str, data: Any, nodata: float | None = None) -> xr.DataArray:
        """Other values under another name: same dims, coordinates, CRS and attributes but those of how it was stored.

        Where the array declares nodata, the result declares its own, if it has one.
        """
        result = self._array.copy(data=data).rename(name)
        marked = any(key in result.attrs or key in result.encoding for key in _NODATA)
        for key in _NODATA + HOW_STORED:
            result.attrs.pop(key, None)
        for key in _NODATA + HOW_STORED + _STORAGE:
            result.encoding.pop(key, None)
        nodata = np.nan if result.dtype.kind == "f" else nodata
        if marked and nodata is not None:
            result.attrs["_FillValue"] = nodata
        return result.transpose(*self._dims)


def _ordered(data: Any, order: tuple[slice, slice]) -> Any:
    """Values in the order of the map, or back; as they are where that is the same."""
    return data if order == (slice(None), slice(None)) else data[order]


def meant(block: NDArray[Any], packing: Packing) -> NDArray[Any]:
    """What stored values mean: scaled, with NaN for nodata and infinities; as they are where that is the same."""
    if block.dtype.kind == "b" or (packing == Packing() and block.dtype.kind != "f"):
        return block
    if packing != Packing():
        return packing.unpack(block)
    infinite = np.isinf(block)
    return np.where(infinite, block.dtype.type(np.nan), block) if infinite.any() else block


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


def even_grid(data: Any) -> TileGrid:
    """The tiling of a dask array with even chunks."""
    sizes = tuple(max(sizes) for sizes in data.chunks)
    grid = TileGrid(tuple(data.shape), sizes)
    if grid.counts != tuple(len(sizes) for sizes in data.chunks) or any(
        size != sizes[0] for sizes in data.chunks for size in sizes[:-1]
    ):
        raise InputError(f"chunks {data.chunks} are uneven: rechunk to equal chunks first, for example .chunk(1024)")
    return grid
