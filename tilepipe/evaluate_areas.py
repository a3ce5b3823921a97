"""Score extracted polygons against true ones by area, by object and by boundary.

Rutzinger, Rottensteiner & Pfeifer (2009), A comparison of evaluation techniques for building extraction from
airborne laser scanning, IEEE JSTARS 2(1), 11-20; the thresholds are those of the ISPRS benchmark (Rottensteiner
et al. 2014, ISPRS Journal 93, 256-271): half of an object's area, objects from 50 m², boundaries within 3 m.

Areas are those of unions, so overlapping polygons of a layer count once. Large polygons are cut into pieces of
few vertices before they are intersected, so the work grows with the number of pairs that meet, not with the
product of the layers or the size of one polygon.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError
from tilepipe.evaluate import POLYGONS, in_metres, metres_per_unit, read_area, read_vectors, result_file
from tilepipe.matching import lengths, segments

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Geometries = NDArray[np.object_]

# Vertices of a piece of a large polygon.
_MOST_VERTICES = 256
# Samples of one run of a boundary, and runs handled at once: bound the memory.
_RUN = 24
_CHUNK = 2048
# Relative rounding error of an area.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ObjectScore:
    """How many objects of at least `minimum_area` (m²) the other layer covers; NaN where there are none.

    An object is matched when the whole other layer covers at least the given share of its area. `quality` is
    Comp · Corr / (Comp + Corr - Comp · Corr), since the matched objects of both layers need not be as many.
    """

    completeness: float
    correctness: float
    quality: float
    truth_count: int
    result_count: int
    minimum_area: float


@dataclass(frozen=True)
class BoundaryScore:
    """Distances (m) from the boundary of one layer to the nearest boundary of the other; NaN where none is near.

    `near` is the share of the boundary's length within the cutoff; `rms` and `mean` are those of that part.
    """

    rms: float
    mean: float
    near: float
    length: float


@dataclass(frozen=True)
class AreaScore:
    """How well extracted polygons (`result`) agree with true ones (`truth`); areas in m², lengths in m.

    Attributes
    ----------
    completeness
        Common area / area of the truth.
    correctness
        Common area / area of the result; NaN when the result is empty.
    quality
        TP / (TP + FP + FN) by area: common area / area of the union, which is the IoU.
    objects, large_objects
        The same by object, for all objects and for those from a minimum area.
    result_to_truth, truth_to_result
        Distances of the boundaries, each way.
    overlap, cutoff, step, dissolved
        As given to `evaluate_polygons`.
    repaired_result, repaired_truth
        Number of invalid geometries that were repaired.
    """

    completeness: float
    correctness: float
    quality: float
    result_area: float
    truth_area: float
    common_area: float
    objects: ObjectScore
    large_objects: ObjectScore
    result_to_truth: BoundaryScore
    truth_to_result: BoundaryScore
    overlap: float
    cutoff: float
    step: float
    dissolved: bool
    repaired_result: int
    repaired_truth: int

    @property
    def iou(self) -> float:
        """Area of the intersection / area of the union: the quality by area."""
        return self.quality

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON, where NaN (undefined) becomes None."""

        def defined(value: Any) -> Any:
            if isinstance(value, dict):
                return {name: defined(inner) for name, inner in value.items()}
            return None if isinstance(value, float) and math.isnan(value) else value

        values: dict[str, Any] = defined(asdict(self))
        return values

    def summary(self) -> str:
        """Return a table of plain text."""
        match = f"{100 * self.overlap:g} % of an object's area" + (
            ", touching ones dissolved" if self.dissolved else ""
        )
        rows = [
            ("match", match),
            *_three_rows("area", self, f"{self.truth_area:,.0f} m² of truth", f"{self.result_area:,.0f} m² of result"),
        ]
        for title, score in (
            ("objects", self.objects),
            (f"from {self.large_objects.minimum_area:g} m²", self.large_objects),
        ):
            rows += _three_rows(title, score, f"{score.truth_count:,} of truth", f"{score.result_count:,} of result")
        rows += [
            ("boundaries", f"within {self.cutoff:g} m, sampled every {self.step:g} m"),
            ("  of result", _boundary_text(self.result_to_truth, "truth")),
            ("  of truth", _boundary_text(self.truth_to_result, "result")),
        ]
        if self.repaired_result or self.repaired_truth:
            rows.append(("repaired", f"{self.repaired_result} invalid of result, {self.repaired_truth} of truth"))
        return "\n".join(f"{name:<16}{value}".rstrip() for name, value in rows)


