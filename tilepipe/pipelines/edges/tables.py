"""The two tables of `edges`: polylines of the line field, and the lines of the classical method."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.io.geoparquet import ParquetLineWriter
from tilepipe.io.georeference import Geometry
from tilepipe.pipelines.edges.layers import EDGES, NEVATIA_BABU
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_fields import ELEMENT_COLUMNS, PIECE_COLUMNS
from tilepipe.pipelines.edges.reconcile_lines import find_streets, smoothed
from tilepipe.tiling.facts import Facts
from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.nevatia_babu import elements as nevatia_babu
from tilepipe_kernels.nevatia_babu import links, tracing
from tilepipe_kernels.nevatia_babu.links import EdgeElements
from tilepipe_kernels.polylines.crack_lines import TICKS, LinePieces
from tilepipe_kernels.polylines.join import Chains, Lines, end_points, join_lines, place_numbers, taken

_WITHOUT_LINES = {
    EDGES.name: "lower minimum_length or raise levels (--set)",
    NEVATIA_BABU.name: "raise edge_share or lower minimum_edge_length (--set)",
}
"""What to do when a table has no line."""


class Shape(NamedTuple):
    """Shape of lines, float64 each.

    Attributes
    ----------
    length
        In the unit of the vertices.
    straightness
        1 where all parts point the same way or the opposite one, 0 where they point everywhere.
    sinuosity
        Length over the distance of the ends; NaN of closed lines.
    """

    length: NDArray[np.float64]
    straightness: NDArray[np.float64]
    sinuosity: NDArray[np.float64]


def line_shape(offsets: NDArray[np.int64], vertices: NDArray[np.float64]) -> Shape:
    """Shape of polylines; line i has ``vertices[offsets[i]:offsets[i + 1]]``, shape (m, 2), of length > 0."""
    if offsets.size < 2:
        return Shape(*np.empty((3, 0)))
    steps = np.diff(vertices, axis=0, prepend=vertices[:1])
    steps[offsets[:-1]] = 0
    lengths = np.hypot(*steps.T)
    # the doubled angle of a part has the cosine (x² - y²) / l² and the sine 2 x y / l²
    per_length = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    cosine, sine = (steps[:, 1] ** 2 - steps[:, 0] ** 2) * per_length, 2 * steps[:, 0] * steps[:, 1] * per_length
    length, cosine, sine = (np.add.reduceat(values, offsets[:-1]) for values in (lengths, cosine, sine))
    ends = np.hypot(*(vertices[offsets[1:] - 1] - vertices[offsets[:-1]]).T)
    sinuosity = np.divide(length, ends, out=np.full_like(length, np.nan), where=ends > 0)
    return Shape(length, np.hypot(cosine, sine) / length, np.maximum(sinuosity, 1.0))


def shape_columns(shape: Shape, geometry: Geometry) -> dict[str, NDArray[Any]]:
    """Attributes of a shape measured in pixels."""
    return {
        "length_m": shape.length * geometry.resolution,
        "straightness": shape.straightness,
        "sinuosity": shape.sinuosity,
    }


@loop
def _group_lengths(places: NDArray[np.int64], lengths: NDArray[np.float64], sums: NDArray[np.float64]) -> None:
    """Length of the group of each chain; `places` holds the numbers of its two ends, 0 to 2 n - 1."""
    parent = np.arange(2 * lengths.size)
    for i in range(lengths.size):
        a, b = places[2 * i], places[2 * i + 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        parent[max(a, b)] = min(a, b)
    totals = np.zeros(parent.size)
    # a parent is never the larger number, so that those before have found theirs
    for place in range(parent.size):
        parent[place] = parent[parent[place]]
    for i in range(lengths.size):
        totals[parent[places[2 * i]]] += lengths[i]
    for i in range(lengths.size):
        sums[i] = totals[parent[places[2 * i]]]


def long_groups(chains: Chains, lengths: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Chains of groups that are ``least`` long together; chains that meet at an end, a whole corner, are of one."""
    ends = place_numbers(end_points(chains.offsets, chains.vertices))
    sums = np.empty(len(chains))
    _group_lengths(np.unique(ends, return_inverse=True)[1], np.asarray(lengths, np.float64), sums)
    return sums >= least


