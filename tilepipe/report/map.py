"""One map of a picture: what can be drawn on it, and what its legend then has to explain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from tilepipe.report.finished_run import Bounds, FinishedRun, percentiles
from tilepipe.report.vectors import coordinates, longest

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes

INK = "#1d2433"
NODATA_TINT, NODATA_HATCH = "#f3e6f5", "#b48cbc"
DPI = 100
_TINT = 0.43
"""Opacity of tints."""
MOST_LINES = 100_000
_WIDEST, _FINEST = 2.4, 0.7
"""Points that sparse lines are wide, on large and on small scales; dense ones down to half of that."""
_MOST_INK = 0.12
"""Share of a map that lines may cover before they are drawn finer, and then lighter."""


class Map:
    """A map of a part of a run.

    Attributes
    ----------
    shape
        Rows and columns that rasters are read at: those of the picture, or of the raster where it has fewer.
    legend, last
        Entries of what is drawn, in this order, and those that follow them.
    swatches
        Rows of colours with their meaning, for the legend.
    bars
        Colour scales, their labels and opacities.
    """

    def __init__(self, axes: Axes, run: FinishedRun, bounds: Bounds, pixels: tuple[int, int]) -> None:
        self.axes, self.run, self.bounds = axes, run, bounds
        self.pixel = (bounds[2] - bounds[0]) / pixels[1]
        rows, columns = run.size(bounds)
        self.shape = min(rows, pixels[0]), min(columns, pixels[1])
        self.legend: list[Artist] = []
        self.last: list[Artist] = []
        self.swatches: list[tuple[Sequence[str], str]] = []
        self.bars: list[tuple[ScalarMappable, str, float]] = []
        axes.set(xlim=(bounds[0], bounds[2]), ylim=(bounds[1], bounds[3]), xticks=[], yticks=[], autoscale_on=False)
        for spine in axes.spines.values():
            spine.set(color=INK, linewidth=0.8)

    @property
    def metres_per_pixel(self) -> float:
        """Ground that a pixel of the picture shows."""
        return self.pixel * self.run.metres

    def image(self, pixels: NDArray[np.uint8], **style: Any) -> None:
        """Draw red, green, blue and opacity (rows, columns, 4) over the whole map; style of matplotlib's ``imshow``."""
        extent = (self.bounds[0], self.bounds[2], self.bounds[1], self.bounds[3])
        self.axes.imshow(pixels, extent=extent, aspect="auto", **style)

    def grey(self, values: NDArray[np.uint8]) -> None:
        """Draw a grey picture, uint8, hatched where it is masked."""
        grey, opacity = np.ma.getdata(values), np.where(np.ma.getmaskarray(values), np.uint8(0), np.uint8(255))
        self.image(np.dstack([grey, grey, grey, opacity]))
        if np.ma.is_masked(values):
            self.axes.add_patch(nodata_patch(self.bounds))
            self.last.append(nodata_patch(label="nodata"))

    def scale(
        self,
        values: NDArray[np.float64],
        colours: str,
        label: str,
        limits: tuple[float, float] | None = None,
        opacity: float = 1.0,
    ) -> None:
        """Draw numbers by a colour scale, NaN left out; without limits from the 2nd to the 98th percentile."""
        limits = limits or percentiles(values)
        self.image(coloured(values, colours, limits, opacity), interpolation="nearest")
        self.bars.append((ScalarMappable(Normalize(*limits), colours), label, opacity))

    def tint(self, mask: NDArray[np.bool_], colour: str, label: str) -> None:
        """Tint where a mask (rows, columns) is true."""
        self.image(tinted(mask, colour), interpolation="nearest")
        self.legend.append(Patch(facecolor=colour, alpha=0.5, label=label))

    def lines(
        self,
        table: GeoDataFrame,
        colour: str,
        label: str,
        *,
        width: float | None = None,
        wider: float = 1.0,
        halo: bool = False,
    ) -> None:
        """Draw lines, or outlines of polygons, and enter them into the legend if there are any.

        Parameters
        ----------
        table
            Of too many inside the map, the longest are drawn.
        width
            In points; by default as wide as scale and density of the lines allow, and lighter where they are dense.
        wider
            Factor of that width.
        halo
            Draw a white rim.
        """
        inside = table.cx[self.bounds[0] : self.bounds[2], self.bounds[1] : self.bounds[3]]
        if len(inside) == 0:
            return
        if len(inside) > MOST_LINES:
            inside, label = longest(inside, MOST_LINES), f"{label} (the {MOST_LINES:,} longest)"
        opacity = 1.0
        if width is None:
            area = (self.bounds[2] - self.bounds[0]) * (self.bounds[3] - self.bounds[1])
            width, opacity = pen(self.metres_per_pixel, float(inside.length.sum()) * self.pixel / area)
            width *= wider
        parts = coordinates(inside.geometry.to_numpy())
        if halo:
            self._add(parts, colors="white", linewidths=width + 1.6, alpha=0.75)
        self._add(parts, colors=colour, linewidths=width, alpha=opacity)
        self.legend.append(Line2D([], [], color=colour, linewidth=3, label=label))

    def scaled_lines(
        self, table: GeoDataFrame, column: str, colours: Any, label: str, limits: tuple[float, float], widths: Any
    ) -> None:
        """Draw single lines by a colour scale of one of their columns, in their order."""
        drawn = self._add(coordinates(table.geometry.to_numpy()), cmap=colours, linewidths=widths)
        drawn.set_array(table[column].to_numpy())
        drawn.set_clim(*limits)
        self.bars.append((drawn, label, 1.0))

    def points(self, places: NDArray[np.float64], colour: str, label: str, side: float) -> None:
        """Draw points (n, 2) as dots of a side in points."""
        self.axes.scatter(places[:, 0], places[:, 1], s=side**2, c=colour, edgecolors=INK, linewidths=0.9, zorder=4)
        style: dict[str, Any] = {"marker": "o", "markersize": 7, "markeredgecolor": INK, "linestyle": "none"}
        self.legend.append(Line2D([], [], markerfacecolor=colour, label=label, **style))

    def mark(self, part: Bounds | None, label: str = "detail picture") -> None:
        """Draw the dashed outline of a part, if there is one."""
        if part is None:
            return
        corner, wide, high = part[:2], part[2] - part[0], part[3] - part[1]
        for colour, width, dashes, above in (("white", 2.6, "solid", 5), (INK, 1.2, (0, (5, 3)), 6)):
            outline = Rectangle(corner, wide, high, fill=False, edgecolor=colour, linewidth=width, linestyle=dashes)
            self.axes.add_patch(outline).set_zorder(above)
        self.legend.append(Line2D([], [], color=INK, linewidth=1.4, linestyle=(0, (4, 2)), label=label))

    def say(self, text: str) -> None:
        """Write into the middle of the map."""
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "boxstyle": "round,pad=0.5"}
        place: dict[str, Any] = {"transform": self.axes.transAxes, "ha": "center", "va": "center"}
        self.axes.text(0.5, 0.5, text, fontsize=13, color=INK, bbox=box, **place)

    def _add(self, parts: list[NDArray[np.float64]], **style: Any) -> LineCollection:
        drawn = LineCollection(parts, capstyle="round", **style)
        self.axes.add_collection(drawn, autolim=False)
        return drawn


