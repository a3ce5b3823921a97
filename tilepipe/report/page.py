"""Pictures and a map page of a ``streets`` run: ``quicklook.png``, ``quicklook_detail.png``, ``report.html``.

The page is one file that needs no network: pictures and the map library are inside.
"""

from __future__ import annotations

import base64
import html
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.io.atomic import atomic_write
from tilepipe.report.streets import (
    JUNCTION_COLOUR,
    LINE_COLOUR,
    REGION_COLOUR,
    StreetsRun,
    detail,
    grey_background,
    junctions,
    open_run,
    quicklook,
    region_mask,
)

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

__all__ = ["detail", "map_page", "quicklook", "report"]

SKELETON_COLOUR = "#7b2ff7"
_PICTURE_SIDE = 2400
_MOST_LINES = 20_000
_MOST_VERTICES = 200_000
_HOVER = {
    "line_id": "line",
    "length_m": "length (m)",
    "mean_width_m": "width (m)",
    "response": "response",
    "contrast": "contrast",
}

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


def report(run_dir: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> list[Path]:
    """Write the pictures and the map page of a run into its folder.

    Parameters
    ----------
    run_dir
        Folder of a finished ``streets`` run.
    rasters
        Its input rasters; by default those recorded in ``run.toml``.

    Returns
    -------
    list of Path
        The three files written.

    Raises
    ------
    InputError
        The folder is not that of a finished run, or cannot be written.
    """
    return [quicklook(run_dir, rasters), detail(run_dir, rasters), map_page(run_dir, rasters)]


def map_page(run_dir: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> Path:
    """Write ``report.html``: a map with layers to switch, facts of the line under the mouse, and tables.

    Lines beyond the longest 20,000 of a layer are left out, and the others simplified until a layer has no
    more than 200,000 vertices; the page says so. Parameters as in `report`; returns the path.
    """
    from bokeh.embed import components
    from bokeh.resources import Resources

    run = open_run(run_dir, rasters)
    plot, switches, notes = _map(run)
    script, parts = components((switches, plot))
    notes += [f"Input raster not found, drawn without it: {path}" for path in run.missing]
    title = f"Street centerlines: {run.folder.resolve().name}"
    page = _PAGE.format(
        title=html.escape(title),
        facts=html.escape(run.facts),
        library=Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).render(),
        map="\n".join(parts),
        notes="<br>".join(map(html.escape, notes)),
        tables=_tables(run),
        script=script,
    )
    with atomic_write(run.folder / "report.html") as aside:
        aside.write_text(page, encoding="utf-8")
    return run.folder / "report.html"


def _map(run: StreetsRun) -> tuple[Any, Any, list[str]]:
    """Make the plot, its layer switches, and what had to be left out."""
    from bokeh import plotting
    from bokeh.models.callbacks import CustomJS
    from bokeh.models.formatters import BasicTickFormatter
    from bokeh.models.ranges import Range1d
    from bokeh.models.widgets import CheckboxButtonGroup

    left, bottom, right, top = run.bounds
    plot = plotting.figure(
        x_range=Range1d(start=left, end=right),
        y_range=Range1d(start=bottom, end=top),
        aspect_ratio=(right - left) / (top - bottom),
        sizing_mode="scale_width",
        tools="pan,wheel_zoom,box_zoom,reset,save",
        active_scroll="wheel_zoom",
        x_axis_label=f"easting ({run.unit})",
        y_axis_label=f"northing ({run.unit})",
        background_fill_color="#eef0f3",
    )
    plot.axis.formatter = BasicTickFormatter(use_scientific=False)
    plot.grid.visible = False
    rows, columns = run.shape
    scale = min(1.0, _PICTURE_SIDE / max(rows, columns))
    shape = (max(round(rows * scale), 1), max(round(columns * scale), 1))
    layers: dict[str, Any] = {}
    notes: list[str] = []
    layers["input"] = _picture(plot, run, _encode(grey_background(run, run.bounds, shape), "JPEG"))
    layers["street regions"] = _picture(plot, run, _encode(_tint(region_mask(run, run.bounds, shape)), "PNG"))
    if run.skeleton is not None:
        layers["skeleton"] = _lines(plot, run, run.skeleton, SKELETON_COLOUR, "skeleton", notes)
        layers["skeleton"].visible = False
    layers["centerlines"] = _lines(plot, run, run.centerlines, LINE_COLOUR, "centerlines", notes)
    points = junctions(run.centerlines)[:_MOST_LINES]
    layers["junctions"] = plot.scatter(
        points[:, 0].tolist(),
        points[:, 1].tolist(),
        size=7,
        fill_color=JUNCTION_COLOUR,
        line_color="#1d2433",
    )
    renderers = list(layers.values())
    switches = CheckboxButtonGroup(
        labels=list(layers), active=[k for k, renderer in enumerate(renderers) if renderer.visible]
    )
    switches.js_on_change(
        "active",
        CustomJS(
            args={"renderers": renderers, "switches": switches},
            code="renderers.forEach((renderer, k) => { renderer.visible = switches.active.includes(k) })",
        ),
    )
    return plot, switches, notes


def _picture(plot: Any, run: StreetsRun, url: str) -> Any:
    left, bottom, right, top = run.bounds
    return plot.image_url(url=[url], x=left, y=top, w=right - left, h=top - bottom, anchor="top_left")


def _lines(plot: Any, run: StreetsRun, table: GeoDataFrame, colour: str, name: str, notes: list[str]) -> Any:
    """Draw a layer of lines with its facts under the mouse."""
    import shapely
    from bokeh.models.tools import HoverTool

    kept, remark = _thinned(table, run.pixel)
    if remark:
        notes.append(f"{name.capitalize()}: {remark}")
    decimals = max(0, 2 - round(np.log10(run.pixel)))
    parts = [shapely.get_coordinates(line).round(decimals) for line in kept.geometry]
    data: dict[str, Any] = {
        "xs": [part[:, 0].tolist() for part in parts],
        "ys": [part[:, 1].tolist() for part in parts],
    }
    shown = [column for column in _HOVER if column in kept.columns]
    for column in shown:
        data[column] = [_shown(column, value) for value in kept[column]]
    renderer = plot.multi_line(
        "xs", "ys", source=data, color=colour, line_width=2.5, hover_line_color="#ffffff", hover_line_width=5
    )
    tooltips = [("layer", name)] + [(_HOVER[column], f"@{column}") for column in shown]
    plot.add_tools(HoverTool(renderers=[renderer], tooltips=tooltips, description=f"facts of {name}"))
    return renderer


def _shown(column: str, value: Any) -> str:
    """A fact as text; GeoJSON knows no NaN and gives None."""
    if value is None:
        return "–"
    return str(value) if column == "line_id" else f"{value:,.4g}"


def _thinned(table: GeoDataFrame, pixel: float) -> tuple[GeoDataFrame, str]:
    """Keep the longest lines, simplified until the page can carry them, and remark what was lost."""
    import shapely

    remarks = []
    table = table.explode(ignore_index=True)
    if len(table) > _MOST_LINES:
        longest = np.sort(np.argsort(-table.length.to_numpy(), kind="stable")[:_MOST_LINES])
        remarks.append(f"the {_MOST_LINES:,} longest of {len(table):,} lines are shown")
        table = table.iloc[longest]
    tolerance = pixel / 4
    while shapely.get_num_coordinates(table.geometry.to_numpy()).sum() > max(_MOST_VERTICES, 2 * len(table)):
        table = table.set_geometry(table.geometry.simplify(tolerance, preserve_topology=False))
        note = f"lines are simplified by {tolerance / pixel:g} pixels"
        tolerance *= 2
        remarks = [*(r for r in remarks if not r.startswith("lines")), note]
    return table, "; ".join(remarks)


def _tint(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """RGBA picture (rows, columns, 4) of a mask."""
    from matplotlib.colors import to_rgb

    colour = [*(round(255 * part) for part in to_rgb(REGION_COLOUR)), 110]
    return np.where(mask[..., None], np.array(colour, np.uint8), np.uint8(0))


def _encode(pixels: NDArray[np.uint8], format: str) -> str:
    """Return a picture as a data URL."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format, quality=85, optimize=True)
    text = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f"data:image/{format.lower()};base64,{text}"


def _tables(run: StreetsRun) -> str:
    """HTML of the timing and parameter tables, as far as the run recorded them."""
    tables = []
    timings = run.folder / "timings.json"
    if timings.is_file():
        rows = list(_flat(json.loads(timings.read_text(encoding="utf-8"))))
        seconds = [value for _, value in rows if isinstance(value, int | float)]
        if len(seconds) == len(rows):
            rows.append(("total", sum(seconds)))
        tables.append(_table("Time per stage (s)", rows))
    if run.settings:
        tables.append(_table("Parameters", _flat(run.settings)))
    return "\n".join(tables)


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
