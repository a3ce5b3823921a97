"""Pictures of an ``edges`` run: levels and edge lines of the whole, both methods beside each other; its map page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.parameters import checked_parameters
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.report.finished_run import UNKNOWN, Bounds, FinishedRun, open_finished_run
from tilepipe.report.frame import DETAIL, QUICKLOOK, Picture
from tilepipe.report.map import Map
from tilepipe.report.map_page import PictureOnPage, TableOnPage, picture_shape, write_map_page
from tilepipe.report.vectors import busiest_window

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

EDGE_COLOUR, BORDER_COLOUR, NEVATIA_BABU_COLOUR = "#0a84ff", "#ff5a1f", "#ffc400"
EDGE, BORDER = "edge", "may be the border of a street"
_PANEL_SIDE = 880
_DETAIL = 200.0
"""Side of the part in metres."""
_DARKEST, _BRIGHTEST = 45, 245
_COLUMNS = {
    "line_id": "line",
    "length_m": "length (m)",
    "contrast": "contrast",
    "straightness": "straightness",
    "street_width_m": "width of the street (m)",
}


def pictures(folder: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> list[Path]:
    """Draw a finished ``edges`` run into its folder: levels and edge lines, a part in detail, and the map page.

    The detail is a part of 200 m with many street borders, over the photograph where it can still be read: edge lines,
    and the lines of Nevatia and Babu beside them.

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
    run = open_finished_run(folder, "edges", "segments.tif", ["edges"], rasters)
    edges, classical = run.table("edges"), run.optional_table("nevatia_babu")
    bordering = edges["street_border"].to_numpy(dtype=bool)
    others, borders = edges[~bordering], edges[bordering]
    side = 8 * max(round(_DETAIL / (run.pixel * run.metres) / 8), 8)
    part = busiest_window(borders if len(borders) else edges, run, side)
    title = f"Edges: {run.name}"
    facts = run.facts(
        f"{len(edges):,} edges, {run.kilometres(edges):,.1f} km; {len(borders):,} may be borders of streets"
    )
    whole = Picture(run)
    (drawn,) = whole.maps
    _draw_levels(drawn, run)
    _draw_edges(drawn, others, borders)
    drawn.mark(part)
    return [
        whole.save(QUICKLOOK, title, facts),
        _draw_detail(run, others, borders, classical, part or run.bounds, f"{title}, detail"),
        _page(run, others, borders, classical, title, facts),
    ]


def _draw_detail(
    run: FinishedRun,
    others: GeoDataFrame,
    borders: GeoDataFrame,
    classical: GeoDataFrame | None,
    part: Bounds,
    title: str,
) -> Path:
    captions = ["Bayesian model: line field", "Nevatia–Babu"][: 1 if classical is None else 2]
    picture = Picture(run, part, captions=captions, longest=_PANEL_SIDE, enlarged=True)
    photograph = run.background(part, picture.maps[0].shape)
    known = not photograph.mask.all()
    for drawn in picture.maps:
        if known:
            drawn.grey(photograph)
        else:
            _draw_levels(drawn, run)
    _draw_edges(picture.maps[0], others, borders)
    if classical is not None:
        picture.maps[1].lines(classical, NEVATIA_BABU_COLOUR, EDGE)
        _say_if_empty(picture.maps[1])
    return picture.save(DETAIL, title, run.facts(f"over the {'photograph' if known else 'levels'}", part))


def _draw_levels(drawn: Map, run: FinishedRun) -> None:
    greys = _level_greys(run)
    drawn.grey(_levels(run, drawn.bounds, drawn.shape))
    text = f"level 0 … {len(greys) - 1}, darkest to brightest"
    drawn.swatches.append(([str(grey / 255) for grey in greys.tolist()], text))


def _draw_edges(drawn: Map, others: GeoDataFrame, borders: GeoDataFrame) -> None:
    drawn.lines(others, EDGE_COLOUR, EDGE)
    drawn.lines(borders, BORDER_COLOUR, BORDER, wider=1.5)
    _say_if_empty(drawn)


def _say_if_empty(drawn: Map) -> None:
    if not drawn.legend:
        drawn.say("no lines")


def _level_greys(run: FinishedRun) -> NDArray[np.uint8]:
    """Evenly spaced greys of the levels, darkest first."""
    recorded = {name: value for name, value in run.record.get("parameters", {}).items() if name == "levels"}
    levels = checked_parameters(EdgeParameters, recorded).levels
    return np.linspace(_DARKEST, _BRIGHTEST, levels).astype(np.uint8)


def _levels(run: FinishedRun, bounds: Bounds, shape: tuple[int, int]) -> np.ma.MaskedArray[Any, Any]:
    """Levels in grey, on a picture of `shape` (rows, columns); nodata is masked."""
    levels = run.raster("segments.tif", bounds, shape)
    return np.ma.masked_array(_level_greys(run)[levels.filled(0)], levels.mask)


def _page(
    run: FinishedRun,
    others: GeoDataFrame,
    borders: GeoDataFrame,
    classical: GeoDataFrame | None,
    title: str,
    facts: str,
) -> Path:
    layers: list[PictureOnPage | TableOnPage] = []
    if not run.inputs:
        levels = _levels(run, run.bounds, picture_shape(run))
        layers.append(PictureOnPage("levels", levels.filled(UNKNOWN)))
    if classical is not None:
        layers.append(TableOnPage("Nevatia–Babu", classical, NEVATIA_BABU_COLOUR, _COLUMNS, visible=False))
    layers.append(TableOnPage("edges", others, EDGE_COLOUR, _COLUMNS))
    layers.append(TableOnPage("may be borders of streets", borders, BORDER_COLOUR, _COLUMNS))
    return write_map_page(run, title, facts, layers)
