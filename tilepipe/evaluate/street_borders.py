"""Score candidates for borders of streets against road surface: where they lie, and how wide the streets are.

Lengths are exact, not sampled (`tilepipe.evaluate.segment_matching`); widths are sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.evaluate.chance import by_chance
from tilepipe.evaluate.lines import evaluate_lines, percent
from tilepipe.evaluate.segment_matching import segments

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from shapely import STRtree
    from shapely.geometry.base import BaseGeometry

Geometries = NDArray[np.object_]
Float = NDArray[np.float64]

_STEP = 1.0
"""Distance of the points at which widths are compared (m)."""

_ASLANT = 1.2
"""Largest distance of the two borders at a point, as a multiple of the street's width; beyond, one has ended."""


@dataclass(frozen=True)
class StreetBorderScore:
    """How well candidates for borders of streets agree with the boundaries of road surface; lengths in metres.

    Attributes
    ----------
    precision
        Length of the candidates near the boundaries / length of the candidates; NaN where there are none.
    recall
        Length of the boundaries near candidates / length of the boundaries.
    precision_by_chance, recall_by_chance
        The same with the boundaries moved aside; see `EdgeScore`.
    count, length
        Of the candidates.
    width_bias, width_rms
        Mean and root mean square of the street's width less the road's, over the points of candidates where both
        borders lie on boundaries of the truth with road between them; NaN where there are none.
    width_length
        Length of candidates over which that holds.
    """

    precision: float
    recall: float
    precision_by_chance: float
    recall_by_chance: float
    count: int
    length: float
    width_bias: float
    width_rms: float
    width_length: float


def metres(value: float) -> str:
    """A distance for people."""
    return "undefined" if math.isnan(value) else f"{value:.2f} m"


def share_row(name: str, share: float, whole: str, by_chance: float) -> tuple[str, str]:
    """Name and text of a share, of what, and what chance gives."""
    return name, f"{percent(share)}  of {whole}, by chance {percent(by_chance)}"


def street_rows(score: StreetBorderScore, truth_length: float) -> list[tuple[str, str]]:
    """Names and texts of a score."""
    if score.width_length:
        width = f"RMS {metres(score.width_rms)}, mean {score.width_bias:+.2f} m  over {score.width_length:,.0f} m"
    else:
        width = "undefined, no two borders match"
    candidates = f"{score.length:,.0f} m of {score.count:,} candidates"
    return [
        ("street borders", ""),
        share_row("  precision", score.precision, candidates, score.precision_by_chance),
        share_row("  recall", score.recall, f"{truth_length:,.0f} m of truth", score.recall_by_chance),
        ("  width error", width),
    ]


def street_border_score(
    table: GeoDataFrame,
    lines: Geometries,
    surface: ArrayLike,
    boundary: Geometries,
    tolerance: float,
    area: BaseGeometry | None = None,
) -> StreetBorderScore:
    """Score the candidates for borders of streets against road surface.

    Parameters
    ----------
    table
        ``edges.parquet``.
    lines
        Its geometries in metres.
    surface
        Polygons of road surface in metres.
    boundary
        Lines around it, shared ones left out.
    tolerance
        Largest distance of a match in metres.
    area
        Polygon to which candidates and boundaries are clipped.
    """
    import shapely

    candidate = table["street_border"].to_numpy(bool)
    score = evaluate_lines(lines[candidate], boundary, buffer=tolerance, area=area)
    chance = by_chance(lines[candidate], boundary, tolerance=tolerance, area=area)
    number = {line: row for row, line in enumerate(table["line_id"])}
    partner = np.array([number.get(line, -1) for line in table["street_partner"]], np.int64)
    paired = np.flatnonzero(candidate & (partner >= 0))
    road = shapely.union_all(shapely.make_valid(np.asarray(surface, dtype=object)))
    error = width_errors(
        lines[paired], lines[partner[paired]], table["street_width_m"].to_numpy(float)[paired], road, tolerance, area
    )
    return StreetBorderScore(
        precision=score.correctness,
        recall=score.completeness,
        precision_by_chance=chance.precision,
        recall_by_chance=chance.recall,
        count=int(candidate.sum()),
        length=score.result_length,
        width_bias=float(error.mean()) if error.size else math.nan,
        width_rms=float(np.sqrt((error**2).mean())) if error.size else math.nan,
        width_length=_STEP * error.size,
    )


def width_errors(
    borders: Geometries,
    partners: Geometries,
    widths: Float,
    road: BaseGeometry,
    tolerance: float,
    area: BaseGeometry | None = None,
) -> Float:
    """Width of a street less that of the true road, at points 1 m apart along borders.

    Parameters
    ----------
    borders, partners
        Lines in pairs, the borders of one street.
    widths
        Of these streets.
    road
        True road surface, one valid geometry.
    tolerance
        Farthest that a border may lie from the road's boundary.
    area
        Only points in it count.

    Returns
    -------
    ndarray
        One value for each point where both borders are near the boundary and the middle of the two is road.
    """
    import shapely

    pieces = np.maximum(1, np.rint(shapely.length(borders) / _STEP).astype(np.int64))
    line = np.repeat(np.arange(len(borders)), pieces)
    place = (np.arange(line.size) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[line]
    points = shapely.line_interpolate_point(borders[line], place, normalized=True)
    if area is not None:
        inside = shapely.intersects(area, points)
        line, points = line[inside], points[inside]
    across = shapely.shortest_line(points, partners[line])
    beside = shapely.length(across) <= _ASLANT * widths[line]
    line, points, opposite = line[beside], points[beside], shapely.get_point(across[beside], 1)
    boundary = shapely.STRtree(shapely.linestrings(segments(shapely.boundary(road))))
    own, other = _nearest_on(boundary, points, tolerance), _nearest_on(boundary, opposite, tolerance)
    both = np.isfinite(own + other).all(axis=1)
    line, own, other = line[both], own[both], other[both]
    shapely.prepare(road)
    across_road = shapely.contains_xy(road, (own + other) / 2)
    error: Float = (widths[line] - np.hypot(*(own - other).T))[across_road]
    return error


def _nearest_on(lines: STRtree, points: Geometries, reach: float) -> Float:
    """Places (n, 2) on lines nearest to points; NaN where none is within reach."""
    import shapely

    near, line = lines.query_nearest(points, max_distance=reach, all_matches=False)
    places = np.full((len(points), 2), np.nan)
    nearest = shapely.shortest_line(points[near], lines.geometries[line])
    places[near] = shapely.get_coordinates(shapely.get_point(nearest, 1))
    return places
