"""A finished run as pictures need it: how it lies, its input in grey, its raster layers and its tables."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.enums import Resampling
from rasterio.errors import RasterioIOError
from rasterio.windows import from_bounds
from skimage.color import rgb2gray
from skimage.exposure import rescale_intensity

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import crs_of_dataset, same_crs
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.files.gdal_options import input_options
from tilepipe.io.files.manifest import Written, read_manifest, refuse_foreign, write_manifest
from tilepipe.io.files.paths import is_local
from tilepipe.io.files.record import PICTURES, RECORD, read_record
from tilepipe.io.rasters.file_bands import bands_of, read_bands
from tilepipe.io.vectors.tables import LINES, POLYGONS, metres_per_unit, read_vectors, run_table

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

Bounds = tuple[float, float, float, float]
"""Left, bottom, right, top in CRS units."""

UNKNOWN = 128
"""Grey of what the input does not know, so that gaps between laser points do not glitter."""
_GREYS = 20, 235
"""Of percentiles 2 and 98 of the input."""


@dataclass(frozen=True)
class FinishedRun:
    """The folder of a finished run, opened.

    Attributes
    ----------
    bounds, shape
        Of its rasters; rows and columns.
    metres
        Length of the unit of the CRS.
    inputs
        Input rasters that can still be read; `missing` names the others.
    record
        Content of ``run.toml``; empty when there is none.
    """

    folder: Path
    bounds: Bounds
    shape: tuple[int, int]
    crs: CRS
    metres: float
    inputs: tuple[Path, ...]
    missing: tuple[Path, ...]
    record: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def pixel(self) -> float:
        """Side of a pixel in CRS units."""
        return (self.bounds[2] - self.bounds[0]) / self.shape[1]

    @property
    def unit(self) -> str:
        """Name of the unit of the CRS."""
        return self.crs.axis_info[0].unit_name if self.crs.axis_info else "metre"

    def size(self, bounds: Bounds) -> tuple[int, int]:
        """Rows and columns of a part."""
        return round((bounds[3] - bounds[1]) / self.pixel), round((bounds[2] - bounds[0]) / self.pixel)

    def facts(self, found: str, bounds: Bounds | None = None) -> str:
        """One line of text: what was found, the pixels of the run or of a part of it, and the CRS."""
        rows, columns = self.size(bounds or self.bounds)
        pixels = f"{columns:,} × {rows:,} pixels of {self.pixel * self.metres:.2f} m"
        return "   |   ".join(part for part in (found, pixels, self.crs.name) if part)

    def kilometres(self, lines: GeoDataFrame) -> float:
        """Length of lines."""
        return float(lines.length.sum()) * self.metres / 1000

    def table(self, name: str) -> GeoDataFrame:
        """A table of lines or polygons that must be there; see `optional_table`."""
        table = self.optional_table(name)
        if table is None:
            raise InputError(f"{self.folder} holds no {name}; give the folder of a finished run")
        return table

    def optional_table(self, name: str) -> GeoDataFrame | None:
        """A table of lines or polygons, in whatever format it was written, in the CRS of the rasters; or None."""
        path = run_table(self.folder, name)
        if path is None:
            return None
        table = read_vectors(path, "result", LINES + POLYGONS)
        # a local CRS has no way even to its twin
        return table if same_crs(table.crs, self.crs) else table.to_crs(self.crs)

    @contextmanager
    def adding(self, name: str) -> Iterator[Path]:
        """Give a path to write a picture of the run to; it takes the place of the one that an earlier report has made.

        Raises
        ------
        InputError
            There is a file of this name that no report has made, or that was changed since.
        """
        known = read_manifest(self.folder / PICTURES)
        refuse_foreign(self.folder, [name], known)
        with atomic_write(self.folder / name) as aside:
            yield aside
            # what is recorded must be known before it is there
            (self.folder / name).unlink(missing_ok=True)
            others = (file for file in known if file.name != name)
            write_manifest(self.folder / PICTURES, (*others, Written.of(aside)))

    def raster(self, name: str, bounds: Bounds, shape: tuple[int, int]) -> np.ma.MaskedArray[Any, Any]:
        """A part of a raster layer, nearest pixel, as a picture of `shape` (rows, columns); nodata is masked."""
        with rasterio.open(self.folder / name) as layer:
            window = from_bounds(*bounds, transform=layer.transform)
            values: np.ma.MaskedArray[Any, Any] = layer.read(
                1, window=window, out_shape=shape, resampling=Resampling.nearest, masked=True
            )
        return values

    def background(self, bounds: Bounds, shape: tuple[int, int]) -> np.ma.MaskedArray[Any, Any]:
        """A part of the input as a grey picture of `shape` (rows, columns), uint8; what is unknown is masked.

        Rasters are read decimated, through their overviews where they have some, and stretched from percentile 2 to 98.
        Of three bands and more those called red, green and blue are taken, else the first three. Filled, the unknown is
        a middle grey.
        """
        mosaic = np.full(shape, np.nan, np.float32)
        for path in self.inputs:
            _paste(path, mosaic, bounds, self.record.get("inputs", {}).get("band"))
        known = np.isfinite(mosaic)
        grey = np.zeros(shape, np.uint8)
        if known.any():
            stretched = rescale_intensity(mosaic[known], percentiles(mosaic), _GREYS)  # type: ignore[no-untyped-call]
            grey[known] = stretched
        return np.ma.masked_array(grey, ~known, fill_value=UNKNOWN)


def open_finished_run(
    folder: str | os.PathLike[str],
    command: str,
    raster: str,
    tables: Sequence[str],
    rasters: Sequence[str | os.PathLike[str]] | None = None,
) -> FinishedRun:
    """Open the folder of a finished run of a command.

    Parameters
    ----------
    folder
        Holds the layers.
    command
        What messages call the run.
    raster, tables
        Layers that must be there, the tables in any format.
    rasters
        The input rasters; by default those recorded in ``run.toml``, looked up from here and from the folder.

    Raises
    ------
    InputError
        The folder is not that of a finished run of the command.
    """
    folder = Path(folder)
    if not (folder / raster).is_file() or any(run_table(folder, name) is None for name in tables):
        raise InputError(f"{folder} holds no {raster} with {tables[0]}; give the folder of a finished {command} run")
    return open_folder(folder, raster, rasters)


def open_folder(
    folder: Path, raster: str | None, rasters: Sequence[str | os.PathLike[str]] | None = None
) -> FinishedRun:
    """Open the folder of any finished run, which lies as a raster layer does, or else as its input did.

    Parameters and errors as for `open_finished_run`.
    """
    record = read_record(folder / RECORD) if (folder / RECORD).is_file() else {}
    named = rasters if rasters is not None else record.get("inputs", {}).get("rasters", [])
    paths = _located(folder, [named] if isinstance(named, str) else named)
    readable = tuple(path for path in paths if _is_readable(path))
    bounds, shape, crs = _lie(folder, raster, record)
    metres = metres_per_unit(crs, str(folder / (raster or RECORD)), bounds)
    missing = tuple(path for path in paths if path not in readable)
    return FinishedRun(folder, bounds, shape, CRS.from_user_input(crs), metres, readable, missing, record)


def percentiles(values: NDArray[Any]) -> tuple[float, float]:
    """Percentiles 2 and 98 of what is known of an array; 0 and 1 where nothing is."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, (2, 98)) if known.size else (0.0, 1.0)
    return float(low), float(high)


