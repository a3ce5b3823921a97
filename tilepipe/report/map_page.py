"""The map page of a run, ``report.html``: layers to switch, facts under the mouse, timings and parameters.

The page is one file that needs no network: pictures and the map library are inside.
"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from bokeh.embed import components
from bokeh.models.callbacks import CustomJS
from bokeh.models.formatters import CustomJSTickFormatter
from bokeh.models.ranges import Range1d
from bokeh.models.tools import HoverTool
from bokeh.models.widgets import CheckboxButtonGroup
from bokeh.plotting import figure
from bokeh.resources import Resources
from numpy.typing import NDArray
from PIL import Image

from tilepipe.errors import InputError
from tilepipe.io.files.paths import location
from tilepipe.io.files.record import TIMINGS
from tilepipe.report.finished_run import FinishedRun
from tilepipe.report.map import INK
from tilepipe.report.vectors import coordinates, longest

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

REPORT = "report.html"
MOST_PIXELS = 2400
"""Along a picture."""
_MOST_LINES = 20_000
_MOST_VERTICES = 100_000
_ORIGIN = 1000
"""Coordinates on the page begin at a multiple of this: they are fewer digits, and ticks stay round."""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
{library}
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; color: #1d2433; margin: 0 auto; max-width: 1400px;
  padding: 1.5rem; }}
h1 {{ font-size: 1.6rem; margin: 0; }}
h2 {{ font-size: 1.1rem; margin: 2rem 0 .5rem; }}
.facts, .notes {{ color: #57606f; margin: .2rem 0 1rem; }}
.tables {{ display: flex; flex-wrap: wrap; gap: 0 4rem; align-items: flex-start; }}
table {{ border-collapse: collapse; }}
td {{ padding: .15rem 1.5rem .15rem 0; border-bottom: 1px solid #e6e9ee; vertical-align: top; }}
td:last-child {{ font-variant-numeric: tabular-nums; overflow-wrap: anywhere; max-width: 40rem; }}
td.number {{ text-align: right; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p class="facts">{facts}</p>
{map}
<p class="notes">{notes}</p>
<div class="tables">{tables}</div>
{script}
</body>
</html>
"""


@dataclass(frozen=True)
class PictureOnPage:
    """A raster layer of the page: uint8, grey (rows, columns) or red, green, blue and opacity (rows, columns, 4)."""

    name: str
    pixels: NDArray[np.uint8]
    visible: bool = True


@dataclass(frozen=True)
class TableOnPage:
    """A layer of lines, polygons or points of the page; ``columns`` are shown under the mouse by these names."""

    name: str
    table: GeoDataFrame
    colour: str
    columns: Mapping[str, str] = field(default_factory=dict)
    visible: bool = True


def picture_shape(run: FinishedRun) -> tuple[int, int]:
    """Rows and columns of a picture that shows all of a run on the page."""
    scale = min(1.0, MOST_PIXELS / max(run.shape))
    return max(round(run.shape[0] * scale), 1), max(round(run.shape[1] * scale), 1)


def write_map_page(run: FinishedRun, title: str, facts: str, layers: Sequence[PictureOnPage | TableOnPage]) -> Path:
    """Write ``report.html`` into the folder of a run; returns the path.

    Of a layer, lines or polygons beyond the longest 20,000 are left out, and the others simplified until they have no
    more than 100,000 vertices; the page says so.

    Parameters
    ----------
    layers
        From the lowest to the top; below them lies the input in grey, as far as it can be read.
    """
    if run.inputs:
        grey = run.background(run.bounds, picture_shape(run)).filled()
        layers = [PictureOnPage("input", grey), *layers]
    drawn = _Map(run)
    renderers = [drawn.picture(layer) if isinstance(layer, PictureOnPage) else drawn.table(layer) for layer in layers]
    switches = CheckboxButtonGroup(
        labels=[layer.name for layer in layers], active=[k for k, layer in enumerate(layers) if layer.visible]
    )
    switches.js_on_change(
        "active",
        CustomJS(
            args={"renderers": renderers, "switches": switches},
            code="renderers.forEach((renderer, k) => { renderer.visible = switches.active.includes(k) })",
        ),
    )
    notes = drawn.notes + [f"Input raster not found, drawn without it: {location(path)}" for path in run.missing]
    script, parts = components((switches, drawn.plot))
    page = _PAGE.format(
        title=html.escape(title),
        facts=html.escape(facts),
        library=Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render(),
        map="\n".join(parts),
        notes="<br>".join(map(html.escape, notes)),
        tables=_tables(run),
        script=script,
    )
    with run.adding(REPORT) as aside:
        aside.write_text(page, encoding="utf-8")
    return run.folder / REPORT


