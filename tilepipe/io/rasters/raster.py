"""Open rasters: one file or many tiles as one mosaic on one pixel grid, read window by window.

A `Raster` knows its grid (CRS, pixel size, origin, shape) and reads any window as float32 with NaN for nodata.  The
sources behind it are files that GDAL reads (`tilepipe.io.rasters.sources.source`), Zarr stores and xarray arrays
(`tilepipe.io.rasters.sources.arrays`).  Everything that could go silently wrong with georeferencing is refused here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.crs.ground import ground_metres
from tilepipe.io.crs.systems import crs_text
from tilepipe.io.rasters.alignment import check_same_grid, check_same_heights, common_crs
from tilepipe.io.rasters.bands import Choice
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.rasters.reads import bands_noted
from tilepipe.io.rasters.sources.source import Source, open_source
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Member:
    """A source and the window of the mosaic that it covers."""

    source: Source
    window: Window


@dataclass(frozen=True)
class Raster:
    """One or many sources as one raster; where they overlap the first valid value in the given order holds."""

    geometry: Geometry
    members: tuple[Member, ...]
    bands: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the mosaic."""
        return self.geometry.shape

    def check_heights(self) -> None:
        """Refuse a raster whose values are to be heights but in a unit that is no known length.

        Raises
        ------
        InputError
            Names the source and its unit, and the units that are known.
        """
        for member in self.members:
            member.source.geometry.check_heights(member.source.name)

    @property
    def names(self) -> list[str]:
        """Names of the sources, for messages and for the record of a run."""
        return [member.source.name for member in self.members]

    def read(self, window: Window) -> NDArray[np.float32]:
        """Read a window of the mosaic.

        Parameters
        ----------
        window
            Window inside the mosaic.

        Returns
        -------
        ndarray of float32, shape ``window.shape``
            Values with NaN for nodata, for infinities, and for pixels that no source covers.
        """
        touched = [m for m in self.members if not m.window.intersection(window).is_empty]
        if len(touched) == 1 and touched[0].window.intersection(window) == window:
            return next(bands_noted(touched[0].source, window.relative_to(touched[0].window)))
        block = np.full(window.shape, np.nan, np.float32)
        for member in touched:
            part = member.window.intersection(window)
            _lay(block, window, next(bands_noted(member.source, part.relative_to(member.window))), part)
        return block

    def read_bands(self, window: Window) -> Iterator[NDArray[np.float32]]:
        """Read a window of each band that was opened, one after the other; else as `read`.

        A pixel comes from one source with all its bands, and is NaN in all of them where none has it.
        """
        touched = [m for m in self.members if not m.window.intersection(window).is_empty]
        parts = [member.window.intersection(window) for member in touched]
        found = [bands_noted(m.source, part.relative_to(m.window)) for m, part in zip(touched, parts, strict=True)]
        if parts == [window]:
            yield from found[0]
            return
        for _ in range(self.bands):
            block = np.full(window.shape, np.nan, np.float32)
            for values, part in zip(found, parts, strict=True):
                _lay(block, window, next(values), part)
            yield block


def _lay(block: NDArray[np.float32], window: Window, values: NDArray[np.float32], part: Window) -> None:
    """Lay values of a part of a window below what a block already has."""
    target = block[part.relative_to(window).slices]
    np.copyto(target, values, where=np.isnan(target))


def open_raster(
    inputs: Sequence[str | Path | xr.DataArray], *, crs: str | None = None, band: int | None = None
) -> Raster:
    """Open one or many rasters as one mosaic.

    Parameters
    ----------
    inputs
        Paths of GeoTIFF, COG, VRT or Zarr rasters, or xarray arrays; all on one pixel grid.
    crs
        Coordinate reference system such as ``EPSG:28992`` for inputs that name none; no input may name another.
    band
        Band to use (from 1); needed when an input has several.

    Returns
    -------
    Raster
        The mosaic, read lazily.

    Raises
    ------
    InputError
        When an input is missing, damaged or no raster, has no or a geographic CRS or another than ``crs``, is
        rotated, has no square pixels, does not lie on the grid of the first, or has another unit of heights; the
        message names it and says what to do.

    Examples
    --------
    Two arrays side by side become one mosaic, read window by window.

    >>> import numpy as np
    >>> import xarray as xr
    >>> import tilepipe
    >>> from tilepipe.tiling.grid import Window
    >>> y = 5820000 - np.arange(4) - 0.5
    >>> west = xr.DataArray(np.ones((4, 3)), {"y": y, "x": 392000.5 + np.arange(3)}, ("y", "x"))
    >>> raster = tilepipe.open_raster([west, (west + 1).assign_coords(x=west.x + 3)], crs="EPSG:32633")
    >>> raster.shape, raster.read(Window(0, 2, 1, 4)).tolist()
    ((4, 6), [[1.0, 2.0]])
    """
    return open_bands(inputs, Choice(None if band is None else (band,)), crs=crs)