def write_tables(run: Work, fields: Ledger) -> list[Path]:
    """Write the tables of both methods into the state folder; warn of one without lines."""
    p: EdgeParameters = run.parameters
    writers: dict[str, Callable[..., int]] = {EDGES.name: partial(write_edges, workers=run.options.workers)}
    if p.nevatia_babu:
        writers[NEVATIA_BABU.name] = write_nevatia_babu

    def write(name: str) -> int:
        with run.timed(f"reconcile {name}"):
            return writers[name](run.folder / f"{name}.parquet", fields, run.geometry, p)

    with ThreadPoolExecutor(min(len(writers), run.options.workers)) as pool:
        found = dict(zip(writers, pool.map(write, writers), strict=True))
    for name, count in found.items():
        if not count:
            warnings.warn(f"{name} has no line; {_WITHOUT_LINES[name]}", stacklevel=4)
    return run.in_format([run.folder / f"{name}.parquet" for name in writers])


def write_edges(path: Path, ledger: Ledger, geometry: Geometry, parameters: EdgeParameters, workers: int) -> int:
    """Join the lines of all tiles and write ``edges.parquet``.

    Parameters
    ----------
    path
        File to write.
    ledger
        Of the pass that has traced them.
    geometry
        Grid of the raster.
    parameters
        Of the pipeline.
    workers
        Threads; they do not change the result.

    Returns
    -------
    int
        Number of lines.
    """
    lines = join_lines(LinePieces(**{name: facts[name] for name in PIECE_COLUMNS}) for facts in ledger.each())
    cracks = lines.lengths()
    # smoothing makes lines shorter, never longer
    kept = long_groups(lines, cracks * geometry.resolution, parameters.minimum_length)
    lines = Lines(*taken(lines.offsets, lines.vertices, kept), lines.contrast[kept], lines.step[kept])
    contrast, step = (sums / cracks[kept] / TICKS for sums in (lines.contrast, lines.step))
    chains = smoothed(lines, parameters.simplification)
    del lines
    shape = line_shape(chains.offsets, chains.vertices)
    kept = long_groups(chains, shape.length * geometry.resolution, parameters.minimum_length)
    chains = Chains(*taken(chains.offsets, chains.vertices, kept))
    streets = find_streets(chains, step[kept], parameters, geometry.resolution, workers)
    columns = {
        "line_id": np.arange(1, kept.sum() + 1, dtype=np.int64),
        "contrast": contrast[kept],
        **shape_columns(Shape(*(values[kept] for values in shape)), geometry),
        "street_border": streets.candidate,
        "street_width_m": streets.width * geometry.resolution,
        "street_partner": streets.partner + 1,
        "street_share": streets.share,
    }
    with ParquetLineWriter(path, EDGES.dtypes, geometry.crs) as table:
        table.append(columns, geometry.coordinates(chains.vertices), chains.offsets)
    return len(chains)


def _elements(facts: Facts, width: int) -> EdgeElements:
    columns = {name: facts[f"element:{name}"] for name in ELEMENT_COLUMNS}
    return EdgeElements(**columns, width=width)


def write_nevatia_babu(path: Path, ledger: Ledger, geometry: Geometry, parameters: EdgeParameters) -> int:
    """Trace the edge elements of all tiles and write ``nevatia_babu.parquet``.

    Parameters
    ----------
    path
        File to write.
    ledger
        Of the pass that has found the elements.
    geometry
        Grid of the raster.
    parameters
        Of the pipeline.

    Returns
    -------
    int
        Number of lines.
    """
    elements = links.join_elements(map(_elements, ledger.each(), repeat(geometry.shape[1])))
    segments = tracing.trace_segments(elements)
    offsets, pixels = tracing.straight_lines(elements, segments, parameters.edge_tolerance)
    contrast = segments.mean_magnitudes(elements) / nevatia_babu.STEP_RESPONSE
    del elements
    shape = line_shape(offsets, pixels.astype(np.float64))
    kept = shape.length * geometry.resolution >= parameters.minimum_edge_length
    offsets, pixels = taken(offsets, pixels, kept)
    columns = {
        "line_id": np.arange(1, offsets.size, dtype=np.int64),
        "contrast": contrast[kept],
        **shape_columns(Shape(*(values[kept] for values in shape)), geometry),
        "stage": segments.stage[kept].astype(np.int64),
    }
    with ParquetLineWriter(path, NEVATIA_BABU.dtypes, geometry.crs) as table:
        # elements are pixels, and lines run through their centres
        table.append(columns, geometry.coordinates(pixels + 0.5), offsets)
    return offsets.size - 1
