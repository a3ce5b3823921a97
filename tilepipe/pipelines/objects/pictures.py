"""Pictures of an ``objects`` run: regions by their height, borders and buildings by their probability; its map page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from tilepipe.report.finished_run import Bounds, FinishedRun, open_finished_run
from tilepipe.report.frame import DETAIL, QUICKLOOK, Picture
from tilepipe.report.map import INK, MOST_LINES, coloured
from tilepipe.report.map_page import PictureOnPage, TableOnPage, picture_shape, write_map_page
from tilepipe.report.vectors import busiest_window

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

BUILDINGS = "quicklook_buildings.png"
HEIGHT_COLOURS, BUILDING_COLOURS = "viridis", "YlGnBu"
BORDER_COLOURS = (INK, "#e0007a", "#ff9ecb")
"""From borders that are certain to those that might as well not be."""
OUTLINE_COLOUR = "#d1495b"
_HEIGHT, _HEIGHT_LABEL = "posterior_mean", "height of the region (m)"
_CHANCE = "probability_one_object"
_DETAIL_PIXELS = 400
_DOUBTFUL = 0.05
"""Probability of one object from which on the page shows a border."""
_OBJECT_COLUMNS = {
    "region_id": "region",
    _HEIGHT: "height (m)",
    "height_above_ground": "above the ground (m)",
    "building_probability": "probability of a building",
    "area_m2": "area (m²)",
}
_BUILDING_COLUMNS = {
    "building_id": "building",
    "probability": "probability",
    "height_above_ground": "height above the ground (m)",
    "area_m2": "area (m²)",
}
_BORDER_COLUMNS = {_CHANCE: "probability of one object", "height_step_m": "step (m)"}


def pictures(folder: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> list[Path]:
    """Draw a finished ``objects`` run into its folder: all of it, a part with the borders, buildings, and the map page.

    Parameters
    ----------
    folder
        Of the run.
    rasters
        Its input rasters; by default those recorded in ``run.toml``.

    Returns
    -------
    list of Path
        ``quicklook.png``, ``quicklook_detail.png``, where buildings were asked for ``quicklook_buildings.png``, and
        ``report.html``.

    Raises
    ------
    InputError
        The folder is not that of a finished run, or cannot be written.
    """
    run = open_finished_run(folder, "objects", "regions.tif", ["objects", "boundaries"], rasters)
    objects, boundaries, buildings = run.table("objects"), run.table("boundaries"), run.optional_table("buildings")
    borders = boundaries[boundaries[_CHANCE].notna()]
    title, found = f"Objects: {run.name}", run.facts(f"{len(objects):,} regions")
    part = busiest_window(borders, run, _DETAIL_PIXELS)
    whole = Picture(run, bars=True)
    (drawn,) = whole.maps
    drawn.scale(_of_regions(run, objects, _HEIGHT, run.bounds, drawn.shape), HEIGHT_COLOURS, _HEIGHT_LABEL)
    drawn.mark(part)
    made = [whole.save(QUICKLOOK, title, found), _draw_detail(run, objects, borders, part or run.bounds, title)]
    if buildings is not None:
        made.append(_draw_buildings(run, objects, buildings))
    return [*made, _page(run, objects, borders, buildings, title, found)]


def _of_regions(
    run: FinishedRun, objects: GeoDataFrame, column: str, bounds: Bounds, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """A column of the objects at each pixel of a picture of `shape` (rows, columns), NaN where there is none."""
    ids = run.raster("regions.tif", bounds, shape).filled(0)
    by_region = objects.set_index("region_id")[column].astype(np.float64)
    values: NDArray[np.float64] = by_region.reindex(ids.ravel()).to_numpy().reshape(shape)
    return values


def _draw_detail(run: FinishedRun, objects: GeoDataFrame, borders: GeoDataFrame, part: Bounds, title: str) -> Path:
    """Draw borders by the probability that they part nothing, thicker and on top where that is likely."""
    inside = borders.cx[part[0] : part[2], part[1] : part[3]].iloc[:MOST_LINES]
    inside = inside.sort_values(_CHANCE, kind="stable")
    picture = Picture(run, part, enlarged=True, bars=True)
    (drawn,) = picture.maps
    heights = _of_regions(run, objects, _HEIGHT, part, drawn.shape)
    drawn.scale(heights, HEIGHT_COLOURS, _HEIGHT_LABEL, opacity=0.6)
    colours = LinearSegmentedColormap.from_list("borders", BORDER_COLOURS)
    widths = 0.9 + 3 * np.minimum(2 * np.sqrt(inside[_CHANCE].to_numpy()), 1)
    drawn.scaled_lines(inside, _CHANCE, colours, "probability that both sides are one object", (0, 0.5), widths)
    return picture.save(DETAIL, f"{title}, detail", run.facts(f"{len(inside):,} borders of two regions", part))


def _draw_buildings(run: FinishedRun, objects: GeoDataFrame, buildings: GeoDataFrame) -> Path:
    picture = Picture(run, bars=True)
    (drawn,) = picture.maps
    chances = _of_regions(run, objects, "building_probability", run.bounds, drawn.shape)
    drawn.scale(chances, BUILDING_COLOURS, "probability of a building", (0.0, 1.0))
    drawn.lines(buildings, OUTLINE_COLOUR, "building", width=1)
    found = f"{len(buildings):,} buildings or blocks of {buildings['area_m2'].sum():,.0f} m²"
    return picture.save(BUILDINGS, f"Buildings: {run.name}", run.facts(found))


def _page(
    run: FinishedRun,
    objects: GeoDataFrame,
    borders: GeoDataFrame,
    buildings: GeoDataFrame | None,
    title: str,
    facts: str,
) -> Path:
    heights = _of_regions(run, objects, _HEIGHT, run.bounds, picture_shape(run))
    doubtful = borders[borders[_CHANCE] >= _DOUBTFUL]
    layers: list[PictureOnPage | TableOnPage] = [
        PictureOnPage("heights of the regions", coloured(heights, HEIGHT_COLOURS)),
        TableOnPage("regions", objects, INK, _OBJECT_COLUMNS, visible=buildings is None),
        TableOnPage("doubtful borders", doubtful, BORDER_COLOURS[1], _BORDER_COLUMNS),
    ]
    if buildings is not None:
        layers.append(TableOnPage("buildings", buildings, OUTLINE_COLOUR, _BUILDING_COLUMNS))
    return write_map_page(run, title, facts, layers)