def _percent(value: float) -> str:
    return "undefined" if math.isnan(value) else f"{100 * value:.1f} %"


def _three_rows(title: str, score: AreaScore | ObjectScore, truth: str, result: str) -> list[tuple[str, str]]:
    return [
        (title, ""),
        ("  completeness", f"{_percent(score.completeness)}  of {truth}"),
        ("  correctness", f"{_percent(score.correctness)}  of {result}"),
        ("  quality", _percent(score.quality) + (" (IoU)" if isinstance(score, AreaScore) else "")),
    ]


def _boundary_text(score: BoundaryScore, other: str) -> str:
    if math.isnan(score.rms):
        return f"undefined, no boundary of {other} is near"
    return f"RMS {score.rms:.2f} m, mean {score.mean:.2f} m  of the {_percent(score.near)} near {other}"


def evaluate_polygons(
    result: ArrayLike,
    truth: ArrayLike,
    *,
    overlap: float = 0.5,
    minimum_area: float = 50.0,
    cutoff: float = 3.0,
    step: float = 0.5,
    area: BaseGeometry | None = None,
    dissolve: bool = False,
) -> AreaScore:
    """Score `result` against `truth` in one plane, in metres.

    Parameters
    ----------
    result, truth
        Shapely Polygons or MultiPolygons, each one object. Missing and empty geometries do not count, invalid
        ones are repaired.
    overlap
        Smallest share of an object's area that the other layer must cover to match it, inclusive; above 0, to 1.
    minimum_area
        Smallest area of an object of `large_objects`, inclusive.
    cutoff
        Boundaries farther than this from the other's are left out of the distances, inclusive.
    step
        Longest piece of a boundary that one sample, its middle, stands for.
    area
        Polygon to which both layers are clipped. Its own border is no boundary of an object.
    dissolve
        Merge the polygons of each layer that touch or overlap, before clipping. The objects are then the
        connected parts: a terrace of houses is one object, and its inner walls are no boundaries.

    Notes
    -----
    Without `dissolve`, a wall between two polygons of a layer counts in the boundary of each.

    Raises
    ------
    InputError
        A threshold is out of range, or no truth lies in the area.
    """
    if not 0 < overlap <= 1:
        raise InputError(f"overlap is {overlap}; give a share of an object's area, above 0 and at most 1")
    if not 0 <= minimum_area < math.inf:
        raise InputError(f"minimum area is {minimum_area}; give 0 or more square metres")
    for name, value in (("cutoff", cutoff), ("step", step)):
        if not 0 < value < math.inf:
            raise InputError(f"{name} is {value}; give a positive distance")
    a, b = _layer(result, area, dissolve), _layer(truth, area, dissolve)
    if not b.area:
        raise InputError(f"the truth has no polygons{'' if area is None else ' inside the area'}; give some to compare")
    common, a_share, b_share = _coverage(a, b)
    a_matched, b_matched = (share >= overlap * (1 - _ROUNDING) for share in (a_share, b_share))
    a_size, b_size = a.sizes(), b.sizes()

    def by_object(least: float) -> ObjectScore:
        in_a, in_b = (size >= least * (1 - _ROUNDING) for size in (a_size, b_size))
        completeness, correctness = _mean(b_matched[in_b]), _mean(a_matched[in_a])
        quality = _quality(completeness, correctness)
        return ObjectScore(completeness, correctness, quality, int(in_b.sum()), int(in_a.sum()), least)

    completeness, correctness = _ratio(common, b.area), _ratio(common, a.area)
    return AreaScore(
        completeness=completeness,
        correctness=correctness,
        quality=_ratio(common, a.area + b.area - common),
        result_area=a.area,
        truth_area=b.area,
        common_area=common,
        objects=by_object(0.0),
        large_objects=by_object(minimum_area),
        result_to_truth=_boundary_score(segments(a.boundary, area), segments(b.boundary), cutoff, step),
        truth_to_result=_boundary_score(segments(b.boundary, area), segments(a.boundary), cutoff, step),
        overlap=overlap,
        cutoff=cutoff,
        step=step,
        dissolved=dissolve,
        repaired_result=a.repaired,
        repaired_truth=b.repaired,
    )


