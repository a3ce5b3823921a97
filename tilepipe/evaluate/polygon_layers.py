"""Layers of polygons to be compared: repaired, without overlaps, dissolved, clipped; and the areas they share.

Large polygons are cut into pieces of few vertices before they are intersected, so the work grows with the number of
pairs that meet, not with the product of the layers or the size of one polygon.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Geometries = NDArray[np.object_]

ROUNDING = 1e-9
"""Relative rounding error of an area or a length."""

_MOST_VERTICES = 256
"""Vertices of a piece of a large polygon."""

_FEW, _MOST_ENCLOSED = 12, 0.5
"""A layer of at least so many polygons is a partition when more than this share of them has no free side."""


class PolygonLayer(NamedTuple):
    """Polygons of the objects with their numbers, the same area without overlaps, and the whole boundaries.

    `parts` and `apart` are clipped to the area, `boundary` is not. `apart` is `parts` itself where nothing overlaps.
    """

    parts: Geometries
    owner: Index
    apart: Geometries
    boundary: Geometries
    area: float
    repaired: int

    def sizes(self) -> Float:
        """Areas of the objects."""
        import shapely

        total: Float = np.bincount(self.owner, shapely.area(self.parts)).astype(np.float64)
        return total


def polygon_layer(geometry: ArrayLike, area: BaseGeometry | None, dissolve: bool, role: str) -> PolygonLayer:
    """Polygons of any geometries, repaired, and dissolved where they touch if so asked; then clipped to an area.

    Raises
    ------
    InputError
        The layer is to be dissolved but is a partition of the plane; `role` is what the message calls it.
    """
    import shapely

    rows: Geometries = np.atleast_1d(np.asarray(geometry, dtype=object)).ravel()
    rows = rows[~(shapely.is_missing(rows) | shapely.is_empty(rows))]
    invalid = ~shapely.is_valid(rows)
    if invalid.any():
        rows = rows.copy()
        rows[invalid] = shapely.make_valid(rows[invalid])
    parts, owner = _polygons(rows)
    apart = _merged(parts, touching=dissolve)
    if dissolve:
        _refuse_partition(parts, apart, role)
        parts, owner = apart, np.arange(len(apart))
    same = apart is parts
    boundary = shapely.boundary(parts)
    if area is not None:
        parts, source = _clipped(parts, area)
        owner = np.arange(len(parts)) if dissolve else owner[source]
        apart = parts if same else _clipped(apart, area)[0]
    owner = np.unique(owner, return_inverse=True)[1]
    return PolygonLayer(parts, owner, apart, boundary, float(shapely.area(apart).sum()), int(invalid.sum()))


def _refuse_partition(parts: Geometries, dissolved: Geometries, role: str) -> None:
    """Refuse polygons of which most have no free side, so that dissolving would leave one for all."""
    import shapely

    if len(parts) < _FEW:
        return
    enclosed = len(np.unique(shapely.STRtree(parts).query(dissolved, predicate="contains_properly")[1]))
    if enclosed > _MOST_ENCLOSED * len(parts):
        raise InputError(
            f"{enclosed:,} of the {len(parts):,} polygons of the {role} are shut in by others: they divide all of the "
            "ground, and dissolving would make them one; give the objects alone, of a run its buildings.parquet, "
            "or leave out --dissolve"
        )


def _polygons(geometry: Geometries) -> tuple[Geometries, Index]:
    """Polygons (not empty) of geometries of any type, and the index of the geometry of each."""
    import shapely

    parts, owner = shapely.get_parts(geometry, return_index=True)
    # A repair may leave a collection, with a multipolygon in it.
    parts, inner = shapely.get_parts(parts, return_index=True)
    keep = (shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & (shapely.area(parts) > 0)
    return parts[keep], owner[inner[keep]].astype(np.int64)


def _merged(parts: Geometries, *, touching: bool) -> Geometries:
    """Merge polygons that overlap, or also those that touch; `parts` itself where there are none.

    Polygons that meet only in points stay apart.
    """
    import shapely
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = shapely.STRtree(parts).query(parts, predicate="intersects")
    once = first < second
    first, second = first[once], second[once]
    if not touching:
        sizes = shapely.area(parts)
        shared = shapely.area(shapely.intersection(parts[first], parts[second]))
        some = shared > ROUNDING * np.minimum(sizes[first], sizes[second])
        first, second = first[some], second[some]
    if not len(first):
        return parts
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(len(parts), len(parts)))
    group = connected_components(graph, directed=False)[1]
    grouped = np.bincount(group)[group] > 1
    order = np.flatnonzero(grouped)[np.argsort(group[grouped], kind="stable")]
    number = np.unique(group[order], return_inverse=True)[1]
    collections: Geometries = np.asarray(shapely.geometrycollections(parts[order], indices=number), dtype=object)
    unions = _polygons(shapely.union_all(collections[:, None], axis=1))[0]
    return np.concatenate([parts[~grouped], unions])


def _clipped(parts: Geometries, area: BaseGeometry) -> tuple[Geometries, Index]:
    """Parts of polygons inside an area, and the index of the polygon of each."""
    import shapely

    shapely.prepare(area)
    inside = shapely.covers(area, parts)
    touched = np.flatnonzero(~inside & shapely.intersects(area, parts))
    cut, source = _polygons(shapely.intersection(parts[touched], area))
    return np.concatenate([parts[inside], cut]), np.concatenate([np.flatnonzero(inside), touched[source]])


def _subdivided(parts: Geometries) -> tuple[Geometries, Index]:
    """Halve polygons of many vertices again and again; returns the pieces and the index of the polygon of each."""
    import shapely

    source = np.arange(len(parts))
    done: list[tuple[Geometries, Index]] = []
    while len(parts):
        large = shapely.get_num_coordinates(parts) > _MOST_VERTICES
        done.append((parts[~large], source[~large]))
        parts, source = parts[large], source[large]
        left, bottom, right, top = shapely.bounds(parts).T
        wide = right - left > top - bottom
        x, y = np.where(wide, (left + right) / 2, right), np.where(wide, top, (bottom + top) / 2)
        low, low_source = _polygons(shapely.intersection(parts, shapely.box(left, bottom, x, y)))
        other = shapely.box(np.where(wide, x, left), np.where(wide, bottom, y), right, top)
        high, high_source = _polygons(shapely.intersection(parts, other))
        source = np.concatenate([source[low_source], source[high_source]])
        parts = np.concatenate([low, high])
    pieces = np.concatenate([part for part, _ in done]) if done else parts
    return pieces, np.concatenate([index for _, index in done]) if done else source


def common_areas(a: Geometries, b: Geometries) -> tuple[Index, Index, Float]:
    """Find the area that each pair of polygons has in common; indices into `a` and `b` may repeat.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.evaluate.polygon_layers import common_areas
    >>> houses = shapely.box([0, 20], 0, [10, 30], 10)
    >>> _, found, areas = common_areas(shapely.box([5], 0, [25], 10), houses)
    >>> dict(sorted(zip(found.tolist(), areas.tolist())))
    {0: 50.0, 1: 50.0}
    """
    import shapely

    a_piece, a_source = _subdivided(a)
    b_piece, b_source = _subdivided(b)
    i, j = shapely.STRtree(b_piece).query(a_piece, predicate="intersects")
    common: Float = shapely.area(shapely.intersection(a_piece[i], b_piece[j]))
    return a_source[i], b_source[j], common


def coverage(a: PolygonLayer, b: PolygonLayer) -> tuple[float, Float, Float]:
    """Area common to two layers, and the share of each object of the one and the other that is covered."""
    i, j, common = common_areas(a.apart, b.apart)
    a_pairs = (i, j, common) if a.apart is a.parts else common_areas(a.parts, b.apart)
    b_pairs = (i, j, common) if b.apart is b.parts else common_areas(a.apart, b.parts)
    a_size, b_size = a.sizes(), b.sizes()
    a_covered = np.bincount(a.owner[a_pairs[0]], a_pairs[2], len(a_size))
    b_covered = np.bincount(b.owner[b_pairs[1]], b_pairs[2], len(b_size))
    return float(common.sum()), a_covered / a_size, b_covered / b_size
