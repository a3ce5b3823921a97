"""What the pictures of all pipelines share: frame, header, scale bar, and which part is worth a closer look."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

Bounds = tuple[float, float, float, float]
"""Left, bottom, right, top in CRS units."""

INK = "#1d2433"
NODATA_TINT, NODATA_HATCH = "#f3e6f5", "#b48cbc"
DPI = 100
MARGIN, HEADER, FOOTER = 40, 110, 80
"""Pixels around a map: left and right, above, below."""
_WIDEST, _FINEST = 2.4, 0.7
"""Points that sparse lines are wide, on large and on small scales; dense ones down to half of that."""
_MOST_INK = 0.12
"""Share of a map that lines may cover before they are drawn finer, and then lighter."""


def recorded_inputs(folder: Path, named: Sequence[str | os.PathLike[str]]) -> list[Path]:
    """Paths of a record, looked up from here and from the folder of the run."""
    return [path if path.exists() or path.is_absolute() else folder / path for path in map(Path, named)]


def busiest_window(lines: GeoDataFrame, bounds: Bounds, shape: tuple[int, int], side: int) -> Bounds | None:
    """The square of ``side`` pixels with most length of lines; None where the raster is hardly larger.

    Parameters
    ----------
    lines
        In the CRS of the raster.
    bounds, shape
        Of the raster.
    side
        Side of the square in pixels; a multiple of 8 keeps to the pixels.
    """
    import shapely

    rows, columns = shape
    pixel = (bounds[2] - bounds[0]) / columns
    if max(rows, columns) <= 1.2 * side:
        return None
    cell = max(side // 8, 1)
    counts = np.zeros((math.ceil(rows / cell), math.ceil(columns / cell)))
    # Points at even steps along the lines: their number is the length.
    dense = shapely.segmentize(lines.geometry.to_numpy(), cell * pixel / 4)
    points, line = shapely.get_coordinates(dense, return_index=True)
    same = line[1:] == line[:-1]
    middle, delta = (points[1:] + points[:-1])[same] / 2, (points[1:] - points[:-1])[same]
    row = np.clip(((bounds[3] - middle[:, 1]) / pixel / cell).astype(int), 0, counts.shape[0] - 1)
    column = np.clip(((middle[:, 0] - bounds[0]) / pixel / cell).astype(int), 0, counts.shape[1] - 1)
    np.add.at(counts, (row, column), np.hypot(delta[:, 0], delta[:, 1]))
    sums = np.pad(counts.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    high, wide = min(8, counts.shape[0]), min(8, counts.shape[1])
    window = sums[high:, wide:] - sums[:-high, wide:] - sums[high:, :-wide] + sums[:-high, :-wide]
    best_row, best_column = np.unravel_index(int(window.argmax()), window.shape)
    row0 = min(int(best_row) * cell, max(rows - side, 0))
    column0 = min(int(best_column) * cell, max(columns - side, 0))
    height, width = min(side, rows), min(side, columns)
    left, top = bounds[0] + column0 * pixel, bounds[3] - row0 * pixel
    return left, top - height * pixel, left + width * pixel, top


def write_header(figure: Figure, left: float, height: int, title: str, facts: str) -> None:
    """Write title and facts above a map that begins at ``left`` (figure fraction); ``height`` in pixels."""
    figure.text(left, 1 - 46 / height, title, fontsize=20, fontweight="bold", color=INK, va="center")
    figure.text(left, 1 - 82 / height, facts, fontsize=11.5, color="#57606f", va="center")


def draw_frame(axes: Axes, frame: Bounds) -> None:
    """Draw the dashed outline of a part of a map."""
    from matplotlib.patches import Rectangle

    corner, wide, high = frame[:2], frame[2] - frame[0], frame[3] - frame[1]
    axes.add_patch(Rectangle(corner, wide, high, fill=False, edgecolor="white", linewidth=2.6, zorder=5))
    axes.add_patch(
        Rectangle(corner, wide, high, fill=False, edgecolor=INK, linewidth=1.2, linestyle=(0, (5, 3)), zorder=6)
    )


def nodata_patch(bounds: Bounds = (0, 0, 1, 1), label: str = "") -> Rectangle:
    """The tint and hatching that stand for nodata, to lie below a picture that leaves nodata out, or in a legend."""
    from matplotlib.patches import Rectangle

    wide, high = bounds[2] - bounds[0], bounds[3] - bounds[1]
    return Rectangle(
        bounds[:2],
        wide,
        high,
        label=label,
        zorder=-1,
        facecolor=NODATA_TINT,
        edgecolor=NODATA_HATCH,
        hatch="////",
        linewidth=0,
    )


def pen(metres_per_pixel: float, density: float) -> tuple[float, float]:
    """Width in points and opacity of lines, which are finer on small scales and where they are dense.

    Parameters
    ----------
    metres_per_pixel
        Ground that a pixel of the picture shows.
    density
        Share of the map that the lines would cover were they one pixel of the picture wide; more than 0.
    """
    pixel = 72 / DPI
    width = max(_WIDEST - 2 * metres_per_pixel, _FINEST)
    width = min(width, max(_MOST_INK / density * pixel, width / 2))
    return width, min(max(_MOST_INK / (density * width / pixel), 0.3), 1.0)


def draw_swatches(figure: Figure, left: float, middle: float, colours: Sequence[str], text: str) -> None:
    """Draw a row of small boxes of these colours and a text behind it; ``left`` and ``middle`` as figure fractions."""
    from matplotlib.patches import Rectangle

    wide, high = figure.get_figwidth() * DPI, figure.get_figheight() * DPI
    side = min(22, 320 / len(colours))
    for place, colour in enumerate(colours):
        corner = (left + place * side / wide, middle - 7 / high)
        figure.add_artist(Rectangle(corner, side / wide, 14 / high, facecolor=colour, edgecolor=INK, linewidth=0.5))
    end = left + (len(colours) * side + 10) / wide
    figure.text(end, middle, text, fontsize=11.5, color=INK, va="center")


def draw_scale_bar(figure: Figure, right: float, map_width: float, bounds: Bounds, metres: float) -> None:
    """Draw a two-part bar of a round number of metres, ending at `right` (figure fraction)."""
    from matplotlib.patches import Rectangle

    ground = (bounds[2] - bounds[0]) * metres
    length = round_length(ground * min(0.2, 240 / DPI / figure.get_figwidth() / map_width))
    wide = map_width * length / ground
    height = figure.get_figheight() * DPI
    y, thick = (FOOTER / 2 - 12) / height, 7 / height
    for part, colour in ((0, INK), (1, "white")):
        corner = (right - wide + part * wide / 2, y)
        figure.add_artist(Rectangle(corner, wide / 2, thick, facecolor=colour, edgecolor=INK, linewidth=1))
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    for place, label in ((right - wide, "0"), (right, text)):
        figure.text(place, y + 15 / height, label, fontsize=11, color=INK, ha="center" if label == "0" else "right")


def round_length(longest: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is no more than `longest`."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= longest * (1 + 1e-12))
