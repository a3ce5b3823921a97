"""Lines and polygons for pictures: their coordinates, the longest of too many, and where most of them lie."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from tilepipe.report.finished_run import Bounds, FinishedRun

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


def coordinates(geometry: Any) -> list[NDArray[np.float64]]:
    """Coordinates (n, 2) of each line, and of each ring of each polygon.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.report.vectors import coordinates
    >>> [part.tolist() for part in coordinates([shapely.LineString([(0, 0), (2, 1)])])]
    [[[0.0, 0.0], [2.0, 1.0]]]
    >>> [len(part) for part in coordinates([shapely.box(0, 0, 1, 1)])]
    [5]
    """
    parts = shapely.get_parts(geometry)
    areas = shapely.get_dimensions(parts) == 2
    lines = np.concatenate([parts[~areas], shapely.get_rings(parts[areas])])
    points, line = shapely.get_coordinates(lines, return_index=True)
    return np.split(points, np.flatnonzero(np.diff(line)) + 1) if len(points) else []


def longest(table: GeoDataFrame, most: int) -> GeoDataFrame:
    """The longest `most` rows of a table, in its order.

    Examples
    --------
    >>> import geopandas
    >>> import shapely
    >>> from tilepipe.report.vectors import longest
    >>> lines = [shapely.LineString([(0, 0), (length, 0)]) for length in (3, 1, 4, 2)]
    >>> longest(geopandas.GeoDataFrame(geometry=lines), 2).length.tolist()
    [3.0, 4.0]
    """
    if len(table) <= most:
        return table
    return table.iloc[np.sort(np.argsort(-table.length.to_numpy(), kind="stable")[:most])]


def busiest_window(lines: GeoDataFrame, run: FinishedRun, side: int) -> Bounds | None:
    """The square of `side` pixels with most length of lines; None where the raster is hardly larger.

    A multiple of 8 keeps to the pixels.
    """
    rows, columns = run.shape
    if max(rows, columns) <= 1.2 * side:
        return None
    left, _, _, top = run.bounds
    cell = max(side // 8, 1)
    step = cell * run.pixel
    shape = math.ceil(rows / cell), math.ceil(columns / cell)
    # Points at even steps along the lines: their number is the length.
    dense = shapely.segmentize(lines.geometry.to_numpy(), step / 4)
    points, line = shapely.get_coordinates(dense, return_index=True)
    same = line[1:] == line[:-1]
    middle, delta = (points[1:] + points[:-1])[same] / 2, (points[1:] - points[:-1])[same]
    row = np.clip((top - middle[:, 1]) / step, 0, shape[0] - 1).astype(int)
    column = np.clip((middle[:, 0] - left) / step, 0, shape[1] - 1).astype(int)
    counts = np.bincount(row * shape[1] + column, np.hypot(*delta.T), shape[0] * shape[1]).reshape(shape)
    size = min(8, shape[0]), min(8, shape[1])
    # The filter gives the mean around a cell; those of windows that lie inside begin with the one at the first cell.
    means = uniform_filter(counts, size, mode="constant", origin=[-(n // 2) for n in size])
    inside = means[: shape[0] - size[0] + 1, : shape[1] - size[1] + 1]
    best_row, best_column = np.unravel_index(int(inside.argmax()), inside.shape)
    row0, column0 = min(int(best_row) * cell, max(rows - side, 0)), min(int(best_column) * cell, max(columns - side, 0))
    west, north = left + column0 * run.pixel, top - row0 * run.pixel
    return west, north - min(side, rows) * run.pixel, west + min(side, columns) * run.pixel, north