def tinted(mask: NDArray[np.bool_], colour: str) -> NDArray[np.uint8]:
    """Red, green, blue and opacity (rows, columns, 4) of a mask: a tint where it is true.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe.report.map import tinted
    >>> tinted(np.array([[False, True]]), "#00a6d6").tolist()
    [[[0, 0, 0, 0], [0, 166, 214, 110]]]
    """
    tint = np.array(to_rgba(colour, _TINT)) * 255
    return np.where(mask[..., None], tint.round().astype(np.uint8), np.uint8(0))


def coloured(
    values: NDArray[np.float64], colours: str, limits: tuple[float, float] | None = None, opacity: float = 1.0
) -> NDArray[np.uint8]:
    """Red, green, blue and opacity (rows, columns, 4) of numbers by a colour scale; NaN is transparent.

    Without limits the scale goes from the 2nd to the 98th percentile.
    """
    stretched = Normalize(*(limits or percentiles(values)))(values.astype(np.float32))
    pixels: NDArray[np.uint8] = colormaps[colours](stretched, opacity, bytes=True)
    return pixels


def nodata_patch(bounds: Bounds = (0, 0, 1, 1), label: str = "") -> Rectangle:
    """The tint and hatching that stand for nodata, to lie below a picture that leaves nodata out, or in a legend."""
    style: dict[str, Any] = {"facecolor": NODATA_TINT, "edgecolor": NODATA_HATCH, "hatch": "////", "linewidth": 0}
    return Rectangle(bounds[:2], bounds[2] - bounds[0], bounds[3] - bounds[1], label=label, zorder=-1, **style)


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
