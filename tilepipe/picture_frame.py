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

Bounds = tuple[float, float, float, float]
"""Left, bottom, right, top in CRS units."""

INK = "#1d2433"
DPI = 100
MARGIN, HEADER, FOOTER = 40, 110, 80
"""Pixels around a map: left and right, above, below."""


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
