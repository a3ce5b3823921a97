"""Pictures of a ``streets`` run: regions tinted over the input in grey, centerlines and junctions; and its map page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from geopandas import GeoDataFrame, GeoSeries
from numpy.typing import NDArray

from tilepipe.report.finished_run import Bounds, FinishedRun, open_finished_run
from tilepipe.report.frame import DETAIL, QUICKLOOK, Picture
from tilepipe.report.map import tinted
from tilepipe.report.map_page import PictureOnPage, TableOnPage, picture_shape, write_map_page
from tilepipe.report.vectors import busiest_window

REGION_COLOUR, LINE_COLOUR = "#00a6d6", "#ff3d14"
JUNCTION_COLOUR, SKELETON_COLOUR = "#ffd60a", "#7b2ff7"
_DETAIL_PIXELS = 1000
_COLUMNS = {
    "line_id": "line",
    "length_m": "length (m)",
    "mean_width_m": "width (m)",
    "response": "response",
    "contrast": "contrast",
}


def pictures(folder: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> list[Path]:
    """Draw a finished ``streets`` run into its folder: all of it, the part with most centerline, and the map page.

    Parameters
    ----------
    folder
        Of the run.
    rasters
        Its input rasters; by default those recorded in ``run.toml``.

    Returns
    -------
    list of Path
        ``quicklook.png``, ``quicklook_detail.png`` and ``report.html``.

    Raises
    ------
    InputError
        The folder is not that of a finished run, or cannot be written.
    """
    run = open_finished_run(folder, "streets", "streets.tif", ["centerlines"], rasters)
    lines = run.table("centerlines")
    title = f"Street centerlines: {run.name}"
    found = f"{len(lines):,} centerlines, {run.kilometres(lines):,.1f} km"
    part = busiest_window(lines, run, _DETAIL_PIXELS)
    return [
        _draw(run, lines, None, part).save(QUICKLOOK, title, run.facts(found)),
        _draw(run, lines, part).save(DETAIL, f"{title}, detail", run.facts("the part with most centerline", part)),
        _page(run, lines, title, run.facts(found)),
    ]


def junctions(lines: GeoDataFrame) -> NDArray[np.float64]:
    """Points (n, 2) where three or more line ends meet, by node ids or else by equal coordinates."""
    geometry = lines.geometry.to_numpy()
    ends = np.concatenate([shapely.get_point(geometry, 0), shapely.get_point(geometry, -1)])
    points: NDArray[np.float64] = shapely.get_coordinates(ends)
    nodes: NDArray[Any] = points
    if {"from_node", "to_node"} <= set(lines.columns):
        nodes = np.concatenate([lines["from_node"], lines["to_node"]])
    _, first, count = np.unique(nodes, axis=0, return_index=True, return_counts=True)
    met: NDArray[np.float64] = points[first[count >= 3]]
    return met


def region_mask(run: FinishedRun, bounds: Bounds, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Where ``streets.tif`` has a region, on a picture of `shape` (rows, columns)."""
    mask: NDArray[np.bool_] = run.raster("streets.tif", bounds, shape).filled(0) != 0
    return mask


def _draw(run: FinishedRun, lines: GeoDataFrame, bounds: Bounds | None, part: Bounds | None = None) -> Picture:
    picture = Picture(run, bounds)
    (drawn,) = picture.maps
    drawn.grey(run.background(picture.bounds, drawn.shape).filled())
    drawn.tint(region_mask(run, picture.bounds, drawn.shape), REGION_COLOUR, "street region")
    # Many lines on few pixels want a finer pen.
    width = float(np.clip(2.4 - 0.25 * drawn.metres_per_pixel, 0.8, 2.4))
    drawn.lines(lines, LINE_COLOUR, "centerline", width=width, halo=True)
    drawn.points(junctions(lines), JUNCTION_COLOUR, "junction", width + 3.2)
    drawn.mark(part)
    return picture


def _page(run: FinishedRun, lines: GeoDataFrame, title: str, facts: str) -> Path:
    mask, skeleton = region_mask(run, run.bounds, picture_shape(run)), run.optional_table("skeleton")
    points = GeoDataFrame(geometry=GeoSeries(shapely.points(junctions(lines))))
    layers: list[PictureOnPage | TableOnPage] = [PictureOnPage("street regions", tinted(mask, REGION_COLOUR))]
    if skeleton is not None:
        layers.append(TableOnPage("skeleton", skeleton, SKELETON_COLOUR, _COLUMNS, visible=False))
    layers.append(TableOnPage("centerlines", lines, LINE_COLOUR, _COLUMNS))
    layers.append(TableOnPage("junctions", points, JUNCTION_COLOUR))
    return write_map_page(run, title, facts, layers)
