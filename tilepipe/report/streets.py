"""Pictures of a ``streets`` run: the input in grey, regions tinted, centerlines and junctions drawn."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    recorded_inputs,
    write_header,
)

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REGION_COLOUR = "#00a6d6"
LINE_COLOUR = "#ff3d14"
JUNCTION_COLOUR = "#ffd60a"
_LONGEST_SIDE = 1800
_DETAIL_PIXELS = 1000


@dataclass(frozen=True)
class StreetsRun:
    """What the pictures and the page need of a run's folder.

    Attributes
    ----------
    bounds
        Left, bottom, right, top of ``streets.tif`` in CRS units.
    shape
        Rows and columns of ``streets.tif``.
    unit, metres
        Name of the CRS unit and its length in metres.
    rasters
        Input rasters that still exist; `missing` names the others.
    settings
        Content of ``run.toml``, empty when there is none.
    """

    folder: Path
    bounds: Bounds
    shape: tuple[int, int]
    crs_name: str
    unit: str
    metres: float
    centerlines: GeoDataFrame
    skeleton: GeoDataFrame | None
    rasters: tuple[Path, ...]
    missing: tuple[Path, ...]
    settings: dict[str, Any]

    @property
    def pixel(self) -> float:
        """Side of a pixel in CRS units."""
        return (self.bounds[2] - self.bounds[0]) / self.shape[1]

    @property
    def facts(self) -> str:
        """One line of text: what the run found."""
        kilometres = float(self.centerlines.length.sum()) * self.metres / 1000
        return (
            f"{len(self.centerlines):,} centerlines, {kilometres:,.1f} km   |   "
            f"{self.shape[1]:,} × {self.shape[0]:,} pixels of {self.pixel * self.metres:.2f} m"
            f"   |   {self.crs_name}"
        )


def open_run(run_dir: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> StreetsRun:
    """Read a finished ``streets`` run.

    Parameters
    ----------
    run_dir
        The folder with ``streets.tif`` and the centerlines, in any format.
    rasters
        The input rasters; by default those recorded in ``run.toml``, looked up from here and from the folder.

    Raises
    ------
    InputError
        The folder is not that of a finished run.
    """
    import rasterio

    from tilepipe.io.tables import metres_per_unit, read_vectors, run_table

    folder = Path(run_dir)
    table = run_table(folder, "centerlines")
    if table is None or not (folder / "streets.tif").is_file():
        raise InputError(f"{folder} holds no streets.tif with centerlines; give the folder of a finished streets run")
    settings: dict[str, Any] = {}
    if (folder / "run.toml").is_file():
        settings = tomllib.loads((folder / "run.toml").read_text(encoding="utf-8"))
    named = rasters if rasters is not None else settings.get("inputs", {}).get("rasters", [])
    paths = recorded_inputs(folder, named)
    with rasterio.open(folder / "streets.tif") as regions:
        bounds, shape, crs = tuple(regions.bounds), (regions.height, regions.width), regions.crs
    metres = metres_per_unit(crs, str(folder / "streets.tif"))
    centerlines = read_vectors(table, "result").to_crs(crs)
    other = run_table(folder, "skeleton")
    return StreetsRun(
        folder=folder,
        bounds=bounds,
        shape=shape,
        crs_name=centerlines.crs.name,
        unit=centerlines.crs.axis_info[0].unit_name if centerlines.crs.axis_info else "metre",
        metres=metres,
        centerlines=centerlines,
        skeleton=None if other is None else read_vectors(other, "result").to_crs(crs),
        rasters=tuple(path for path in paths if path.exists()),
        missing=tuple(path for path in paths if not path.exists()),
        settings=settings,
    )


def quicklook(run_dir: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> Path:
    """Draw a run as ``quicklook.png`` (at most 2000 pixels a side) into its folder; returns the path.

    Rasters are read decimated, through their overviews where they have some. Parameters as in `open_run`.
    """
    run = open_run(run_dir, rasters)
    return _draw(run, run.bounds, "quicklook.png", _title(run), run.facts, frame=_busiest_window(run))


def detail(run_dir: str | os.PathLike[str], rasters: Sequence[str | os.PathLike[str]] | None = None) -> Path:
    """Draw the 1000 x 1000 pixels that hold most centerline as ``quicklook_detail.png``; returns the path."""
    run = open_run(run_dir, rasters)
    window = _busiest_window(run) or run.bounds
    rows, columns = _pixels(run, window)
    facts = f"the {columns:,} × {rows:,} pixels with most centerline   |   {run.crs_name}"
    return _draw(run, window, "quicklook_detail.png", f"{_title(run)}, detail", facts)


def grey_background(run: StreetsRun, bounds: Bounds, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read the input rasters as one grey picture (rows, columns), stretched to percentiles 2 and 98.

    Pixels without data are 128, so that gaps between laser points do not glitter.
    """
    mosaic = np.full(shape, np.nan, np.float32)
    for path in run.rasters:
        _paste(path, mosaic, bounds)
    known = np.isfinite(mosaic)
    if not known.any():
        return np.full(shape, 128, np.uint8)
    low, high = np.percentile(mosaic[known], (2, 98))
    scaled = np.clip((mosaic - low) / max(high - low, 1e-12), 0, 1)
    return np.where(known, 20 + 215 * scaled, 128).astype(np.uint8)


