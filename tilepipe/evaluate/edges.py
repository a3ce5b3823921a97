"""Score edge lines against true edges: precision and recall by length, within a tolerance.

A truth of polygons, such as building footprints or road surface, contributes its boundaries, a truth of lines its
lines.  Where the truth is road surface, the candidates for borders of streets are scored against its boundaries too,
and their widths against the road's.

Beside precision and recall stands what the same lines score by chance (`tilepipe.evaluate.chance`): where edges are
dense, any truth lies near some of them.

Lengths are exact, not sampled (`tilepipe.evaluate.segment_matching`); widths are sampled.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError
from tilepipe.evaluate.chance import by_chance
from tilepipe.evaluate.extent import area_in_metres, scored_area
from tilepipe.evaluate.lines import defined_values, evaluate_lines, percent
from tilepipe.evaluate.results import read_result
from tilepipe.evaluate.street_borders import StreetBorderScore, metres, share_row, street_border_score, street_rows
from tilepipe.io.vectors.tables import LINES, POLYGONS, VectorLayer, in_metres, read_layer

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Geometries = NDArray[np.object_]
Float = NDArray[np.float64]

TOLERANCE = 1.0
"""Farthest match of an edge in metres, unless told otherwise."""

_TABLE = {"contrast", "straightness", "sinuosity"}
"""Columns that both tables of `edges` have, and no other."""


@dataclass(frozen=True)
class EdgeScore:
    """How well edge lines (`result`) agree with true edges (`truth`); lengths in metres.

    Attributes
    ----------
    precision
        Length of the result within the tolerance of the truth / length of the result; NaN when the result is empty.
        Low where the truth holds only some of the edges of the image, such as those of buildings.
    recall
        Length of the truth within the tolerance of the result / length of the truth.
    precision_by_chance, recall_by_chance
        The same with the truth moved aside, mean over four moves of 8 to 14 times the tolerance, in different
        directions: what these lines score where they cannot be right.  Precision and recall say something by as much
        as they exceed it.  NaN where precision is, or where no moved truth lies in the area.
    f_score
        Harmonic mean of precision and recall.
    rms_distance
        Root mean square distance from the matched part of the result to the truth; NaN when nothing matched.
    street_borders
        Score of the candidates for borders of streets, if asked for.
    area
        What both were clipped to, if anything.
    """

    precision: float
    recall: float
    precision_by_chance: float
    recall_by_chance: float
    f_score: float
    rms_distance: float
    result_length: float
    truth_length: float
    tolerance: float
    direction_tolerance: float | None = None
    street_borders: StreetBorderScore | None = None
    area: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON, where NaN (undefined) becomes None."""
        return defined_values(self)

    def summary(self) -> str:
        """Return a table of plain text."""
        match = f"edges within {self.tolerance:g} m"
        if self.direction_tolerance is not None:
            match += f" and {self.direction_tolerance:g} degrees"
        rows = [
            ("match", match),
            *([("inside", self.area)] if self.area else []),
            share_row("precision", self.precision, f"{self.result_length:,.0f} m of result", self.precision_by_chance),
            share_row("recall", self.recall, f"{self.truth_length:,.0f} m of truth", self.recall_by_chance),
            ("F-score", percent(self.f_score)),
            ("RMS distance", metres(self.rms_distance)),
        ]
        if self.street_borders is not None:
            rows += street_rows(self.street_borders, self.truth_length)
        return "\n".join(f"{name:<16}{value}".rstrip() for name, value in rows)


def is_edges(layer: VectorLayer) -> bool:
    """Whether a layer is one of the tables that `edges` writes."""
    return set(layer.table.columns) >= _TABLE


def true_edges(truth: ArrayLike, *, dissolve: bool = False) -> Geometries:
    """Lines of a truth: its lines as they are, and the boundaries of its polygons.

    Parameters
    ----------
    truth
        Shapely lines and polygons. Missing and empty geometries do not count, invalid polygons are repaired.
    dissolve
        Merge polygons that touch or overlap. Otherwise a boundary that two polygons share is an edge, and counts
        once.

    Examples
    --------
    Two houses that share a wall: it is an edge, unless what touches is merged.

    >>> import shapely
    >>> from tilepipe.evaluate.edges import true_edges
    >>> houses = [shapely.box(0, 0, 10, 10), shapely.box(10, 0, 20, 10)]
    >>> shapely.length(true_edges(houses)).sum().item(), shapely.length(true_edges(houses, dissolve=True)).sum().item()
    (70.0, 60.0)
    """
    import shapely

    rows: Geometries = np.atleast_1d(np.asarray(truth, dtype=object)).ravel()
    rows = rows[~(shapely.is_missing(rows) | shapely.is_empty(rows))]
    polygon = np.isin(shapely.get_type_id(rows), (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON))
    # a repair may leave a collection, with a multipolygon in it
    parts = shapely.get_parts(shapely.get_parts(shapely.make_valid(rows[polygon])))
    parts = parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON]
    if dissolve:
        parts = shapely.get_parts(shapely.union_all(parts))
    outlines = shapely.get_parts(shapely.union_all(shapely.boundary(parts)))
    return np.concatenate([rows[~polygon], outlines])


