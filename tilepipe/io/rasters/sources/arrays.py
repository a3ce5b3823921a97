"""xarray arrays as sources behind a raster."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.files.identity import changed, digest_of
from tilepipe.io.files.paths import one_line
from tilepipe.io.rasters.bands import Bands, Choice
from tilepipe.io.rasters.georeference import Geometry, check_geometry
from tilepipe.io.rasters.packing import Packing, packing_of, unpack_bands
from tilepipe.io.rasters.sources.axes import array_crs, bands_first, map_order
from tilepipe.io.rasters.sources.stores import StoreFiles
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr

ARRAY = "the array"
"""Name of an input that is no file."""

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)

_UNEVEN = 0.1
"""Largest deviation of the spacing of coordinates that is taken for rounding, in pixels."""

_ROWS = 1024
"""Rows of an array that are read at once for its checksum."""


@dataclass(frozen=True)
class ArraySource:
    """An xarray array (in memory, over dask, or a Zarr store), north first.

    Attributes
    ----------
    array
        Dims ``(band, y, x)``: the bands that are read, and alpha after them where there is one.
    packings
        How each band is stored.
    files
        Stamp of the files of a store.
    """

    name: str
    geometry: Geometry
    array: Any
    packings: tuple[Packing, ...]
    files: StoreFiles | None = None

    @cached_property
    def content(self) -> str:
        """Digest of the files of a store, of the name of the graph of a lazy array, of the values of any other."""
        if self.files is not None:
            return self.files.content
        return digest_of(str(self.array.data.name) if self.array.chunks is not None else self._checksum())

    @property
    def stamp(self) -> str:
        """Digest of all that is known of the files of a store; else as `content`."""
        return self.files.stamp if self.files is not None else self.content

    @property
    def lines(self) -> list[str]:
        """What tells in the record of an unfinished run whether this is still the same array."""
        return self.files.lines if self.files is not None else [f"{self.array.nbytes} - {self.content} {self.name}"]

    @property
    def is_known(self) -> bool:
        """Whether the stamp tells all: not what an array held while tiles read it, nor what a graph will compute."""
        return self.files is not None

    @property
    def paths(self) -> tuple[Path, ...]:
        """Folder of a store."""
        return (Path(self.files.path),) if self.files is not None else ()

    @property
    def elsewhere(self) -> tuple[str, ...]:
        """What is read on the network."""
        return () if self.files is not None or self.name == ARRAY else (self.name,)

    def check(self, window: Window | None = None) -> None:
        """See `source.Source.check`; an array in memory is compared as a whole, at the end."""
        if self.files is not None:
            self.files.check(window)
        elif window is None and self.array.chunks is None and digest_of(self._checksum()) != self.content:
            raise changed(self.name, written=False)

    def _checksum(self) -> str:
        """Checksum of the values of an array in memory."""
        total = 0
        for plane in self.array:
            for top in range(0, plane.shape[0], _ROWS):
                rows = np.ascontiguousarray(plane[top : top + _ROWS].data)
                total = zlib.crc32(rows.view(np.uint8).data, total)
        return f"{total:08x}"

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """See `Source.read_bands`."""
        stored, count = self._stored(window), len(self.packings)
        alpha = self.packings[0].stored(stored[count]) if len(stored) > count else None
        return unpack_bands(list(stored[:count]), self.packings, alpha)

    def _stored(self, window: Window) -> NDArray[Any]:
        part = self.array[(slice(None), *window.slices)].data
        try:
            return np.asarray(part.compute(scheduler="synchronous") if hasattr(part, "compute") else part)
        except Exception as error:
            # what the graph of an array of the user's says is his; a store is data
            if self.name == ARRAY:
                raise
            # a store that is being replaced is no damaged one
            self.check(window)
            raise InputError(
                f"{self.name}: is damaged, its rows {window.top}:{window.bottom}, columns {window.left}:{window.right} "
                f"cannot be read ({one_line(error)}); copy the store anew"
            ) from error


def array_source(array: xr.DataArray, name: str, *, crs: str | None, choice: Choice) -> ArraySource:
    """A source over an xarray array: dims in any order, y up or down, CRS as rioxarray finds it.

    Raises
    ------
    InputError
        See `open_raster`.
    """
    array = bands_first(array, name)
    _, y, x = array.dims
    check_chunks(array, name)
    band = choice.of(array_bands(array), name)[0]
    array, packings = _chosen(array, name, choice)
    rows, _ = map_order(array)
    if rows != slice(None):
        array = array.isel({y: rows})
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: holds {array.dtype} values; use a raster of real numbers")
    shape, units = (array.sizes[y], array.sizes[x]), array.attrs.get("units")
    # rioxarray gives one for each band where the bands differ
    unit = units[band - 1] if isinstance(units, (tuple, list)) else units
    unit = None if unit is None else str(unit)
    geometry = check_geometry(name, array_crs(array, name), _transform(array, name), shape, crs, unit)
    return ArraySource(name, geometry, array, packings)


def check_chunks(array: xr.DataArray, name: str) -> None:
    """Refuse a lazy array whose shape is not known before it is computed.

    Raises
    ------
    InputError
        Names the array and what to do.
    """
    if any(np.isnan(size) for sizes in array.chunks or () for size in sizes):
        raise InputError(f"{name}: has chunks of unknown sizes; make it of dask_array.compute_chunk_sizes()")


def _chosen(array: xr.DataArray, name: str, choice: Choice) -> tuple[xr.DataArray, tuple[Packing, ...]]:
    """The bands of an array that are chosen, alpha after them, and how each of them is stored."""
    bands = array_bands(array)
    numbers = choice.of(bands, name)
    packings = tuple(packing_of(array[number - 1], name) for number in numbers)
    read = [number - 1 for number in (*numbers, *([bands.alpha] if bands.alpha else []))]
    # a whole array stays as it is, for slices of it are views
    return array if read == list(range(array.shape[0])) else array[read], packings


def array_bands(array: xr.DataArray) -> Bands:
    """The bands of an array along its first dimension, by their names where its coordinate or ``long_name`` has some.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.sources.arrays import array_bands
    >>> pixels = xr.DataArray(np.zeros((2, 3, 3)), {"band": ["grey", "alpha"]}, ("band", "y", "x"))
    >>> array_bands(pixels).image
    (1,)
    """
    dim, count = array.dims[0], array.shape[0]
    names = array[dim].to_numpy().tolist() if dim in array.coords else array.attrs.get("long_name")
    if not isinstance(names, (list, tuple)) or len(names) != count:
        names = [""] * count
    return Bands.of([str(name).lower() for name in names])


def _transform(array: Any, name: str) -> tuple[float, ...]:
    """Affine coefficients from the coordinates of an array, which must be evenly spaced, or from its GeoTransform."""
    for dim in (array.rio.y_dim, array.rio.x_dim):
        if dim not in array.coords:
            transform = tuple(array.rio.transform())[:6]
            if transform == _IDENTITY:
                raise InputError(f"{name}: has no coordinates; give it x and y coordinates of the pixel centres")
            return transform
        centres = np.asarray(array[dim], dtype=np.float64)
        steps = np.diff(centres)
        if steps.size and not np.all(np.abs(steps - steps.mean()) <= _UNEVEN * abs(steps.mean())):
            raise InputError(f"{name}: its {dim} coordinates are not evenly spaced; reindex or resample it first")
    return tuple(array.rio.transform(recalc=True))[:6]