def region_mask(run: StreetsRun, bounds: Bounds, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Where ``streets.tif`` has a region, nearest pixel, on a picture of `shape` (rows, columns)."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import from_bounds

    with rasterio.open(run.folder / "streets.tif") as regions:
        window = from_bounds(*bounds, transform=regions.transform)
        ids = regions.read(1, window=window, out_shape=shape, resampling=Resampling.nearest)
        mask: NDArray[np.bool_] = (ids != 0) & (ids != regions.nodata)
    return mask


def junctions(lines: GeoDataFrame) -> NDArray[np.float64]:
    """Points (n, 2) where three or more line ends meet, by node ids or else by equal coordinates."""
    import shapely

    geometry = lines.geometry.to_numpy()
    ends = np.concatenate([shapely.get_point(geometry, 0), shapely.get_point(geometry, -1)])
    points: NDArray[np.float64] = shapely.get_coordinates(ends)
    if len(points) == 0:
        return points
    if {"from_node", "to_node"} <= set(lines.columns):
        nodes = np.concatenate([lines["from_node"].to_numpy(), lines["to_node"].to_numpy()])
        _, first, count = np.unique(nodes, return_index=True, return_counts=True)
    else:
        _, first, count = np.unique(points, axis=0, return_index=True, return_counts=True)
    met: NDArray[np.float64] = points[first[count >= 3]]
    return met


def _title(run: StreetsRun) -> str:
    return f"Street centerlines: {run.folder.resolve().name}"


def _pixels(run: StreetsRun, bounds: Bounds) -> tuple[int, int]:
    return round((bounds[3] - bounds[1]) / run.pixel), round((bounds[2] - bounds[0]) / run.pixel)


def _paste(path: Path, mosaic: NDArray[np.float32], bounds: Bounds) -> None:
    """Read what `path` shows of `bounds`, decimated, into `mosaic` in place."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import from_bounds

    rows, columns = mosaic.shape
    step_x, step_y = (bounds[2] - bounds[0]) / columns, (bounds[3] - bounds[1]) / rows
    with rasterio.open(path) as raster:
        left, right = max(bounds[0], raster.bounds.left), min(bounds[2], raster.bounds.right)
        bottom, top = max(bounds[1], raster.bounds.bottom), min(bounds[3], raster.bounds.top)
        column0, column1 = round((left - bounds[0]) / step_x), round((right - bounds[0]) / step_x)
        row0, row1 = round((bounds[3] - top) / step_y), round((bounds[3] - bottom) / step_y)
        if column1 <= column0 or row1 <= row0:
            return
        bands = [1, 2, 3] if raster.count >= 3 else [1]
        values = raster.read(
            bands,
            window=from_bounds(left, bottom, right, top, transform=raster.transform),
            out_shape=(len(bands), row1 - row0, column1 - column0),
            resampling=Resampling.average,
            masked=True,
        )
    grey = values.astype(np.float32).mean(axis=0).filled(np.nan)
    part = mosaic[row0:row1, column0:column1]
    np.copyto(part, grey, where=np.isfinite(grey))


def _busiest_window(run: StreetsRun) -> Bounds | None:
    """Find the 1000 x 1000 pixels with most centerline; None when the raster is hardly larger."""
    return busiest_window(run.centerlines, run.bounds, run.shape, _DETAIL_PIXELS)


def _draw(run: StreetsRun, bounds: Bounds, name: str, title: str, facts: str, frame: Bounds | None = None) -> Path:
    """Draw one picture of `bounds` with header and footer into the run's folder."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = _pixels(run, bounds)
    scale = _LONGEST_SIDE / max(rows, columns)
    # Small rasters are enlarged, but not to blurs.
    scale = min(scale, max(1.0, 1000 / max(rows, columns)))
    height, width = max(round(rows * scale), 1), max(round(columns * scale), 1)
    canvas_width = max(width + 2 * MARGIN, 1000)
    canvas_height = height + HEADER + FOOTER
    figure = Figure(figsize=(canvas_width / DPI, canvas_height / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left = (canvas_width - width) / 2 / canvas_width
    axes = figure.add_axes((left, FOOTER / canvas_height, width / canvas_width, height / canvas_height))
    _draw_map(axes, run, bounds, (height, width), frame)
    write_header(figure, left, canvas_height, title, facts)
    _draw_legend(figure, axes)
    draw_scale_bar(figure, left + width / canvas_width, width / canvas_width, bounds, run.metres)
    with atomic_write(run.folder / name) as aside:
        figure.savefig(aside, dpi=DPI, metadata={"Software": None})
    return run.folder / name


def _draw_map(axes: Axes, run: StreetsRun, bounds: Bounds, shape: tuple[int, int], frame: Bounds | None) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgb

    extent = (bounds[0], bounds[2], bounds[1], bounds[3])
    axes.imshow(grey_background(run, bounds, shape), cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto")
    tint = np.zeros((*shape, 4), np.float32)
    tint[..., :3] = to_rgb(REGION_COLOUR)
    tint[..., 3] = 0.4 * region_mask(run, bounds, shape)
    axes.imshow(tint, extent=extent, aspect="auto", interpolation="nearest")
    # Many lines on few pixels want a finer pen.
    metres_per_pixel = (bounds[2] - bounds[0]) * run.metres / shape[1]
    pen = float(np.clip(2.4 - 0.25 * metres_per_pixel, 0.8, 2.4))
    lines = [part for line in run.centerlines.geometry for part in _vertices(line)]
    axes.add_collection(LineCollection(lines, colors="white", linewidths=pen + 1.6, alpha=0.75, capstyle="round"))
    axes.add_collection(LineCollection(lines, colors=LINE_COLOUR, linewidths=pen, capstyle="round"))
    points = junctions(run.centerlines)
    size = (pen + 3.2) ** 2
    axes.scatter(points[:, 0], points[:, 1], s=size, c=JUNCTION_COLOUR, edgecolors=INK, linewidths=0.9, zorder=4)
    if frame is not None:
        draw_frame(axes, frame)
    axes.set_xlim(bounds[0], bounds[2])
    axes.set_ylim(bounds[1], bounds[3])
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(INK)
        spine.set_linewidth(0.8)


def _vertices(line: Any) -> list[NDArray[np.float64]]:
    import shapely

    return [shapely.get_coordinates(part) for part in shapely.get_parts(line)]


def _draw_legend(figure: Figure, axes: Axes) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dot = {"marker": "o", "markersize": 7, "markeredgecolor": INK, "linestyle": "none"}
    entries = [
        Line2D([], [], color=LINE_COLOUR, linewidth=3, label="centerline"),
        Line2D([], [], markerfacecolor=JUNCTION_COLOUR, label="junction", **dot),  # type: ignore[arg-type]
        Patch(facecolor=REGION_COLOUR, alpha=0.5, label="street region"),
    ]
    if axes.patches:
        entries.append(Line2D([], [], color=INK, linewidth=1.4, linestyle=(0, (4, 2)), label="detail picture"))
    box = axes.get_position()
    figure.legend(
        handles=entries,
        loc="center left",
        bbox_to_anchor=(box.x0 - 0.006, box.y0 / 2),
        ncols=len(entries),
        frameon=False,
        fontsize=11.5,
        labelcolor=INK,
        columnspacing=1.6,
    )