def _lie(folder: Path, raster: str | None, record: dict[str, Any]) -> tuple[Bounds, tuple[int, int], Any]:
    """Bounds, shape and CRS of a raster layer, or of the input as recorded."""
    if raster is not None:
        with rasterio.open(folder / raster) as layer:
            return tuple(layer.bounds), (layer.height, layer.width), crs_of_dataset(layer)
    lie = record.get("raster", {})
    if not {"shape", "left", "top", "pixel", "crs"} <= set(lie):
        raise InputError(f"{folder} holds no layer of a run; give the folder of a finished run")
    (rows, columns), left, top, pixel = lie["shape"], lie["left"], lie["top"], lie["pixel"]
    right, bottom = left + columns * pixel, top - rows * pixel
    # far from zero a pixel may be lost in the digits
    if not (left < right < math.inf and -math.inf < bottom < top):
        raise InputError(f"{folder / RECORD}: its [raster] lies nowhere; correct it")
    try:
        return (left, bottom, right, top), (rows, columns), CRS.from_user_input(lie["crs"])
    except CRSError:
        raise InputError(f"{folder / RECORD}: its [raster] crs is none that is known; correct it") from None


def _located(folder: Path, named: Sequence[str | os.PathLike[str]]) -> list[Path]:
    """Paths of a record, looked up from here and from the folder of the run."""
    return [
        path if path.exists() or path.is_absolute() or not is_local(path) else folder / path
        for path in map(Path, named)
    ]


def _is_readable(path: Path) -> bool:
    # reading a pipe or a device would never end
    if not (path.is_file() or path.is_dir()):
        return False
    try:
        with input_options(), rasterio.open(path):
            return True
    except RasterioIOError:
        return False


def _paste(path: Path, mosaic: NDArray[np.float32], bounds: Bounds, band: int | None) -> None:
    """Read what `path` shows of `bounds`, decimated, into `mosaic` in place."""
    rows, columns = mosaic.shape
    step_x, step_y = (bounds[2] - bounds[0]) / columns, (bounds[3] - bounds[1]) / rows
    with input_options(), rasterio.open(path) as raster:
        left, right = max(bounds[0], raster.bounds.left), min(bounds[2], raster.bounds.right)
        bottom, top = max(bounds[1], raster.bounds.bottom), min(bounds[3], raster.bounds.top)
        column0, column1 = round((left - bounds[0]) / step_x), round((right - bounds[0]) / step_x)
        row0, row1 = round((bounds[3] - top) / step_y), round((bounds[3] - bottom) / step_y)
        if column1 <= column0 or row1 <= row0:
            return
        bands = bands_of(raster)
        chosen = (band,) if band else bands.colours or bands.image[: 3 if len(bands.image) > 2 else 1]
        part = {
            "window": from_bounds(left, bottom, right, top, transform=raster.transform),
            "out_shape": (row1 - row0, column1 - column0),
            "resampling": Resampling.average,
        }
        known = np.stack(list(read_bands(raster, chosen, **part)))
    grey = rgb2gray(known, channel_axis=0) if len(known) == 3 else known[0]
    np.copyto(mosaic[row0:row1, column0:column1], grey, where=np.isfinite(grey))
