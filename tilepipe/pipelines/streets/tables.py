"""The street graph of `streets`: fragments of all tiles joined to lines with their attributes."""

from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.vectors.geometries import line_strings
from tilepipe.io.vectors.geoparquet import ParquetLineWriter
from tilepipe.pipelines.streets.layers import CENTERLINES, SKELETON
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.pipelines.streets.pass_lines import AXIS, RIDGE
from tilepipe.pipelines.streets.pass_responses import Thresholds
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import reduce_runs, run_of_rows
from tilepipe_kernels.network.build import LineBatch, build_network, iterate_lines
from tilepipe_kernels.network.cleaning import Cleaning, raster_border
from tilepipe_kernels.network.fragment_table import summarise
from tilepipe_kernels.network.tracing import Fragments
from tilepipe_kernels.ridges.bar_profile import position_standard_error

_TILES_IN_MEMORY = 8
_END_POINTS = 20
"""Points at each end of a line over which its end widths are taken."""

_LAYERS = {RIDGE: CENTERLINES, AXIS: SKELETON}
"""Layers of the two ways to centerlines, by the prefix of their facts."""


class FragmentReader:
    """Reads the fragments of one way to centerlines from a ledger, the last few tiles kept in memory."""

    def __init__(self, ledger: Ledger, grid: TileGrid, prefix: str) -> None:
        self.ledger, self.grid, self.prefix = ledger, grid, prefix
        self.cache: OrderedDict[int, tuple[Fragments, dict[str, NDArray[np.float32]]]] = OrderedDict()

    def __call__(self, tile: int) -> tuple[Fragments, dict[str, NDArray[np.float32]]]:
        """Fragments of a tile and the attributes of their points."""
        if tile in self.cache:
            self.cache.move_to_end(tile)
            return self.cache[tile]
        named = self.ledger.facts(self.grid.tile(tile).name, f"{self.prefix}:")
        start = f"{self.prefix}:at:"
        attributes = {name.removeprefix(start): v for name, v in named.items() if name.startswith(start)}
        fields = {name: named[f"{self.prefix}:{name}"] for name in Fragments.__dataclass_fields__}
        self.cache[tile] = Fragments(**fields), attributes
        if len(self.cache) > _TILES_IN_MEMORY:
            self.cache.popitem(last=False)
        return self.cache[tile]


@dataclass(frozen=True)
class LineScale:
    """What turns pixels and grey levels of lines into metres.

    ``sigma`` is the scale of the ridge lines in pixels and ``noise`` the standard deviation of the grey levels.
    """

    geometry: Geometry
    sigma: float
    noise: float
    simplification: float


def write_lines(run: Work, fragments: Ledger, thresholds: Thresholds) -> list[Path]:
    """Write the tables of both ways to centerlines into the state folder, side by side."""
    scale = LineScale(run.geometry, thresholds.sigma, thresholds.noise, run.parameters.simplification)

    def write(prefix: str) -> Path:
        layer = _LAYERS[prefix]
        with run.timed(f"reconcile {layer.name}"):
            path = run.folder / f"{layer.name}.parquet"
            cleaning, margin = _network_cleaning(run, prefix, thresholds)
            write_centerlines(path, fragments, run.grid, prefix, cleaning, scale, margin)
            return path

    with ThreadPoolExecutor(min(len(_LAYERS), run.options.resolved_workers)) as pool:
        return run.in_format(list(pool.map(write, _LAYERS)))


def _network_cleaning(run: Work, prefix: str, thresholds: Thresholds) -> tuple[Cleaning, int]:
    """Cleaning of one way to centerlines in pixels, and the width of the raster's border zone."""
    p: StreetParameters = run.parameters
    pixels = 1 / run.resolution
    cleaning = Cleaning(
        contraction=max(2.0, p.junction_distance * pixels),
        maximum_gap=p.maximum_gap * pixels,
        maximum_angle=min(max(p.maximum_gap_angle, 1.0), 89.0),
        minimum_branch=p.minimum_branch * pixels,
        minimum_length=p.minimum_length * pixels,
    )
    if prefix == RIDGE:
        return replace(cleaning, high=thresholds.high), int(np.ceil(thresholds.sigma))
    return cleaning, 2