class _Map:
    """The plot of a page, and what had to be left out of it."""

    def __init__(self, run: FinishedRun) -> None:
        left, bottom, right, top = run.bounds
        self.origin = np.floor(np.array([left, bottom]) / _ORIGIN) * _ORIGIN
        self.corner, self.size = np.array([left, top]) - self.origin, (right - left, top - bottom)
        # No error of rounding is more than a sixth of a pixel.
        self.decimals = max(0, 1 - round(np.log10(run.pixel)))
        self.pixel = run.pixel
        self.notes: list[str] = []
        self.plot: Any = figure(
            x_range=Range1d(start=self.corner[0], end=self.corner[0] + self.size[0]),
            y_range=Range1d(start=self.corner[1] - self.size[1], end=self.corner[1]),
            aspect_ratio=self.size[0] / self.size[1],
            sizing_mode="scale_width",
            tools="pan,wheel_zoom,box_zoom,reset,save",
            active_scroll="wheel_zoom",
            x_axis_label=f"easting ({run.unit})",
            y_axis_label=f"northing ({run.unit})",
            background_fill_color="#eef0f3",
        )
        for axis, origin in zip((self.plot.xaxis, self.plot.yaxis), self.origin.tolist(), strict=True):
            axis.formatter = CustomJSTickFormatter(args={"origin": origin}, code="return String(tick + origin)")
        self.plot.grid.visible = False

    def picture(self, layer: PictureOnPage) -> Any:
        """Draw a layer over the whole map."""
        url = _encode(layer.pixels, "JPEG" if layer.pixels.ndim == 2 else "PNG")
        place = {"x": self.corner[0], "y": self.corner[1], "w": self.size[0], "h": self.size[1], "anchor": "top_left"}
        return self.plot.image_url(url=[url], visible=layer.visible, **place)

    def table(self, layer: TableOnPage) -> Any:
        """Draw a layer with its facts under the mouse."""
        kept, remark = _thinned(layer.table, self.pixel)
        if remark:
            self.notes.append(f"{layer.name.capitalize()}: {remark}")
        columns = {column: name for column, name in layer.columns.items() if column in kept.columns}
        data: dict[str, Any] = {column: [_shown(value) for value in kept[column]] for column in columns}
        style: dict[str, Any] = {"source": data, "color": layer.colour, "visible": layer.visible}
        geometry = kept.geometry.to_numpy()
        dimensions = set(shapely.get_dimensions(geometry))
        if dimensions == {0}:
            data["x"], data["y"] = self._placed(shapely.get_coordinates(geometry))
            renderer = self.plot.scatter("x", "y", size=7, **style | {"line_color": INK})
        elif dimensions == {2}:
            rings, owner = shapely.get_rings(geometry, return_index=True)
            # of each row the polygons, of each polygon the rings
            data["xs"], data["ys"] = ([[[]] for _ in geometry] for _ in range(2))
            for row, (eastings, northings) in zip(owner.tolist(), self._lines(rings), strict=True):
                data["xs"][row][0].append(eastings)
                data["ys"][row][0].append(northings)
            style |= {"fill_alpha": 0.15, "hover_fill_alpha": 0.6, "line_width": 1.5, "hover_color": layer.colour}
            renderer = self.plot.multi_polygons("xs", "ys", **style)
        else:
            data["xs"], data["ys"] = zip(*self._lines(geometry), strict=True) if len(geometry) else ([], [])
            style |= {"line_width": 2.5, "hover_line_color": "#ffffff", "hover_line_width": 5}
            renderer = self.plot.multi_line("xs", "ys", **style)
        if columns:
            tooltips = [("layer", layer.name)] + [(name, f"@{column}") for column, name in columns.items()]
            tool = HoverTool(renderers=[renderer], tooltips=tooltips, description=f"facts of {layer.name}")
            self.plot.add_tools(tool)
        return renderer

    def _lines(self, geometry: Any) -> list[list[list[float]]]:
        """Eastings and northings of each line or ring."""
        return [self._placed(line) for line in coordinates(geometry)]

    def _placed(self, points: NDArray[np.float64]) -> list[list[float]]:
        """Eastings and northings of points (n, 2)."""
        eastings_northings: list[list[float]] = (points - self.origin).round(self.decimals).T.tolist()
        return eastings_northings