def open_bands(inputs: Sequence[str | Path | xr.DataArray], choice: Choice, *, crs: str | None = None) -> Raster:
    """Open one or many rasters as one mosaic whose pixels are made of several bands; see `open_raster`.

    Parameters
    ----------
    inputs
        As for `open_raster`.
    choice
        The bands.
    crs
        As for `open_raster`.

    Raises
    ------
    InputError
        As `open_raster`; or an input does not have the bands.

    Examples
    --------
    A pixel is void where all of its bands are.

    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.bands import Choice
    >>> from tilepipe.io.rasters.raster import open_bands
    >>> from tilepipe.tiling.grid import Window
    >>> pixels = np.array([[[0, 200, 90]] * 3, [[0, 0, 40]] * 3], np.uint8)
    >>> coordinates = {"y": 5820000.0 - np.arange(3), "x": 392000.0 + np.arange(3)}
    >>> array = xr.DataArray(pixels, coordinates, ("band", "y", "x"), attrs={"_FillValue": 0})
    >>> raster = open_bands([array], Choice((1, 2)), crs="EPSG:32633")
    >>> [band.tolist() for band in raster.read_bands(Window(0, 0, 1, 3))]
    [[[nan, 200.0, 90.0]], [[nan, 0.0, 40.0]]]
    """
    if not inputs:
        raise InputError("no input raster: name at least one file")
    sources = [open_source(item, crs=crs, choice=choice) for item in inputs]
    first = sources[0].geometry
    for source in sources[1:]:
        check_same_grid(source, sources[0])
        check_same_heights(source, sources[0])
    offsets = [
        (
            round((first.top - source.geometry.top) / first.pixel),
            round((source.geometry.left - first.left) / first.pixel),
        )
        for source in sources
    ]
    top, left = min(row for row, _ in offsets), min(column for _, column in offsets)
    members = []
    for source, (row, column) in zip(sources, offsets, strict=True):
        rows, columns = source.geometry.shape
        window = Window(row - top, column - left, row - top + rows, column - left + columns)
        members.append(Member(source, window))
    shape = max(m.window.bottom for m in members), max(m.window.right for m in members)
    # everything comes from extremes, so that the order of inputs does not matter
    corner_left = min(source.geometry.left for source in sources)
    corner_top = max(source.geometry.top for source in sources)
    pixel = min(source.geometry.pixel for source in sources)
    system = common_crs(sources)
    height_metres = min(source.geometry.height_metres for source in sources)
    unknown = min((s.geometry.unknown_unit for s in sources if s.geometry.unknown_unit is not None), default=None)
    geometry = Geometry(crs_text(system), corner_left, corner_top, pixel, shape, 1.0, height_metres, unknown)
    metres = ground_metres(system, geometry.bounds, sources[0].name)
    return Raster(replace(geometry, metres=metres), tuple(members), len(choice.numbers or (1,)))


def check_aligned(raster: Raster, reference: Raster, role: str) -> Window:
    """Window of ``raster`` in the pixel coordinates of ``reference``, which must share its grid.

    Raises
    ------
    InputError
        When CRS, pixel size or alignment differ; ``role`` names the raster in the message.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from tilepipe.io.rasters.raster import check_aligned, open_raster
    >>> coordinates = {"y": 5820000.0 - np.arange(10), "x": 392000.0 + np.arange(10)}
    >>> greys = xr.DataArray(np.zeros((10, 10)), coordinates, ("y", "x"))
    >>> raster, heights = (open_raster([each], crs="EPSG:32633") for each in (greys, greys[2:8, 3:]))
    >>> check_aligned(heights, raster, "the height raster").as_tuple()
    (2, 8, 3, 10)
    """
    source, target = raster.members[0].source, reference.members[0].source
    try:
        check_same_grid(source, target)
    except InputError as error:
        raise InputError(f"{role} {error}") from None
    row = round((reference.geometry.top - raster.geometry.top) / reference.geometry.pixel)
    column = round((raster.geometry.left - reference.geometry.left) / reference.geometry.pixel)
    return Window(row, column, row + raster.shape[0], column + raster.shape[1])


def as_dataarray(raster: Raster, *, chunks: int = 2048) -> xr.DataArray:
    """The mosaic as a lazy xarray array over dask, with CRS and coordinates as rioxarray understands them.

    Parameters
    ----------
    raster
        Open raster.
    chunks
        Chunk size in pixels.

    Returns
    -------
    xarray.DataArray of float32, dims ``(y, x)``
        Lazy array with NaN for nodata; ``.rio.crs`` and ``.rio.transform()`` hold.

    Examples
    --------
    >>> import tilepipe
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=512, columns=512), layers=["height"], truth=False)
    >>> heights = tilepipe.as_dataarray(tilepipe.open_raster([written["height"]]), chunks=256)
    >>> heights.dims, heights.data.numblocks, heights.rio.crs.to_epsg()
    (('y', 'x'), (2, 2), 32633)
    """
    import dask.array as da
    import rioxarray  # noqa: F401
    import xarray as xr

    geometry = raster.geometry

    def read_block(block_info: dict[int | None, dict[str, list[tuple[int, int]]]]) -> NDArray[np.float32]:
        (top, bottom), (left, right) = block_info[None]["array-location"]
        return raster.read(Window(top, left, bottom, right))

    sizes = tuple(tuple(min(chunks, n - i) for i in range(0, n, chunks)) for n in geometry.shape)
    data = da.map_blocks(read_block, chunks=sizes, dtype=np.float32, meta=np.empty((0, 0), np.float32))
    half = geometry.pixel / 2
    coords = {
        "y": geometry.top - half - geometry.pixel * np.arange(geometry.shape[0]),
        "x": geometry.left + half + geometry.pixel * np.arange(geometry.shape[1]),
    }
    array = xr.DataArray(data, dims=("y", "x"), coords=coords, name="raster")
    return array.rio.write_crs(geometry.crs).rio.write_nodata(np.nan)  # type: ignore[no-any-return]
