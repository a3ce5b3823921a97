"""Pictures of an ``objects`` run: regions by their height, borders and buildings by their probability."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.aside import written_aside
from tilepipe.errors import InputError
from tilepipe.picture_frame import DPI, FOOTER, HEADER, INK, MARGIN, Bounds, draw_scale_bar, write_header

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes

_LONGEST_SIDE = 1500
_BAR = 110
_DETAIL_PIXELS = 400
_MOST_BORDERS = 60_000
HEIGHT_COLOURS, BORDER_COLOURS, BUILDING_COLOURS = "viridis", "plasma", "YlGnBu"


def object_pictures(run_dir: str | os.PathLike[str]) -> list[Path]:
    """Draw a finished ``objects`` run as ``quicklook.png`` and ``quicklook_detail.png`` into its folder.

    The first shows the whole raster, the second a part at full resolution with the borders.  Where buildings were
    asked for, ``quicklook_buildings.png`` shows the probability that each region is one.

    Raises
    ------
    InputError
        The folder is not that of a finished run.
    """
    import rasterio

    from tilepipe.vector_layers import POLYGONS, metres_per_unit, read_vectors, run_table

    folder = Path(run_dir)
    objects, borders = run_table(folder, "objects"), run_table(folder, "boundaries")
    raster = folder / "regions.tif"
    if objects is None or borders is None or not raster.is_file():
        raise InputError(f"{folder} holds no regions.tif with objects; give the folder of a finished objects run")
    with rasterio.open(raster) as regions:
        bounds: Bounds = tuple(regions.bounds)
        pixel, shape, crs = regions.res[0], (regions.height, regions.width), regions.crs
    metres = metres_per_unit(crs, str(raster))
    table, lines = read_vectors(objects, "result", POLYGONS).to_crs(crs), read_vectors(borders, "result").to_crs(crs)
    heights = _by_region(table, "posterior_mean")
    facts = (
        f"{len(table):,} regions   |   {shape[1]:,} × {shape[0]:,} pixels of {pixel * metres:.2f} m   |   "
        f"{table.crs.name}"
    )
    title = f"Objects: {folder.resolve().name}"
    whole = _draw(folder / "quicklook.png", raster, heights, None, bounds, pixel, metres, title, facts)
    window = _amid_borders(bounds, pixel, lines)
    facts = f"borders of two regions   |   {table.crs.name}"
    name = folder / "quicklook_detail.png"
    pictures = [whole, _draw(name, raster, heights, lines, window, pixel, metres, f"{title}, detail", facts)]
    if (buildings := run_table(folder, "buildings")) is not None:
        found = read_vectors(buildings, "result", POLYGONS).to_crs(crs)
        chances, name = _by_region(table, "building_probability"), folder / "quicklook_buildings.png"
        facts = f"{len(found):,} buildings or blocks of {found['area_m2'].sum():,.0f} m²   |   {table.crs.name}"
        title = f"Buildings: {folder.resolve().name}"
        pictures.append(_draw(name, raster, chances, None, bounds, pixel, metres, title, facts, buildings=found))
    return pictures


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
    raster: Path,
    of_region: NDArray[np.float64],
    borders: GeoDataFrame | None,
    bounds: Bounds,
    pixel: float,
    metres: float,
    title: str,
    facts: str,
    buildings: GeoDataFrame | None = None,
) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = (round(side / pixel) for side in (bounds[3] - bounds[1], bounds[2] - bounds[0]))
    scale = _LONGEST_SIDE / max(rows, columns)
    if borders is None:
        scale = min(scale, max(1.0, 1000 / max(rows, columns)))
    height, width = max(round(rows * scale), 1), max(round(columns * scale), 1)
    wide, high = max(width + 2 * MARGIN + _BAR, 1000), height + HEADER + FOOTER
    figure = Figure(figsize=(wide / DPI, high / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left = (wide - width - _BAR) / 2 / wide
    axes = figure.add_axes((left, FOOTER / high, width / wide, height / high))
    values = _region_values(raster, of_region, bounds, (height, width))
    known = values[np.isfinite(values)]
    low, top = np.percentile(known, (2, 98)) if known.size and buildings is None else (0.0, 1.0)
    colours, label = (
        (HEIGHT_COLOURS, "height of the region (m)")
        if buildings is None
        else (BUILDING_COLOURS, "probability of a building")
    )
    extent = (bounds[0], bounds[2], bounds[1], bounds[3])
    picture = axes.imshow(
        values, cmap=colours, vmin=low, vmax=top, extent=extent, aspect="auto", interpolation="nearest"
    )
    drawn: Any = picture
    if borders is not None:
        picture.set_alpha(0.45)
        drawn, label = _draw_borders(axes, borders, bounds), "probability that both sides are one object"
    if buildings is not None:
        _draw_outlines(axes, buildings)
    axes.set(xlim=(bounds[0], bounds[2]), ylim=(bounds[1], bounds[3]), xticks=[], yticks=[])
    write_header(figure, left, high, title, facts)
    bar = figure.add_axes((left + (width + 24) / wide, FOOTER / high, 16 / wide, min(height, 500) / high))
    figure.colorbar(drawn, cax=bar, label=label).outline.set_edgecolor(INK)
    draw_scale_bar(figure, left + width / wide, width / wide, bounds, metres)
    with written_aside(path) as aside:
        figure.savefig(aside, dpi=DPI, metadata={"Software": None})
    return path


def _draw_outlines(axes: Axes, polygons: GeoDataFrame) -> None:
    """Outlines of polygons, the largest if there are too many."""
    import shapely
    from matplotlib.collections import LineCollection

    largest = polygons.sort_values("area_m2", ascending=False).geometry.iloc[:_MOST_BORDERS]
    rings = shapely.get_rings(shapely.get_parts(largest.to_numpy()))
    axes.add_collection(
        LineCollection([shapely.get_coordinates(ring) for ring in rings], colors="#d1495b", linewidths=1)
    )


def _draw_borders(axes: Axes, borders: GeoDataFrame, bounds: Bounds) -> Any:
    """Borders of two regions in a window, coloured by the probability that they part nothing."""
    import shapely
    from matplotlib.collections import LineCollection

    inside = borders[borders["probability_one_object"].notna()].cx[bounds[0] : bounds[2], bounds[1] : bounds[3]]
    inside = inside.iloc[:_MOST_BORDERS]
    lines = [shapely.get_coordinates(line) for line in inside.geometry]
    drawn = LineCollection(lines, cmap=BORDER_COLOURS, linewidths=1.6, capstyle="round")
    drawn.set_array(inside["probability_one_object"].to_numpy())
    drawn.set_clim(0, 0.5)
    axes.add_collection(drawn)
    return drawn
