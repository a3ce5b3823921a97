"""Score extracted lines against true ones by the buffer method of road extraction.

Heipke, Mayer, Wiedemann & Jamet (1997), Evaluation of automatic road extraction, IAPRS 32 (3-2W3), 151-160.

The simple buffer match is used: a point of one set is matched when some line of the other set lies within
the buffer distance of it. Optionally the two lines must also run in nearly the same direction there.
Lengths are exact, not sampled (`tilepipe.matching`).
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe.errors import InputError
from tilepipe.matching import close_pairs, covered_length, lengths, matched, rms_distance, segments

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from shapely.geometry.base import BaseGeometry


LINES = ("LineString", "MultiLineString")
POLYGONS = ("Polygon", "MultiPolygon")


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

    def as_dict(self) -> dict[str, float | None]:
        """Values for JSON, where NaN (undefined) becomes None."""
        return {name: None if value is None or math.isnan(value) else value for name, value in asdict(self).items()}

    def summary(self) -> str:
        """Return a table of plain text; lengths are taken as metres."""

        def percent(value: float) -> str:
            return "undefined" if math.isnan(value) else f"{100 * value:.1f} %"

        rms = "undefined" if math.isnan(self.rms_distance) else f"{self.rms_distance:.2f} m"
        match = f"within {self.buffer:g} m"
        if self.direction_tolerance is not None:
            match += f" and {self.direction_tolerance:g} degrees"
        rows = [
            ("match", match),
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
    """
    if not (buffer > 0 and math.isfinite(buffer)):
        raise InputError(f"buffer is {buffer}; give a positive distance")
    if direction_tolerance is not None and not 0 <= direction_tolerance <= 90:
        raise InputError(f"direction tolerance is {direction_tolerance}; give 0 to 90 degrees")
    a, b = segments(result, area), segments(truth, area)
    truth_length = float(lengths(b).sum())
    if truth_length == 0:
        where = "" if area is None else " inside the area"
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
    result_path: str | os.PathLike[str],
    truth_path: str | os.PathLike[str],
    buffer_m: float,
    area_path: str | os.PathLike[str] | None = None,
    *,
    direction_tolerance: float | None = None,
) -> LineScore:
    """Score a file of extracted lines, or the centerlines of a run's folder, against a file of true lines.

    Truth and area are reprojected (vertex by vertex) to the CRS of the result, and coordinates are then
    turned into metres by the CRS's own unit, so `buffer_m` and all lengths of the score are metres also in
    a CRS in feet.

    Parameters
    ----------
    result_path
        A vector file (GeoParquet or anything GDAL reads), or the folder of a finished ``streets`` run.
    truth_path
        A vector file of lines.
    buffer_m
        Largest distance of a match in metres.
    area_path
        Vector file of polygons; both sets are clipped to their union.
    direction_tolerance
        See `evaluate_lines`.

    Raises
    ------
    InputError
        A file is missing or unreadable, holds no lines (area: polygons), or names no CRS; the result's CRS is
        geographic; the truth is empty.
    """
    result = read_vectors(result_file(Path(result_path)), "result")
    metres = metres_per_unit(result.crs, str(result_path))
    truth = read_vectors(Path(truth_path), "truth").to_crs(result.crs)
    area = None if area_path is None else read_area(Path(area_path), result.crs, metres)
    return evaluate_lines(
        in_metres(result.geometry.to_numpy(), metres),
        in_metres(truth.geometry.to_numpy(), metres),
        buffer=buffer_m,
        area=area,
        direction_tolerance=direction_tolerance,
    )


def read_area(path: Path, crs: Any, metres: float) -> Any:
    """Union of a file's polygons in metres, reprojected to ``crs``, whose unit has so many metres."""
    import shapely

    polygons = read_vectors(path, "area", POLYGONS).to_crs(crs)
    return shapely.union_all(in_metres(shapely.make_valid(polygons.geometry.to_numpy()), metres))


def metres_per_unit(crs: Any, name: str) -> float:
    """Length in metres of the unit of a projected CRS; `name` is what an error message calls its owner.

    Raises
    ------
    InputError
        There is no CRS, or it is geographic (degrees are no lengths).
    """
    from pyproj import CRS

    if crs is None:
        raise InputError(f"{name} names no CRS, so metres are unknown; write the CRS into the file")
    crs = CRS.from_user_input(crs)
    if crs.is_geographic:
        raise InputError(
            f"{name} is in longitude and latitude ({crs.name}), where a buffer in metres has no meaning; "
            "give a projected file, such as the GeoParquet of the run"
        )
    return float(crs.axis_info[0].unit_conversion_factor) if crs.axis_info else 1.0


def run_table(folder: Path, name: str) -> Path | None:
    """Find the table `name` in a run's folder, in whatever format it was written, or None."""
    from tilepipe.export import SUFFIX

    for suffix in SUFFIX.values():
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    return None


def result_file(path: Path) -> Path:
    """Return the file itself, or the centerlines, else the objects, of a run's folder.

    Raises
    ------
    InputError
        The folder holds neither.
    """
    if not path.is_dir():
        return path
    table = run_table(path, "centerlines") or run_table(path, "objects")
    if table is None:
        raise InputError(
            f"{path} holds no centerlines.parquet and no objects.parquet; give the folder of a finished run"
        )
    return table


def both_polygons(result_path: str | os.PathLike[str], truth_path: str | os.PathLike[str]) -> bool:
    """Whether two layers are to be scored as polygons, not as lines; an empty layer may be either.

    Raises
    ------
    InputError
        A file is missing or unreadable, or names no CRS; one layer holds polygons and the other does not.
    """
    result = read_vectors(result_file(Path(result_path)), "result", LINES + POLYGONS)
    truth = read_vectors(Path(truth_path), "truth", LINES + POLYGONS)
    kinds = [set(table.geom_type.dropna()) for table in (result, truth)]
    found = kinds[0] | kinds[1]
    if found & set(LINES) and found & set(POLYGONS):
        both = " and ".join(", ".join(sorted(kind)) for kind in kinds)
        raise InputError(f"result and truth hold {both}; give two layers of lines, or two of polygons")
    return bool(found & set(POLYGONS))


def read_vectors(path: Path, role: str, types: tuple[str, ...] = LINES) -> GeoDataFrame:
    """Read a vector file (GeoParquet or anything GDAL reads); `role` is what messages call it.

    Raises
    ------
    InputError
        The file is missing or unreadable, names no CRS, or holds geometries of other types.
    """
    import geopandas

    if not path.is_file():
        raise InputError(f"the {role} {path} does not exist; correct the path")
    try:
        table = geopandas.read_parquet(path) if path.suffix == ".parquet" else geopandas.read_file(path)
    except Exception as error:
        raise InputError(f"the {role} {path} cannot be read as a vector file: {error}") from error
    found = set(table.geom_type.dropna()) if isinstance(table, geopandas.GeoDataFrame) else {"no geometry"}
    if not found <= set(types):
        raise InputError(f"the {role} {path} holds {', '.join(sorted(found))}; give {' or '.join(types)}")
    if table.crs is None:
        raise InputError(f"the {role} {path} names no CRS; write it into the file")
    return table


def in_metres(geometry: NDArray[np.object_], metres: float) -> NDArray[np.object_]:
    """Geometries without heights, their coordinates multiplied by the length of the unit in metres."""
    import shapely

    scaled: NDArray[np.object_] = shapely.transform(shapely.force_2d(geometry), lambda points: points * metres)
    return scaled
