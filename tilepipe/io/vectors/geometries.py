"""Ragged arrays of coordinates as shapely's geometries."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.arcs import Labels
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.polygons import PolygonRings


def region_polygons(
    rings: PolygonRings, arcs: Arcs, transform: Sequence[float] = (1, 0, 0, 0, -1, 0)
) -> tuple[Labels, NDArray[Any]]:
    """Polygons of regions, from the arcs between them.

    Parameters
    ----------
    rings
        Which arcs bound which region.
    arcs
        Their geometry, exact or simplified.
    transform
        Affine coefficients from columns and rows to x and y, see `PolygonRings.coordinates`.

    Returns
    -------
    regions : ndarray, shape (n,)
        Region ids, ascending.
    geometries : ndarray of object, shape (n,)
        A Polygon for each, or a MultiPolygon where a region has several parts.
    """
    import shapely

    coordinates, bounds = rings.coordinates(arcs, transform)
    ragged = coordinates, (bounds, rings.polygon_offsets)
    with _without_collector():
        polygons: NDArray[Any] = shapely.from_ragged_array(shapely.GeometryType.POLYGON, *ragged)
    first = np.flatnonzero(np.diff(rings.region, prepend=0) != 0)
    parts = np.diff(first, append=len(polygons))
    geometries = polygons[first]
    several = np.flatnonzero(parts > 1)
    of_several = np.repeat(parts > 1, parts)
    if several.size:
        indices = np.repeat(np.arange(several.size), parts[several])
        geometries[several] = shapely.multipolygons(polygons[of_several], indices=indices)
    return rings.region[first], geometries


@contextmanager
def _without_collector() -> Iterator[None]:
    """Hold the garbage collector: its passes over the many new geometries would more than double the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def line_strings(polylines: Polylines) -> NDArray[np.object_]:
    """Shapely LineStrings of polylines.

    Parameters
    ----------
    polylines
        With vertices (x, y), finite.

    Returns
    -------
    ndarray of object, shape (n,)
        LineStrings.

    Raises
    ------
    ValueError
        As for `checked_polylines`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.io.vectors.geometries import line_strings
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> vertices = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> [line.length for line in line_strings(Polylines(np.array([0, 2, 5]), vertices))]
    [5.0, 2.0]
    """
    import shapely

    checked = checked_polylines(polylines)
    if not len(checked):
        return np.empty(0, dtype=object)
    ragged = checked.vertices, (checked.offsets,)
    lines: NDArray[np.object_] = shapely.from_ragged_array(shapely.GeometryType.LINESTRING, *ragged)
    return lines


def checked_polylines(polylines: Polylines) -> Polylines:
    """Polylines that can be written, their vertices contiguous and float64.

    Raises
    ------
    ValueError
        Shapes do not match, a polyline has fewer than two vertices, or a coordinate is not finite.
    """
    coordinates = np.ascontiguousarray(polylines.vertices, dtype=np.float64)
    starts: NDArray[np.int64] = np.asarray(polylines.offsets, dtype=np.int64)
    if coordinates.ndim != 2 or coordinates.shape[1] != 2:
        raise ValueError(f"coordinates must have shape (vertices, 2), got {coordinates.shape}")
    if starts.ndim != 1 or len(starts) == 0 or starts[0] != 0 or starts[-1] != len(coordinates):
        raise ValueError("offsets must be one-dimensional and run from 0 to the number of vertices")
    if (np.diff(starts) < 2).any():
        raise ValueError("a line needs two vertices or more; drop shorter ones before writing")
    if not np.isfinite(coordinates).all():
        raise ValueError("coordinates must be finite; drop lines with NaN or infinity before writing")
    return Polylines(starts, coordinates)
