"""Score extracted polygons against true ones by area, by object and by boundary.

Rutzinger, Rottensteiner & Pfeifer (2009), A comparison of evaluation techniques for building extraction from
airborne laser scanning, IEEE JSTARS 2(1), 11-20; the thresholds are those of the ISPRS benchmark (Rottensteiner
et al. 2014, ISPRS Journal 93, 256-271): half of an object's area, objects from 50 m², boundaries within 3 m.

Areas are those of unions, so overlapping polygons of a layer count once.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError
from tilepipe.evaluate.boundary_distances import BoundaryScore, boundary_score
from tilepipe.evaluate.extent import area_in_metres, scored_area
from tilepipe.evaluate.lines import defined_values, percent
from tilepipe.evaluate.polygon_layers import ROUNDING, coverage, polygon_layer
from tilepipe.evaluate.results import read_result
from tilepipe.evaluate.segment_matching import segments
from tilepipe.io.crs.systems import agreed_crs, split_crs
from tilepipe.io.vectors.tables import POLYGONS, VectorLayer, in_metres, read_layer

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


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
    area
        What both were clipped to, if anything.
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
    area: str | None = None

    @property
    def iou(self) -> float:
        """Area of the intersection / area of the union: the quality by area."""
        return self.quality

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON, where NaN (undefined) becomes None."""
        return defined_values(self)

    def summary(self) -> str:
        """Return a table of plain text."""
        match = f"{100 * self.overlap:g} % of an object's area" + (
            ", touching ones dissolved" if self.dissolved else ""
        )
        rows = [
            ("match", match),
            *([("inside", self.area)] if self.area else []),
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


def _three_rows(title: str, score: AreaScore | ObjectScore, truth: str, result: str) -> list[tuple[str, str]]:
    return [
        (title, ""),
        ("  completeness", f"{percent(score.completeness)}  of {truth}"),
        ("  correctness", f"{percent(score.correctness)}  of {result}"),
        ("  quality", percent(score.quality) + (" (IoU)" if isinstance(score, AreaScore) else "")),
    ]


def _boundary_text(score: BoundaryScore, other: str) -> str:
    if math.isnan(score.rms):
        return f"undefined, no boundary of {other} is near"
    return f"RMS {score.rms:.2f} m, mean {score.mean:.2f} m  of the {percent(score.near)} near {other}"


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
        connected parts: a terrace of houses is one object, and its inner walls are no boundaries. A layer that
        divides all of the ground, such as the objects of a run, would become one object and is refused.

    Notes
    -----
    Without `dissolve`, a wall between two polygons of a layer counts in the boundary of each.

    Raises
    ------
    InputError
        A threshold is out of range, no truth lies in the area, or a layer to dissolve is a partition.

    Examples
    --------
    A house of 10 m × 10 m, mapped 2 m too far to the right.

    >>> import shapely
    >>> import tilepipe
    >>> score = tilepipe.evaluate_polygons([shapely.box(2, 0, 12, 10)], [shapely.box(0, 0, 10, 10)])
    >>> round(score.completeness, 2), round(score.iou, 2), score.objects.completeness
    (0.8, 0.67, 1.0)
    """
    if not 0 < overlap <= 1:
        raise InputError(f"overlap is {overlap}; give a share of an object's area, above 0 and at most 1")
    if not 0 <= minimum_area < math.inf:
        raise InputError(f"minimum area is {minimum_area}; give 0 or more square metres")
    for name, value in (("cutoff", cutoff), ("step", step)):
        if not 0 < value < math.inf:
            raise InputError(f"{name} is {value}; give a positive distance")
    a, b = polygon_layer(result, area, dissolve, "result"), polygon_layer(truth, area, dissolve, "truth")
    if not b.area:
        where = "" if area is None else " inside the area (that given, or the extent of the run's data)"
        raise InputError(f"the truth has no polygons{where}; give some to compare")
    common, a_share, b_share = coverage(a, b)
    a_matched, b_matched = (share >= overlap * (1 - ROUNDING) for share in (a_share, b_share))
    a_size, b_size = a.sizes(), b.sizes()

    def by_object(least: float) -> ObjectScore:
        in_a, in_b = (size >= least * (1 - ROUNDING) for size in (a_size, b_size))
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
        result_to_truth=boundary_score(segments(a.boundary, area), segments(b.boundary), cutoff, step),
        truth_to_result=boundary_score(segments(b.boundary, area), segments(a.boundary), cutoff, step),
        overlap=overlap,
        cutoff=cutoff,
        step=step,
        dissolved=dissolve,
        repaired_result=a.repaired,
        repaired_truth=b.repaired,
    )


def evaluate_areas(
    result: str | os.PathLike[str] | VectorLayer,
    truth: str | os.PathLike[str] | VectorLayer,
    area_path: str | os.PathLike[str] | VectorLayer | None = None,
    *,
    overlap: float = 0.5,
    minimum_area: float = 50.0,
    cutoff: float = 3.0,
    step: float = 0.5,
    dissolve: bool = False,
) -> AreaScore:
    """Score a file of extracted polygons, or the objects of a run's folder, against a file of true polygons.

    Coordinates are turned into metres by the CRS's own unit. The truth must be in the CRS of the result, as a
    reprojection would move areas and boundaries; `area_path`, a file of polygons to which both are clipped, by default
    the extent of the data of the result's run, is reprojected. `result` and `truth` may also be layers already read.
    Parameters and units as in `evaluate_polygons`: metres and square metres.

    Raises
    ------
    InputError
        A file is missing or unreadable, holds no polygons, or names no CRS; a CRS is geographic; the two CRS
        differ; the truth is empty; a layer to dissolve is a partition.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.evaluate.polygons import evaluate_areas
    >>> from tilepipe.io.vectors.formats import write_table
    >>> houses = shapely.box([0, 30, 60], 0, [10, 40, 70], 10)
    >>> truth = write_table("truth.parquet", {}, houses, "EPSG:32633")
    >>> found = write_table("found.parquet", {}, houses[1:], "EPSG:32633")
    >>> score = evaluate_areas(found, truth)
    >>> round(score.objects.completeness, 2), score.objects.correctness
    (0.67, 1.0)
    """
    extracted, true = read_result(result).of(POLYGONS), read_layer(truth, "truth").of(POLYGONS)
    # one length of a unit for both, but each must have one
    metres, _ = extracted.metres_per_unit, true.metres_per_unit
    a, b = (in_metres(layer.table.geometry.to_numpy(), metres) for layer in (extracted, true))
    crs, other = extracted.table.crs, true.table.crs
    if not _same_plane(crs, other):
        raise InputError(
            f"the {extracted.name} is in {crs.name} and the {true.name} in {other.name}; "
            "reproject one to the CRS of the other"
        )
    within = scored_area(result, area_path)
    area = None if within is None else area_in_metres(within, crs, metres)
    score = evaluate_polygons(
        a,
        b,
        overlap=overlap,
        minimum_area=minimum_area,
        cutoff=cutoff,
        step=step,
        area=area,
        dissolve=dissolve,
    )
    return replace(score, area=None if within is None else within.name)


def _same_plane(a: Any, b: Any) -> bool:
    """Whether two CRS agree, heights aside; files of one CRS may spell its names in different ways."""
    return agreed_crs(split_crs(a)[0], split_crs(b)[0]) is not None


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
