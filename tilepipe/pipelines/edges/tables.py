"""The two tables of `edges`: polylines of the line field, and the lines of the classical method."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.io.vectors.geoparquet import ParquetLineWriter
from tilepipe.pipelines.edges.layers import EDGES, NEVATIA_BABU
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_fields import ELEMENT_COLUMNS, FRAGMENT_COLUMNS
from tilepipe.pipelines.edges.street_borders import find_streets
from tilepipe.tiling.facts import Facts
from tilepipe_kernels.nevatia_babu.links import EdgeElements, join_elements
from tilepipe_kernels.nevatia_babu.masks import STEP_RESPONSE
from tilepipe_kernels.nevatia_babu.tracing import trace_chains
from tilepipe_kernels.polylines.crack_lines import TICKS, CrackLineFragments
from tilepipe_kernels.polylines.end_point_fit import fit_polylines
from tilepipe_kernels.polylines.groups import long_groups
from tilepipe_kernels.polylines.join import join_crack_lines
from tilepipe_kernels.polylines.shape import Shape, shape_of
from tilepipe_kernels.polylines.smooth import smoothed

_WITHOUT_LINES = {
    EDGES.name: "lower minimum_length or raise levels (--set)",
    NEVATIA_BABU.name: "raise edge_share or lower minimum_edge_length (--set)",
}
"""What to do when a table has no line."""


def shape_columns(shape: Shape, geometry: Geometry) -> dict[str, NDArray[Any]]:
    """Attributes of a shape measured in pixels."""
    return {
        "length_m": shape.length * geometry.resolution,
        "straightness": shape.straightness,
        "sinuosity": shape.sinuosity,
    }


def write_tables(run: Work, fields: Ledger) -> list[Path]:
    """Write the tables of both methods into the state folder; warn of one without lines."""
    p: EdgeParameters = run.parameters
    writers: dict[str, Callable[..., int]] = {EDGES.name: partial(write_edges, workers=run.options.resolved_workers)}
    if p.nevatia_babu:
        writers[NEVATIA_BABU.name] = write_nevatia_babu

    def write(name: str) -> int:
        with run.timed(f"reconcile {name}"):
            return writers[name](run.folder / f"{name}.parquet", fields, run.geometry, p)

    with ThreadPoolExecutor(min(len(writers), run.options.resolved_workers)) as pool:
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
    fragments = (CrackLineFragments(**{name: facts[name] for name in FRAGMENT_COLUMNS}) for facts in ledger.each())
    lines = join_crack_lines(fragments)
    cracks = lines.lengths()
    # smoothing makes lines shorter, never longer
    kept = long_groups(lines, cracks * geometry.resolution, parameters.minimum_length)
    lines = lines.taken(kept)
    contrast, step = (sums / cracks[kept] / TICKS for sums in (lines.contrast, lines.step))
    smooth = smoothed(lines, parameters.simplification)
    del lines
    shape = shape_of(smooth)
    kept = long_groups(smooth, shape.length * geometry.resolution, parameters.minimum_length)
    smooth = smooth.taken(kept)
    streets = find_streets(smooth, step[kept], parameters, geometry.resolution, workers)
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
        table.append(columns, replace(smooth, vertices=geometry.coordinates(smooth.vertices)))
    return len(smooth)


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
    elements = join_elements(map(_elements, ledger.each(), repeat(geometry.shape[1])))
    chains = trace_chains(elements)
    lines = fit_polylines(chains.polylines(elements), parameters.edge_tolerance)
    contrast = chains.mean_magnitudes(elements) / STEP_RESPONSE
    del elements
    shape = shape_of(lines)
    kept = shape.length * geometry.resolution >= parameters.minimum_edge_length
    lines = lines.taken(kept)
    columns = {
        "line_id": np.arange(1, len(lines) + 1, dtype=np.int64),
        "contrast": contrast[kept],
        **shape_columns(Shape(*(values[kept] for values in shape)), geometry),
        "stage": chains.stage[kept].astype(np.int64),
    }
    with ParquetLineWriter(path, NEVATIA_BABU.dtypes, geometry.crs) as table:
        # elements are pixels, and lines run through their centres
        table.append(columns, replace(lines, vertices=geometry.coordinates(lines.vertices + 0.5)))
    return len(lines)
