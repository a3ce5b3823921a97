"""Pictures of an ``objects`` run: regions by their height, borders and buildings by their probability."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.atomic import atomic_write
from tilepipe.report.frame import DPI, FOOTER, HEADER, INK, MARGIN, Bounds, draw_scale_bar, write_header

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LONGEST_SIDE = 1500
_BAR, _LONGEST_BAR = 110, 500
_DETAIL_PIXELS = 400
_MOST_BORDERS = 60_000
HEIGHT_COLOURS, BUILDING_COLOURS = "viridis", "YlGnBu"
BORDER_COLOURS = (INK, "#e0007a", "#ff9ecb")
"""From borders that are certain to those that might as well not be."""

OUTLINE_COLOUR = "#d1495b"

Overlay = Callable[["Axes"], tuple[Any, str] | None]
"""Draws on a map; gives what its colour bar shows and the label of the bar."""


@dataclass(frozen=True)
class _Shading:
    """Colours of the regions: value of each region id, colour map, limits, label of the bar."""

    of_region: NDArray[np.float64]
    colours: str
    label: str
    limits: tuple[float, float] | None = None
    opacity: float = 1.0


@dataclass(frozen=True)
class _Regions:
    """The raster of the regions and how it lies."""

    raster: Path
    bounds: Bounds
    pixel: float
    metres: float
    crs: Any

    def size(self, bounds: Bounds) -> tuple[int, int]:
        """Rows and columns of a part of the raster."""
        return round((bounds[3] - bounds[1]) / self.pixel), round((bounds[2] - bounds[0]) / self.pixel)

    def facts(self, first: str, bounds: Bounds) -> str:
        """The line below the title of a picture."""
        rows, columns = self.size(bounds)
        size = f"{columns:,} × {rows:,} pixels of {self.pixel * self.metres:.2f} m"
        return f"{first}   |   {size}   |   {self.crs.name}"


def object_pictures(run_dir: str | os.PathLike[str]) -> list[Path]:
    """Draw a finished ``objects`` run as ``quicklook.png`` and ``quicklook_detail.png`` into its folder.

    The first shows the whole raster, the second a part at full resolution with the borders.  Where buildings were
    asked for, ``quicklook_buildings.png`` shows the probability that each region is one.

    Raises
    ------
    InputError
        The folder is not that of a finished run.
    """
    from tilepipe.io.tables import POLYGONS, read_vectors, run_table

    folder = Path(run_dir)
    objects, borders = run_table(folder, "objects"), run_table(folder, "boundaries")
    raster = folder / "regions.tif"
    if objects is None or borders is None or not raster.is_file():
        raise InputError(f"{folder} holds no regions.tif with objects; give the folder of a finished objects run")
    regions = _open_regions(raster)
    name = folder.resolve().name
    table = read_vectors(objects, "result", POLYGONS).to_crs(regions.crs)
    lines = read_vectors(borders, "result").to_crs(regions.crs)
    heights = _by_region(table, "posterior_mean")
    whole, window = regions.bounds, _amid_borders(regions.bounds, regions.pixel, lines)
    shading = _Shading(heights, HEIGHT_COLOURS, "height of the region (m)")
    pictures = [folder / "quicklook.png", folder / "quicklook_detail.png"]
    _draw(pictures[0], regions, shading, whole, f"Objects: {name}", f"{len(table):,} regions")
    lines = _inside(lines, window)
    pale = _Shading(heights, HEIGHT_COLOURS, "height of the region (m)", opacity=0.6)
    facts = f"{len(lines):,} borders of two regions"
    _draw(pictures[1], regions, pale, window, f"Objects: {name}, detail", facts, _borders(lines), enlarged=True)
    if (buildings := run_table(folder, "buildings")) is not None:
        found = read_vectors(buildings, "result", POLYGONS).to_crs(regions.crs)
        chances = _by_region(table, "building_probability")
        shading = _Shading(chances, BUILDING_COLOURS, "probability of a building", (0.0, 1.0))
        facts = f"{len(found):,} buildings or blocks of {found['area_m2'].sum():,.0f} m²"
        pictures.append(folder / "quicklook_buildings.png")
        _draw(pictures[2], regions, shading, whole, f"Buildings: {name}", facts, _outlines(found))
    return pictures


def _open_regions(raster: Path) -> _Regions:
    import rasterio
    from pyproj import CRS

    from tilepipe.io.tables import metres_per_unit

    with rasterio.open(raster) as file:
        bounds: Bounds = tuple(file.bounds)
        pixel, crs = file.res[0], file.crs
    return _Regions(raster, bounds, pixel, metres_per_unit(crs, str(raster)), CRS.from_user_input(crs))


def _by_region(table: GeoDataFrame, column: str) -> NDArray[np.float64]:
    """A column of the objects by region id, NaN where there is none."""
    values = np.full(int(table["region_id"].max()) + 1, np.nan)
    values[table["region_id"].to_numpy()] = table[column].to_numpy(dtype=np.float64)
    return values


def _amid_borders(bounds: Bounds, pixel: float, borders: GeoDataFrame) -> Bounds:
    """At most `_DETAIL_PIXELS` a side around the median of the borders."""
    boxes = borders.geometry.bounds.to_numpy()
    window = []
    for axis in (0, 1):
        side = min(_DETAIL_PIXELS * pixel, bounds[axis + 2] - bounds[axis])
        middle = float(np.median(boxes[:, [axis, axis + 2]])) if len(boxes) else bounds[axis]
        window.append((np.clip(middle - side / 2, bounds[axis], bounds[axis + 2] - side), side))
    (left, wide), (bottom, high) = window
    return float(left), float(bottom), float(left + wide), float(bottom + high)


def _region_values(
    raster: Path, of_region: NDArray[np.float64], bounds: Bounds, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Value of the region at each pixel of a picture, NaN at nodata."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import from_bounds

    with rasterio.open(raster) as regions:
        window = from_bounds(*bounds, transform=regions.transform)
        ids = regions.read(1, window=window, out_shape=shape, resampling=Resampling.nearest)
    shown: NDArray[np.float64] = of_region[ids]
    return shown


def _draw(
    path: Path,
    regions: _Regions,
    shading: _Shading,
    bounds: Bounds,
    title: str,
    facts: str,
    overlay: Overlay | None = None,
    *,
    enlarged: bool = False,
) -> None:
    """Draw a part of the regions with a frame; ``enlarged`` beyond the pixels of the raster, up to the longest side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = regions.size(bounds)
    scale = _LONGEST_SIDE / max(rows, columns)
    if not enlarged:
        scale = min(scale, max(1.0, 1000 / max(rows, columns)))
    height, width = max(round(rows * scale), 1), max(round(columns * scale), 1)
    wide, high = max(width + 2 * MARGIN + _BAR, 1000), height + HEADER + FOOTER
    figure = Figure(figsize=(wide / DPI, high / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left = (wide - width - _BAR) / 2 / wide
    axes = figure.add_axes((left, FOOTER / high, width / wide, height / high))
    bars = [_shade(axes, regions, shading, bounds, (height, width))]
    if overlay is not None and (drawn := overlay(axes)) is not None:
        bars.append(drawn)
    axes.set(xlim=(bounds[0], bounds[2]), ylim=(bounds[1], bounds[3]), xticks=[], yticks=[])
    write_header(figure, left, high, title, regions.facts(facts, bounds))
    _draw_bars(figure, bars, left + (width + 24) / wide, height)
    draw_scale_bar(figure, left + width / wide, width / wide, bounds, regions.metres)
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=DPI, metadata={"Software": None})


def _shade(axes: Axes, regions: _Regions, shading: _Shading, bounds: Bounds, shape: tuple[int, int]) -> tuple[Any, str]:
    """Colour the regions; without limits from the 2nd to the 98th percentile of what is shown."""
    values = _region_values(regions.raster, shading.of_region, bounds, shape)
    known = values[np.isfinite(values)]
    low, top = shading.limits or (np.percentile(known, (2, 98)) if known.size else (0.0, 1.0))
    picture = axes.imshow(
        values,
        cmap=shading.colours,
        vmin=low,
        vmax=top,
        alpha=shading.opacity,
        extent=(bounds[0], bounds[2], bounds[1], bounds[3]),
        aspect="auto",
        interpolation="nearest",
    )
    return picture, shading.label


def _draw_bars(figure: Figure, bars: list[tuple[Any, str]], left: float, height: int) -> None:
    """Draw colour bars above each other beside a map of ``height`` pixels, the first at its foot."""
    wide, high = (side * DPI for side in figure.get_size_inches())
    gap = 40
    long = min((height - gap * (len(bars) - 1)) / len(bars), _LONGEST_BAR)
    for number, (drawn, label) in enumerate(bars):
        place = (left, (FOOTER + number * (long + gap)) / high, 16 / wide, long / high)
        figure.colorbar(drawn, cax=figure.add_axes(place), label=label).outline.set_edgecolor(INK)


def _outlines(polygons: GeoDataFrame) -> Overlay:
    """Outlines of polygons, the largest if there are too many."""

    def draw(axes: Axes) -> None:
        import shapely
        from matplotlib.collections import LineCollection

        largest = polygons.sort_values("area_m2", ascending=False).geometry.iloc[:_MOST_BORDERS]
        rings = shapely.get_rings(shapely.get_parts(largest.to_numpy()))
        lines = [shapely.get_coordinates(ring) for ring in rings]
        axes.add_collection(LineCollection(lines, colors=OUTLINE_COLOUR, linewidths=1))

    return draw


def _inside(borders: GeoDataFrame, bounds: Bounds) -> GeoDataFrame:
    """Borders of two regions in a window, those that may part nothing last."""
    inside = borders[borders["probability_one_object"].notna()].cx[bounds[0] : bounds[2], bounds[1] : bounds[3]]
    return inside.iloc[:_MOST_BORDERS].sort_values("probability_one_object", kind="stable")


def _borders(borders: GeoDataFrame) -> Overlay:
    """Borders coloured by the probability that they part nothing, thicker and on top where that is likely."""

    def draw(axes: Axes) -> tuple[Any, str]:
        import shapely
        from matplotlib.collections import LineCollection
        from matplotlib.colors import LinearSegmentedColormap

        chance = borders["probability_one_object"].to_numpy()
        drawn = LineCollection(
            [shapely.get_coordinates(line) for line in borders.geometry],
            cmap=LinearSegmentedColormap.from_list("borders", BORDER_COLOURS),
            linewidths=0.9 + 3 * np.minimum(2 * np.sqrt(chance), 1),
            capstyle="round",
        )
        drawn.set_array(chance)
        drawn.set_clim(0, 0.5)
        axes.add_collection(drawn)
        return drawn, "probability that both sides are one object"

    return draw
