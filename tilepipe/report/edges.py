"""Pictures of an ``edges`` run: levels and edge lines of the whole, and both methods beside each other in a part."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.atomic import atomic_write
from tilepipe.report.frame import (
    DPI,
    FOOTER,
    HEADER,
    INK,
    MARGIN,
    Bounds,
    busiest_window,
    draw_frame,
    draw_scale_bar,
    draw_swatches,
    nodata_patch,
    pen,
    recorded_inputs,
    write_header,
)
from tilepipe.tiling.grid import Window

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EDGE_COLOUR, BORDER_COLOUR, NEVATIA_BABU_COLOUR = "#0a84ff", "#ff5a1f", "#ffc400"
_LONGEST_SIDE, _PANEL_SIDE, _GAP, _CAPTION = 1800, 880, 30, 30
_DETAIL = 200.0
"""Side of the part in metres."""
_MOST_LINES = 100_000
_DARKEST, _BRIGHTEST, _NODATA = 45, 245, 0


@dataclass(frozen=True)
class _EdgesRun:
    """What the pictures need of a run's folder.

    ``pixel`` is in CRS units, ``metres`` the length of such a unit, ``levels`` the number of grey levels.
    """

    folder: Path
    bounds: Bounds
    shape: tuple[int, int]
    pixel: float
    metres: float
    crs_name: str
    levels: int
    edges: GeoDataFrame
    nevatia_babu: GeoDataFrame | None

    @property
    def title(self) -> str:
        return f"Edges: {self.folder.resolve().name}"

    @property
    def length(self) -> float:
        """Kilometres of edge lines."""
        return float(self.edges.length.sum()) * self.metres / 1000


@dataclass(frozen=True)
class _Panel:
    """One map of a picture.

    Attributes
    ----------
    caption
        Written above it.
    grey
        The picture below the lines; 0 = nodata.
    layers
        Label, colour and lines, from the lowest to the top.
    levels
        How many levels ``grey`` shows; 0 where it is a photograph.
    frame
        The part that the other picture shows.
    """

    caption: str
    grey: NDArray[np.uint8]
    layers: Sequence[tuple[str, str, GeoDataFrame]]
    levels: int = 0
    frame: Bounds | None = None


def edge_pictures(run_dir: str | os.PathLike[str]) -> list[Path]:
    """Draw a finished ``edges`` run as ``quicklook.png`` and ``quicklook_detail.png`` into its folder.

    The first shows the levels of the whole image with the edge lines; the second, over the photograph where it can
    still be read, a part of 200 m with many street borders: edge lines, and the lines of Nevatia and Babu beside them.

    Raises
    ------
    InputError
        The folder is not that of a finished run.
    """
    run = _open_run(Path(run_dir))
    rows, columns = run.shape
    scale = min(_LONGEST_SIDE / max(rows, columns), max(1.0, 1000 / max(rows, columns)))
    shape = max(round(rows * scale), 1), max(round(columns * scale), 1)
    number = int(run.edges["street_border"].sum())
    facts = (
        f"{len(run.edges):,} edges, {run.length:,.1f} km; {number:,} may be borders of streets   |   "
        f"{columns:,} × {rows:,} pixels of {run.pixel * run.metres:.2f} m   |   {run.crs_name}"
    )
    window = _busy_part(run)
    frame = None if window == run.bounds else window
    whole = _Panel("", _levels(run, run.bounds, shape), _edge_layers(run.edges), run.levels, frame)
    pictures = [_draw(run, "quicklook.png", run.bounds, [whole], run.title, facts)]
    grey, shown = _background(run, window)
    levels = run.levels if shown == "levels" else 0
    panels = [_Panel("Bayesian model: line field", grey, _edge_layers(run.edges), levels)]
    if run.nevatia_babu is not None:
        panels.append(_Panel("Nevatia–Babu", grey, [("edge", NEVATIA_BABU_COLOUR, run.nevatia_babu)]))
    rows, columns = grey.shape
    facts = f"{columns:,} × {rows:,} pixels of {run.pixel * run.metres:.2f} m, over the {shown}   |   {run.crs_name}"
    pictures.append(_draw(run, "quicklook_detail.png", window, panels, f"{run.title}, detail", facts))
    return pictures


def _open_run(folder: Path) -> _EdgesRun:
    import rasterio

    from tilepipe.io.record import RECORD, read_record
    from tilepipe.io.tables import metres_per_unit, read_vectors, run_table

    table, raster = run_table(folder, "edges"), folder / "segments.tif"
    if table is None or not raster.is_file():
        raise InputError(f"{folder} holds no segments.tif with edges; give the folder of a finished edges run")
    with rasterio.open(raster) as levels:
        bounds, shape, crs, pixel = tuple(levels.bounds), (levels.height, levels.width), levels.crs, levels.res[0]
    edges, other = read_vectors(table, "result").to_crs(crs), run_table(folder, "nevatia_babu")
    return _EdgesRun(
        folder,
        bounds,
        shape,
        pixel,
        metres_per_unit(crs, str(raster)),
        edges.crs.name,
        read_record(folder / RECORD)["parameters"]["levels"],
        edges,
        None if other is None else read_vectors(other, "result").to_crs(crs),
    )


def _edge_layers(edges: GeoDataFrame) -> list[tuple[str, str, GeoDataFrame]]:
    borders = edges["street_border"].to_numpy(dtype=bool)
    return [
        ("edge", EDGE_COLOUR, edges[~borders]),
        ("may be the border of a street", BORDER_COLOUR, edges[borders]),
    ]


def _busy_part(run: _EdgesRun) -> Bounds:
    """The part with most borders of streets, or with most edges where there are none."""
    side = 8 * max(round(_DETAIL / (run.pixel * run.metres) / 8), 8)
    borders = run.edges[run.edges["street_border"].to_numpy(dtype=bool)]
    return busiest_window(borders if len(borders) else run.edges, run.bounds, run.shape, side) or run.bounds


def _levels(run: _EdgesRun, bounds: Bounds, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Levels of ``segments.tif`` as evenly spaced greys, nearest pixel, on a picture of ``shape`` (rows, columns)."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import from_bounds

    with rasterio.open(run.folder / "segments.tif") as raster:
        window = from_bounds(*bounds, transform=raster.transform)
        levels = raster.read(1, window=window, out_shape=shape, resampling=Resampling.nearest)
        missing = levels == raster.nodata
    greys = np.full(256, _NODATA, np.uint8)
    greys[: run.levels] = _level_greys(run.levels)
    return greys[np.where(missing, 255, levels)]


def _level_greys(number: int) -> NDArray[np.uint8]:
    """Greys of the levels, darkest first."""
    return np.linspace(_DARKEST, _BRIGHTEST, number).astype(np.uint8)


def _window(run: _EdgesRun, bounds: Bounds) -> Window:
    """The pixels of a part."""
    top, left = round((run.bounds[3] - bounds[3]) / run.pixel), round((bounds[0] - run.bounds[0]) / run.pixel)
    rows, columns = (round((bounds[k + 2] - bounds[k]) / run.pixel) for k in (1, 0))
    return Window(top, left, top + rows, left + columns)


def _background(run: _EdgesRun, bounds: Bounds) -> tuple[NDArray[np.uint8], str]:
    """The photograph in grey, or else the levels, at full resolution; and which of the two it is."""
    window = _window(run, bounds)
    try:
        values = _photograph(run, window)
    except (InputError, OSError, KeyError):
        return _levels(run, bounds, window.shape), "levels"
    known = np.isfinite(values)
    if not known.any():
        return _levels(run, bounds, window.shape), "levels"
    low, high = np.percentile(values[known], (1, 99))
    grey = 20 + 215 * np.clip((values - low) / max(high - low, 1e-12), 0, 1)
    return np.where(known, grey, _NODATA).astype(np.uint8), "photograph"


def _photograph(run: _EdgesRun, window: Window) -> NDArray[np.float32]:
    """Grey values of the inputs as the run has seen them."""
    from tilepipe.io.record import RECORD, read_record
    from tilepipe.pipelines.edges.layers import IMAGE_SUMMARY
    from tilepipe.pipelines.edges.pass_bands import open_photograph

    record = read_record(run.folder / RECORD)
    inputs = record["inputs"]
    paths = recorded_inputs(run.folder, inputs["rasters"])
    photograph = open_photograph(
        paths, crs=inputs.get("crs"), band=inputs.get("band"), grey=record["parameters"]["grey"]
    )
    if photograph.raster.shape != run.shape:
        raise InputError("the inputs have changed since the run")
    weights = json.loads((run.folder / IMAGE_SUMMARY.name).read_text(encoding="utf-8"))["band_weights"]
    return replace(photograph, weights=tuple(weights)).read(window)


def _draw(run: _EdgesRun, name: str, bounds: Bounds, panels: Sequence[_Panel], title: str, facts: str) -> Path:
    """Draw maps of the same bounds beside each other, with header, legend and scale bar, into the run's folder."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    aspect = (bounds[2] - bounds[0]) / (bounds[3] - bounds[1])
    caption, (height, width) = 0, panels[0].grey.shape
    if panels[0].caption:
        caption, height, width = _CAPTION, round(_PANEL_SIDE / max(aspect, 1)), round(_PANEL_SIDE * min(aspect, 1))
    maps = len(panels) * width + (len(panels) - 1) * _GAP
    wide, high = max(maps + 2 * MARGIN, 1000), height + HEADER + FOOTER + caption
    figure = Figure(figsize=(wide / DPI, high / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left = (wide - maps) / 2 / wide
    panels = [replace(panel, layers=_drawn(panel.layers, bounds)) for panel in panels]
    for number, panel in enumerate(panels):
        begin = left + number * (width + _GAP) / wide
        axes = figure.add_axes((begin, FOOTER / high, width / wide, height / high))
        _draw_panel(axes, panel, bounds, (bounds[2] - bounds[0]) / width, run.metres)
        if panel.caption:
            y = (FOOTER + height + 15) / high
            figure.text(begin, y, panel.caption, fontsize=13, fontweight="bold", color=INK, va="center")
        _draw_legend(figure, begin, high, panel)
    write_header(figure, left, high, title, facts)
    draw_scale_bar(figure, left + maps / wide, width / wide, bounds, run.metres)
    with atomic_write(run.folder / name) as aside:
        figure.savefig(aside, dpi=DPI, metadata={"Software": None})
    return run.folder / name


def _drawn(layers: Sequence[tuple[str, str, GeoDataFrame]], bounds: Bounds) -> list[tuple[str, str, GeoDataFrame]]:
    """Keep the lines inside, of too many the longest, and the layers that have any."""
    drawn = []
    for label, colour, lines in layers:
        inside = lines.cx[bounds[0] : bounds[2], bounds[1] : bounds[3]]
        if len(inside) > _MOST_LINES:
            longest = np.argsort(-inside.length.to_numpy(), kind="stable")[:_MOST_LINES]
            inside, label = inside.iloc[longest], f"{label} (the {_MOST_LINES:,} longest)"
        if len(inside):
            drawn.append((label, colour, inside))
    return drawn


def _draw_panel(axes: Axes, panel: _Panel, bounds: Bounds, pixel: float, metres: float) -> None:
    """Draw one map; ``pixel`` of the picture in CRS units, ``metres`` the length of such a unit."""
    import shapely
    from matplotlib.collections import LineCollection

    area = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    extent = (bounds[0], bounds[2], bounds[1], bounds[3])
    if (panel.grey == _NODATA).any():
        axes.add_patch(nodata_patch(bounds))
    grey = np.ma.masked_equal(panel.grey, _NODATA)
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto", interpolation="antialiased")
    for number, (_, colour, lines) in enumerate(panel.layers):
        width, opacity = pen(pixel * metres, float(lines.length.sum()) * pixel / area)
        parts = [shapely.get_coordinates(line) for line in lines.geometry]
        width *= 1 + 0.5 * number
        axes.add_collection(LineCollection(parts, colors=colour, alpha=opacity, linewidths=width, capstyle="round"))
    if not panel.layers:
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "boxstyle": "round,pad=0.5"}
        axes.text(
            0.5, 0.5, "no lines", transform=axes.transAxes, ha="center", va="center", fontsize=13, color=INK, bbox=box
        )
    if panel.frame is not None:
        draw_frame(axes, panel.frame)
    axes.set(xlim=(bounds[0], bounds[2]), ylim=(bounds[1], bounds[3]), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color(INK)
        spine.set_linewidth(0.8)


def _draw_legend(figure: Figure, left: float, height: int, panel: _Panel) -> None:
    from matplotlib.artist import Artist
    from matplotlib.lines import Line2D

    entries: list[Artist] = [
        Line2D([], [], color=colour, linewidth=3, label=label) for label, colour, _ in panel.layers
    ]
    if panel.frame is not None:
        entries.append(Line2D([], [], color=INK, linewidth=1.4, linestyle=(0, (4, 2)), label="detail picture"))
    if (panel.grey == _NODATA).any():
        entries.append(nodata_patch(label="nodata"))
    if panel.levels:
        colours = [str(grey / 255) for grey in _level_greys(panel.levels).tolist()]
        text = f"level 0 … {panel.levels - 1}, darkest to brightest"
        draw_swatches(figure, left, (FOOTER / 2 - 16) / height, colours, text)
    if not entries:
        return
    figure.legend(
        handles=entries,
        loc="center left",
        bbox_to_anchor=(left - 0.006, (FOOTER / 2 + (14 if panel.levels else 0)) / height),
        ncols=len(entries),
        frameon=False,
        fontsize=11.5,
        labelcolor=INK,
        columnspacing=1.6,
    )