def evaluate_edge_lines(
    result: ArrayLike,
    truth: ArrayLike,
    *,
    tolerance: float = TOLERANCE,
    area: BaseGeometry | None = None,
    direction_tolerance: float | None = None,
    dissolve: bool = False,
) -> EdgeScore:
    """Score `result`, shapely lines, against the edges of `truth` in one plane; all lengths in metres.

    Parameters
    ----------
    result
        Lines.
    truth
        Lines and polygons; see `true_edges`, also for ``dissolve``.
    tolerance
        Largest distance of a match, inclusive; positive.
    area
        Polygon to which both are clipped; its own border is no edge.
    direction_tolerance
        Largest angle in degrees, 0 to 90, between two matching segments; None = any.

    Raises
    ------
    InputError
        A tolerance is out of range, or no truth lies in the area.

    Examples
    --------
    Two of the four walls of a house are found.

    >>> import shapely
    >>> import tilepipe
    >>> walls = shapely.linestrings([[[0, 0], [10, 0], [10, 10]]])
    >>> score = tilepipe.evaluate_edge_lines(walls, [shapely.box(0, 0, 10, 10)], tolerance=0.5)
    >>> round(score.precision, 2), round(score.recall, 2), round(score.recall_by_chance, 2)
    (1.0, 0.53, 0.02)
    """
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance is {tolerance}; give a positive distance in metres")
    edges = true_edges(truth, dissolve=dissolve)
    lines = evaluate_lines(result, edges, buffer=tolerance, area=area, direction_tolerance=direction_tolerance)
    chance = by_chance(result, edges, tolerance=tolerance, area=area, direction_tolerance=direction_tolerance)
    precision, recall = lines.correctness, lines.completeness
    both = precision + recall
    return EdgeScore(
        precision=precision,
        recall=recall,
        precision_by_chance=chance.precision,
        recall_by_chance=chance.recall,
        f_score=2 * precision * recall / both if both > 0 else 0.0,
        rms_distance=lines.rms_distance,
        result_length=lines.result_length,
        truth_length=lines.truth_length,
        tolerance=tolerance,
        direction_tolerance=direction_tolerance,
    )


def evaluate_edges(
    result: str | os.PathLike[str] | VectorLayer,
    truth: str | os.PathLike[str] | VectorLayer,
    tolerance: float = TOLERANCE,
    area_path: str | os.PathLike[str] | VectorLayer | None = None,
    *,
    direction_tolerance: float | None = None,
    dissolve: bool = False,
    road_surface: bool = False,
) -> EdgeScore:
    """Score a file of edge lines, or the edges of a run's folder, against a file of true lines or polygons.

    Truth and area are reprojected (vertex by vertex) to the CRS of the result; lengths are metres in any unit of it.

    Parameters
    ----------
    result
        A vector file, the folder of a finished ``edges`` run, or a layer already read.
    truth
        A vector file of lines or polygons, or a layer already read.
    tolerance
        Largest distance of a match in metres.
    area_path
        Vector file of polygons to which both are clipped; by default the extent of the data of the result's run.
    direction_tolerance, dissolve
        See `evaluate_edge_lines`; ``dissolve`` is for a truth with polygons.
    road_surface
        The truth is polygons of road surface: they are dissolved, and the candidates for borders of streets are
        scored against their boundaries too.

    Raises
    ------
    InputError
        A file is missing or unreadable, holds other geometries, or names no CRS; the result's CRS is geographic; the
        truth is empty or has no polygons to dissolve; road surface is no polygons, or the result holds no candidates
        for borders of streets.

    Examples
    --------
    >>> import shapely
    >>> from tilepipe.evaluate.edges import evaluate_edges
    >>> from tilepipe.io.vectors.formats import write_table
    >>> truth = write_table("houses.parquet", {}, [shapely.box(0, 0, 10, 10)], "EPSG:32633")
    >>> found = write_table("edges.parquet", {}, shapely.linestrings([[[0, 0.2], [10, 0.2]]]), "EPSG:32633")
    >>> evaluate_edges(found, truth, tolerance=0.5).precision
    1.0
    """
    extracted = read_result(result).of(LINES)
    metres, crs = extracted.metres_per_unit, extracted.table.crs
    true = read_layer(truth, "truth").of(POLYGONS if road_surface else LINES + POLYGONS)
    if dissolve and not true.types & set(POLYGONS):
        raise InputError(f"--dissolve is for polygons and the {true.name} holds none; leave it out")
    geometry = in_metres(true.reprojected(crs), metres)
    within = scored_area(result, area_path)
    area = None if within is None else area_in_metres(within, crs, metres)
    lines = extracted.in_metres()
    score = evaluate_edge_lines(
        lines,
        geometry,
        tolerance=tolerance,
        area=area,
        direction_tolerance=direction_tolerance,
        dissolve=dissolve or road_surface,
    )
    streets = None
    if road_surface:
        if "street_border" not in extracted.table:
            raise InputError(f"the {extracted.name} has no column street_border; give edges.parquet of a run")
        streets = street_border_score(
            extracted.table, lines, geometry, true_edges(geometry, dissolve=True), tolerance, area
        )
    return replace(score, street_borders=streets, area=None if within is None else within.name)
