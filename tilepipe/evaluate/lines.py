"""Score extracted lines against true ones by the buffer method of road extraction.

Heipke, Mayer, Wiedemann & Jamet (1997), Evaluation of automatic road extraction, IAPRS 32 (3-2W3), 151-160.

The simple buffer match is used: a point of one set is matched when some line of the other set lies within
the buffer distance of it. Optionally the two lines must also run in nearly the same direction there.
Lengths are exact, not sampled (`tilepipe.evaluate.segment_matching`).
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from tilepipe.errors import InputError
from tilepipe.evaluate.extent import area_in_metres, scored_area
from tilepipe.evaluate.results import read_result
from tilepipe.evaluate.segment_matching import close_pairs, covered_length, lengths, matched, rms_distance, segments
from tilepipe.io.vectors.tables import LINES, VectorLayer, in_metres, read_layer

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


def defined_values(score: Any) -> dict[str, Any]:
    """Values of a score, a dataclass, for JSON, where NaN (undefined) becomes None, in scores within it too.

    Examples
    --------
    >>> import shapely
    >>> import tilepipe
    >>> from tilepipe.evaluate.lines import defined_values
    >>> empty = tilepipe.evaluate_lines([], shapely.linestrings([[[0, 0], [9, 0]]]), buffer=1.0)
    >>> defined_values(empty)["correctness"] is None, defined_values(empty)["completeness"]
    (True, 0.0)
    """

    def defined(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: defined(inner) for name, inner in value.items()}
        return None if isinstance(value, float) and math.isnan(value) else value

    values: dict[str, Any] = defined(asdict(score))
    return values


def percent(value: float) -> str:
    """A share in words.

    Examples
    --------
    >>> from tilepipe.evaluate.lines import percent
    >>> percent(0.8734), percent(float("nan"))
    ('87.3 %', 'undefined')
    """
    return "undefined" if math.isnan(value) else f"{100 * value:.1f} %"


@dataclass(frozen=True)
class LineScore:
    """How well extracted lines (`result`) agree with true ones (`truth`); lengths in the coordinates' unit.

    Attributes
    ----------
    completeness
        Matched length of the truth / length of the truth.
    correctness
        Matched length of the result / length of the result; NaN when the result is empty.
    quality
        TP / (TP + FP + FN), with TP the matched and FP the unmatched length of the result, FN the unmatched
        length of the truth.
    redundancy
        (matched length of the result - matched length of the truth) / length of the result; 0 is best, NaN
        when the result is empty.
    rms_distance
        Root mean square distance from the matched part of the result to the truth; NaN when nothing matched.
    area
        What both were clipped to, if anything.
    """

    completeness: float
    correctness: float
    quality: float
    redundancy: float
    rms_distance: float
    result_length: float
    truth_length: float
    matched_result_length: float
    matched_truth_length: float
    buffer: float
    direction_tolerance: float | None = None
    area: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON, where NaN (undefined) becomes None."""
        return defined_values(self)

    def summary(self) -> str:
        """Return a table of plain text; lengths are taken as metres."""
        rms = "undefined" if math.isnan(self.rms_distance) else f"{self.rms_distance:.2f} m"
        match = f"within {self.buffer:g} m"
        if self.direction_tolerance is not None:
            match += f" and {self.direction_tolerance:g} degrees"
        rows = [
            ("match", match),
            *([("inside", self.area)] if self.area else []),
            ("completeness", f"{percent(self.completeness)}  of {self.truth_length:,.0f} m of truth"),
            ("correctness", f"{percent(self.correctness)}  of {self.result_length:,.0f} m of result"),
            ("quality", percent(self.quality)),
            ("redundancy", percent(self.redundancy)),
            ("RMS distance", rms),
        ]
        return "\n".join(f"{name:<13}{value}" for name, value in rows)


