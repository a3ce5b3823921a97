"""Pictures of any run, from its layers alone: a pipeline that declares these is drawn without code of its own."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray
from skimage.color import label2rgb

from tilepipe.io.vectors.gdal_tables import SUFFIX
from tilepipe.report.finished_run import FinishedRun, open_folder
from tilepipe.report.frame import QUICKLOOK, Picture
from tilepipe.report.map import Map, coloured
from tilepipe.report.map_page import PictureOnPage, TableOnPage, picture_shape, write_map_page

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

TABLE_COLOURS = ("#ff3d14", "#0a84ff", "#ffc400", "#7b2ff7", "#00a676")
LABEL_COLOURS = colormaps["tab10"].colors  # type: ignore[attr-defined]
_SCALE = "viridis"
_OPACITY = 0.45
_MOST_COLUMNS = 6


def pictures(
    folder: str | os.PathLike[str],
    rasters: Sequence[str | os.PathLike[str]] | None = None,
    layers: Sequence[str] | None = None,
) -> list[Path]:
    """Draw a finished run of any pipeline into its folder, and its map page.

    The input is the background. Over it lies the first raster layer: labels in colours, 0 being none, or numbers by a
    colour scale. The page has the other raster layers too. Tables of lines and polygons lie on top.

    Parameters
    ----------
    folder
        Of the run.
    rasters
        Its input rasters; by default those recorded in ``run.toml``.
    layers
        Files of rasters (``heights.tif``) and names of tables of lines or polygons (``ridges``), from the lowest to
        the top; those that the folder lacks are left out. By default all that the folder holds.

    Returns
    -------
    list of Path
        ``quicklook.png`` and ``report.html``.

    Raises
    ------
    InputError
        The folder is not that of a finished run, or cannot be written.
    """
    folder = Path(folder)
    names = _held(folder) if layers is None else layers
    grids = [name for name in names if name.endswith(".tif") and (folder / name).is_file()]
    run = open_folder(folder, grids[0] if grids else None, rasters)
    found = {name: run.optional_table(name) for name in names if not name.endswith(".tif")}
    tables = {name: table for name, table in found.items() if table is not None}
    title = f"{run.record.get('command', 'Run').capitalize()}: {run.name}"
    facts = run.facts(", ".join(f"{len(table):,} {_spoken(name)}" for name, table in tables.items()))
    return [_draw(run, grids[:1], tables).save(QUICKLOOK, title, facts), _page(run, grids, tables, title, facts)]


def _held(folder: Path) -> list[str]:
    """Raster files and tables of a folder."""
    files = sorted(file for file in folder.iterdir() if file.is_file())
    tables = {file.stem: None for file in files if file.suffix in SUFFIX.values()}
    return [*(file.name for file in files if file.suffix == ".tif"), *tables]


def _draw(run: FinishedRun, grids: Sequence[str], tables: dict[str, GeoDataFrame]) -> Picture:
    picture = Picture(run, bars=any(run.raster(name, run.bounds, (1, 1)).dtype.kind == "f" for name in grids))
    (drawn,) = picture.maps
    drawn.grey(run.background(picture.bounds, drawn.shape).filled())
    for name in grids:
        _draw_raster(drawn, name, run.raster(name, picture.bounds, drawn.shape))
    for (name, table), colour in zip(tables.items(), itertools.cycle(TABLE_COLOURS), strict=False):
        drawn.lines(table, colour, _spoken(name))
    return picture


def _draw_raster(drawn: Map, name: str, values: np.ma.MaskedArray[Any, Any]) -> None:
    if values.dtype.kind == "f":
        drawn.scale(values.filled(np.nan), _SCALE, _spoken(name), opacity=_OPACITY)
        return
    drawn.image(labelled(values), interpolation="nearest")
    labels = np.unique(values.filled(0))
    labels = labels[labels != 0]
    if len(labels) == 0:
        return
    few = len(labels) <= len(LABEL_COLOURS)
    meaning = f"{_spoken(name)} {', '.join(map(str, labels))}" if few else f"{_spoken(name)}, by number"
    drawn.swatches.append(([to_hex(colour) for colour in LABEL_COLOURS[: len(labels)]], meaning))


def labelled(labels: np.ma.MaskedArray[Any, Any]) -> NDArray[np.uint8]:
    """Picture (rows, columns, 4) of labels in colours that repeat; 0 and what is masked is transparent."""
    known = labels.filled(0)
    colours = label2rgb(known, colors=LABEL_COLOURS, bg_label=0)  # type: ignore[no-untyped-call]
    return np.dstack([(255 * colours).astype(np.uint8), np.where(known, np.uint8(255 * _OPACITY), np.uint8(0))])


def _spoken(name: str) -> str:
    """The name of a layer in words."""
    return Path(name).stem.replace("_", " ")


def _page(run: FinishedRun, grids: Sequence[str], tables: dict[str, GeoDataFrame], title: str, facts: str) -> Path:
    shape = picture_shape(run)
    layers: list[PictureOnPage | TableOnPage] = []
    for name in grids:
        values = run.raster(name, run.bounds, shape)
        pixels = coloured(values.filled(np.nan), _SCALE) if values.dtype.kind == "f" else labelled(values)
        layers.append(PictureOnPage(_spoken(name), pixels, visible=name == grids[0]))
    for (name, table), colour in zip(tables.items(), itertools.cycle(TABLE_COLOURS), strict=False):
        columns = {column: column for column in table.columns.drop(table.geometry.name)[:_MOST_COLUMNS]}
        layers.append(TableOnPage(_spoken(name), table, colour, columns))
    return write_map_page(run, title, facts, layers)