def evaluate_areas(
    result_path: str | os.PathLike[str],
    truth_path: str | os.PathLike[str],
    area_path: str | os.PathLike[str] | None = None,
    *,
    overlap: float = 0.5,
    minimum_area: float = 50.0,
    cutoff: float = 3.0,
    step: float = 0.5,
    dissolve: bool = False,
) -> AreaScore:
    """Score a file of extracted polygons, or the objects of a run's folder, against a file of true polygons.

    Coordinates are turned into metres by the CRS's own unit. The truth must be in the CRS of the result, as a
    reprojection would move areas and boundaries; `area_path`, a file of polygons, is reprojected.
    Parameters and units as in `evaluate_polygons`: metres and square metres.

    Raises
    ------
    InputError
        A file is missing or unreadable, holds no polygons, or names no CRS; a CRS is geographic; the two CRS
        differ; the truth is empty.
    """
    result = read_vectors(result_file(Path(result_path)), "result", POLYGONS)
    truth = read_vectors(Path(truth_path), "truth", POLYGONS)
    metres = metres_per_unit(result.crs, str(result_path))
    metres_per_unit(truth.crs, str(truth_path))
    if not _same_plane(result.crs, truth.crs):
        raise InputError(
            f"{result_path} is in {result.crs.name} and {truth_path} in {truth.crs.name}; "
            "reproject one to the CRS of the other"
        )
    area = None if area_path is None else read_area(Path(area_path), result.crs, metres)
    return evaluate_polygons(
        in_metres(result.geometry.to_numpy(), metres),
        in_metres(truth.geometry.to_numpy(), metres),
        overlap=overlap,
        minimum_area=minimum_area,
        cutoff=cutoff,
        step=step,
        area=area,
        dissolve=dissolve,
    )


def _same_plane(a: Any, b: Any) -> bool:
    """Whether two CRS agree, heights aside; files of one CRS may spell its names in different ways."""
    a, b = (crs.sub_crs_list[0] if crs.is_compound else crs for crs in (a, b))
    code = a.to_epsg()
    return bool(a.equals(b, ignore_axis_order=True)) or (code is not None and code == b.to_epsg())


class _Layer(NamedTuple):
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


def _layer(geometry: ArrayLike, area: BaseGeometry | None, dissolve: bool) -> _Layer:
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
        parts, owner = apart, np.arange(len(apart))
    same = apart is parts
    boundary = shapely.boundary(parts)
    if area is not None:
        parts, source = _clipped(parts, area)
        owner = np.arange(len(parts)) if dissolve else owner[source]
        apart = parts if same else _clipped(apart, area)[0]
    owner = np.unique(owner, return_inverse=True)[1]
    return _Layer(parts, owner, apart, boundary, float(shapely.area(apart).sum()), int(invalid.sum()))


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
        some = shared > _ROUNDING * np.minimum(sizes[first], sizes[second])
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


def _common_areas(a: Geometries, b: Geometries) -> tuple[Index, Index, Float]:
    """Find the area that each pair of polygons has in common; indices into `a` and `b` may repeat."""
    import shapely

    a_piece, a_source = _subdivided(a)
    b_piece, b_source = _subdivided(b)
    i, j = shapely.STRtree(b_piece).query(a_piece, predicate="intersects")
    common: Float = shapely.area(shapely.intersection(a_piece[i], b_piece[j]))
    return a_source[i], b_source[j], common


def _coverage(a: _Layer, b: _Layer) -> tuple[float, Float, Float]:
    """Area common to two layers, and the share of each object of the one and the other that is covered."""
    i, j, common = _common_areas(a.apart, b.apart)
    a_pairs = (i, j, common) if a.apart is a.parts else _common_areas(a.parts, b.apart)
    b_pairs = (i, j, common) if b.apart is b.parts else _common_areas(a.apart, b.parts)
    a_size, b_size = a.sizes(), b.sizes()
    a_covered = np.bincount(a.owner[a_pairs[0]], a_pairs[2], len(a_size))
    b_covered = np.bincount(b.owner[b_pairs[1]], b_pairs[2], len(b_size))
    return float(common.sum()), a_covered / a_size, b_covered / b_size