def _shown(value: Any) -> str:
    """A fact as text."""
    if value is None or value != value:
        return "–"
    return f"{value:,.4g}" if isinstance(value, float) else str(value)


def _thinned(table: GeoDataFrame, pixel: float) -> tuple[GeoDataFrame, str]:
    """Keep the longest lines, simplified until the page can carry them, and remark what was lost."""
    remarks = []
    table = table[~table.geometry.is_empty].explode(ignore_index=True)
    if len(table) > _MOST_LINES:
        remarks.append(f"the {_MOST_LINES:,} longest of {len(table):,} are shown")
        table = longest(table, _MOST_LINES)
    tolerance = pixel / 4
    while shapely.get_num_coordinates(table.geometry.to_numpy()).sum() > max(_MOST_VERTICES, 2 * len(table)):
        table = table.set_geometry(table.geometry.simplify(tolerance, preserve_topology=False))
        table = table[~table.geometry.is_empty].explode(ignore_index=True)
        note = f"simplified by {tolerance / pixel:g} pixels"
        tolerance *= 2
        remarks = [*(r for r in remarks if not r.startswith("simplified")), note]
    return table, "; ".join(remarks)


def _encode(pixels: NDArray[np.uint8], format: str) -> str:
    """Return a picture as a data URL."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format, quality=85, optimize=True)
    text = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f"data:image/{format.lower()};base64,{text}"


def _tables(run: FinishedRun) -> str:
    """HTML of the timing and parameter tables, as far as the run recorded them."""
    tables = []
    timings = run.folder / TIMINGS
    if timings.is_file():
        rows = list(_flat(_read_timings(timings)))
        seconds = [value for _, value in rows if isinstance(value, int | float)]
        if len(seconds) == len(rows):
            rows.append(("total", sum(seconds)))
        tables.append(_table("Time per stage (s)", rows))
    if run.record:
        tables.append(_table("Parameters", _flat({key: run.record[key] for key in run.record if key != "files"})))
    return "\n".join(tables)


def _read_timings(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is damaged; remove it") from None


def _flat(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Leaves of nested tables with dotted names."""
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(tree, list) and any(isinstance(item, Mapping) for item in tree):
        for number, item in enumerate(tree):
            yield from _flat(item, f"{name}.{number}")
    else:
        yield name, tree


def _table(title: str, rows: Any) -> str:
    cells = []
    for name, value in rows:
        seconds = title.startswith("Time") and isinstance(value, int | float)
        kind = ' class="number"' if seconds else ""
        text = f"{value:,.3f}" if seconds else _text(value)
        cells.append(f"<tr><td>{html.escape(name)}</td><td{kind}>{html.escape(text)}</td></tr>")
    return f"<div><h2>{title}</h2><table>{''.join(cells)}</table></div>"


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