def evaluate_lines(
    result: ArrayLike,
    truth: ArrayLike,
    *,
    buffer: float,
    area: BaseGeometry | None = None,
    direction_tolerance: float | None = None,
) -> LineScore:
    """Score `result` against `truth` in one plane; all lengths are in the unit of the coordinates.

    Parameters
    ----------
    result, truth
        Shapely LineStrings or MultiLineStrings. Missing and empty geometries and zero-length parts do not
        count. Lines that lie upon each other count as often as they are there (hence redundancy).
    buffer
        Largest distance of a match, inclusive; positive.
    area
        Polygon to which both sets are clipped before they are compared.
    direction_tolerance
        Largest angle in degrees, 0 to 90, between two matching segments (undirected). None, the default, is
        the simple buffer method, which also matches a line where it crosses the other set. Set 30 for
        smooth lines; not meant for lines that follow the pixels' stairs.

    Notes
    -----
    Lengths are exact up to rounding. The RMS distance is integrated by the two-point Gauss rule on pieces
    no longer than half the buffer: exact while one segment of the truth stays the nearest.

    Raises
    ------
    InputError
        The buffer or tolerance is out of range, or no truth lies in the area.

    Examples
    --------
    A street of 100 m, of which the result has found 60 m, half a metre beside it, and 20 m where there is no street.

    >>> import shapely
    >>> import tilepipe
    >>> truth = shapely.linestrings([[[0, 0], [100, 0]]])
    >>> result = shapely.linestrings([[[0, 0.5], [60, 0.5]], [[0, 50], [20, 50]]])
    >>> score = tilepipe.evaluate_lines(result, truth, buffer=3.0, direction_tolerance=30)
    >>> round(score.completeness, 2), round(score.correctness, 2), round(score.rms_distance, 2)
    (0.63, 0.75, 0.5)
    """
    if not (buffer > 0 and math.isfinite(buffer)):
        raise InputError(f"buffer is {buffer}; give a positive distance")
    if direction_tolerance is not None and not 0 <= direction_tolerance <= 90:
        raise InputError(f"direction tolerance is {direction_tolerance}; give 0 to 90 degrees")
    a, b = segments(result, area), segments(truth, area)
    truth_length = float(lengths(b).sum())
    if truth_length == 0:
        where = "" if area is None else " inside the area (that given, or the extent of the run's data)"
        raise InputError(f"the truth has no lines{where}; give lines to compare with")
    result_length = float(lengths(a).sum())
    pairs = close_pairs(a, b, buffer, direction_tolerance)
    matched_a = matched(a, b, pairs, buffer)
    matched_b = matched(b, a, pairs[::-1], buffer)
    matched_result, matched_truth = covered_length(matched_a, a), covered_length(matched_b, b)
    nan = math.nan
    return LineScore(
        completeness=matched_truth / truth_length,
        correctness=matched_result / result_length if result_length else nan,
        quality=matched_result / (result_length + truth_length - matched_truth) if result_length else 0.0,
        redundancy=(matched_result - matched_truth) / result_length if result_length else nan,
        rms_distance=rms_distance(a, b, pairs, matched_a, buffer) if matched_result else nan,
        result_length=result_length,
        truth_length=truth_length,
        matched_result_length=matched_result,
        matched_truth_length=matched_truth,
        buffer=buffer,
        direction_tolerance=direction_tolerance,
    )


def evaluate(
    result: str | os.PathLike[str] | VectorLayer,
    truth: str | os.PathLike[str] | VectorLayer,
    buffer_m: float,
    area_path: str | os.PathLike[str] | VectorLayer | None = None,
    *,
    direction_tolerance: float | None = None,
) -> LineScore:
    """Score a file of extracted lines, or the centerlines of a run's folder, against a file of true lines.

    Truth and area are reprojected (vertex by vertex) to the CRS of the result, and coordinates are then
    turned into metres by the CRS's own unit, so `buffer_m` and all lengths of the score are metres also in
    a CRS in feet.

    Parameters
    ----------
    result
        A vector file (GeoParquet or anything GDAL reads), the folder of a finished ``streets`` run, or a layer
        already read.
    truth
        A vector file of lines, or a layer already read.
    buffer_m
        Largest distance of a match in metres.
    area_path
        Vector file of polygons; both sets are clipped to their union, by default to the extent of the data of the
        result's run.
    direction_tolerance
        See `evaluate_lines`.

    Raises
    ------
    InputError
        A file is missing or unreadable, holds no lines (area: polygons), or names no CRS; the result's CRS is
        geographic; the truth is empty.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.evaluate.lines import evaluate
    >>> from tilepipe.io.vectors.formats import write_table
    >>> lines = shapely.linestrings([[[0, 0], [100, 0]], [[0, 40], [100, 40]]])
    >>> truth = write_table("truth.parquet", {}, lines, "EPSG:32633")
    >>> found = write_table("found.parquet", {}, lines[:1], "EPSG:32633")
    >>> evaluate(found, truth, buffer_m=3.0).completeness
    0.5
    """
    extracted, true = read_result(result).of(LINES), read_layer(truth, "truth").of(LINES)
    metres = extracted.metres_per_unit
    within = scored_area(result, area_path)
    area = None if within is None else area_in_metres(within, extracted.table.crs, metres)
    score = evaluate_lines(
        extracted.in_metres(),
        in_metres(true.reprojected(extracted.table.crs), metres),
        buffer=buffer_m,
        area=area,
        direction_tolerance=direction_tolerance,
    )
    return replace(score, area=None if within is None else within.name)