def _mean(matched: NDArray[np.bool_]) -> float:
    return float(matched.mean()) if len(matched) else math.nan


def _ratio(part: float, whole: float) -> float:
    return min(part / whole, 1.0) if whole else math.nan


def _quality(completeness: float, correctness: float) -> float:
    """TP / (TP + FP + FN) from its two ratios; a ratio without objects counts as none matched."""
    if math.isnan(completeness) and math.isnan(correctness):
        return math.nan
    product = completeness * correctness
    return product / (completeness + correctness - product) if product > 0 else 0.0


def _boundary_score(a: Float, b: Float, cutoff: float, step: float) -> BoundaryScore:
    """Distances from the segments `a` to the nearest of `b`, integrated over the length of `a`."""
    near = total = squares = 0.0
    for distance, weight in _nearest_distances(a, b, cutoff, step):
        close = distance <= cutoff * (1 + _ROUNDING)
        weight = np.broadcast_to(weight[:, None], distance.shape)[close]
        distance = distance[close]
        near += float(weight.sum())
        total += float((weight * distance).sum())
        squares += float((weight * distance * distance).sum())
    length = float(lengths(a).sum())
    rms, mean = (math.sqrt(squares / near), total / near) if near else (math.nan, math.nan)
    return BoundaryScore(rms=rms, mean=mean, near=_ratio(near, length), length=length)


def _nearest_distances(a: Float, b: Float, cutoff: float, step: float) -> Iterator[tuple[Float, Float]]:
    """Yield distances (n, k) from k samples of n pieces of `a` to `b`, inf beyond reach, and the sample length (n,)."""
    import shapely

    tree = shapely.STRtree(shapely.linestrings(b))
    a = _cut(a, _RUN * step)
    samples = np.maximum(np.ceil(lengths(a) / step), 1).astype(np.int64)
    # The distances are tested on their own, so the bounds may be wider.
    reach = 1.001 * cutoff
    for count in np.unique(samples):
        alike = a[samples == count]
        for low in range(0, len(alike), _CHUNK):
            run = alike[low : low + _CHUNK]
            # The tree asks only for the bounds, and a diagonal has those of its box.
            diagonals = shapely.linestrings(np.stack([run.min(axis=1) - reach, run.max(axis=1) + reach], axis=1))
            i, j = tree.query(diagonals)
            squared = np.full((len(run), count), np.inf)
            if len(i):
                found, first = np.unique(i, return_index=True)
                squared[found] = np.minimum.reduceat(_squared_distances(run[i], b[j], count), first, axis=0)
            yield np.sqrt(squared), lengths(run) / count


def _cut(a: Float, longest: float) -> Float:
    """Cut segments into equal pieces no longer than given."""
    count = np.maximum(np.ceil(lengths(a) / longest), 1).astype(np.int64)
    source = np.repeat(np.arange(len(a)), count)
    place = (np.arange(len(source)) - (np.cumsum(count) - count)[source])[:, None]
    delta = (a[:, 1] - a[:, 0])[source] / count[source, None]
    start = a[source, 0] + place * delta
    pieces: Float = np.stack([start, start + delta], axis=1)
    return pieces


def _squared_distances(a: Float, b: Float, count: int) -> Float:
    """Squared distances (n, count) from the middles of `count` equal parts of each segment to its partner."""
    t = (np.arange(count) + 0.5) / count
    (x, y), (u, v), (along, up) = (a[:, 0] - b[:, 0]).T, (a[:, 1] - a[:, 0]).T, (b[:, 1] - b[:, 0]).T
    squared_length = along * along + up * up
    # Both the sample and its foot on the partner's line move linearly.
    foot = ((x * along + y * up) / squared_length)[:, None] + ((u * along + v * up) / squared_length)[:, None] * t
    np.clip(foot, 0.0, 1.0, out=foot)
    across = x[:, None] + u[:, None] * t - along[:, None] * foot
    upward = y[:, None] + v[:, None] * t - up[:, None] * foot
    squared: Float = across * across + upward * upward
    return squared