def write_centerlines(
    path: Path,
    ledger: Ledger,
    grid: TileGrid,
    prefix: str,
    cleaning: Cleaning,
    scale: LineScale,
    margin: int,
) -> int:
    """Build the street graph and write its lines.

    Parameters
    ----------
    path
        GeoParquet file to write.
    ledger, grid, prefix
        Where the fragments lie.
    cleaning
        How the graph is cleaned.
    scale
        Pixels and greys in metres.
    margin
        Line ends this near to the raster's border (pixels) are cut off there and do not dangle.

    Returns
    -------
    int
        Number of lines written.
    """
    reader = FragmentReader(ledger, grid, prefix)
    width = grid.shape[1]
    tables = []
    for number in range(len(grid)):
        fragments, attributes = reader(number)
        tables.append(summarise(fragments, width, attributes.get("response")))
    network = build_network(tables, width, reader, cleaning, raster_border(grid.shape, margin))
    with ParquetLineWriter(path, _LAYERS[prefix].dtypes, scale.geometry.crs) as writer:
        for batch in iterate_lines(network, reader):
            columns = line_columns(batch, scale)
            lines = replace(batch.polylines, vertices=_map_coordinates(batch.polylines.vertices, scale.geometry))
            writer.append(columns, _simplified(lines, scale))
    return len(network)


def _map_coordinates(xy: NDArray[np.float64], geometry: Geometry) -> NDArray[np.float64]:
    """Pixels from the upper left corner as coordinates of the raster's CRS."""
    return np.stack([geometry.left + xy[:, 0] * geometry.pixel, geometry.top - xy[:, 1] * geometry.pixel], axis=1)


def _simplified(polylines: Polylines, scale: LineScale) -> Polylines:
    """Lines with fewer vertices, none farther off than the tolerance; their ends stay where they are."""
    import shapely

    if scale.simplification == 0 or len(polylines) == 0:
        return polylines
    tolerance = scale.simplification / scale.geometry.metres
    lines, ring = line_strings(polylines), polylines.closed
    # the plain algorithm is faster, but could collapse a small ring
    lines[ring] = shapely.simplify(lines[ring], tolerance, preserve_topology=True)
    lines[~ring] = shapely.simplify(lines[~ring], tolerance, preserve_topology=False)
    _, vertices, (starts,) = shapely.to_ragged_array(lines)
    return Polylines(np.asarray(starts, np.int64), vertices)


def line_columns(batch: LineBatch, scale: LineScale) -> dict[str, NDArray[Any]]:
    """Attributes of the lines of a batch, each from its own points in their order.

    Returns
    -------
    dict
        The columns of the layer; lengths in metres, NaN where no point of a line has a value.
    """
    offsets, xy, metres = batch.polylines.offsets, batch.polylines.vertices, scale.geometry.resolution
    step = np.hypot(*np.diff(xy, axis=0).T) if len(xy) else np.empty(0)
    step = np.concatenate([step, [0.0]])
    step[offsets[1:] - 1] = 0.0
    width = batch.attributes["width"].astype(np.float64) * metres
    response = batch.attributes["response"].astype(np.float64)
    response[response <= 0] = np.nan
    error = position_standard_error(response, scale.sigma, scale.noise) * metres
    line = run_of_rows(offsets)
    first, last = offsets[:-1][line], offsets[1:][line] - 1
    place = np.arange(offsets[-1])
    return {
        "line_id": batch.line,
        "from_node": batch.start,
        "to_node": batch.end,
        "length_m": reduce_runs(np.add, step, offsets) * metres,
        "mean_width_m": _means(width, offsets),
        "start_width_m": _means(np.where(place - first < _END_POINTS, width, np.nan), offsets),
        "end_width_m": _means(np.where(last - place < _END_POINTS, width, np.nan), offsets),
        "response": _means(response, offsets),
        "contrast": _means(batch.attributes["contrast"].astype(np.float64), offsets),
        "position_standard_error_m": _means(error, offsets),
        "region_id": _most_frequent(batch.attributes["region"].astype(np.int64), line, len(batch.line)),
    }


def _means(values: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean of each group without its NaN."""
    valid = ~np.isnan(values)
    count = reduce_runs(np.add, valid.astype(np.float64), offsets)
    total = reduce_runs(np.add, np.where(valid, values, 0.0), offsets)
    means = np.full(count.shape, np.nan)
    np.divide(total, count, out=means, where=count > 0)
    return means


def _most_frequent(values: NDArray[np.int64], group: NDArray[np.int64], groups: int) -> NDArray[np.int64]:
    """Most frequent positive value of each group, the lowest of equals; 0 where there is none."""
    keys, count = np.unique((group << 32 | values)[values > 0], return_counts=True)
    group, value = keys >> 32, keys & 0xFFFFFFFF
    # sorted so that the winner of each group comes last
    order = np.lexsort((-value, count, group))
    result = np.zeros(groups, np.int64)
    result[group[order]] = value[order]
    return result
