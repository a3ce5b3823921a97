"""The pass of `edges` that finds both fields of a tile, and the edge elements of the classical method."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.gathering import most_cracks
from tilepipe.engine.pipeline import Gathered, Pass, Setting, State
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.engine.work import Work
from tilepipe.pipelines.edges.layers import LINES, NODATA, SEGMENTS
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_bands import Photograph
from tilepipe.pipelines.edges.pass_levels import LevelScale
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, Window
from tilepipe_kernels.core.arrays import Backend, to_backend, to_host
from tilepipe_kernels.image.grey_levels import LEVEL_STEPS
from tilepipe_kernels.mrf.edge_energy import EnergyTerms, energy_terms
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.minimise import halo as labels_halo
from tilepipe_kernels.mrf.lines.minimise import coupled_fields, line_field
from tilepipe_kernels.mrf.lines.minimise import halo as lines_halo
from tilepipe_kernels.nevatia_babu.links import find_elements
from tilepipe_kernels.nevatia_babu.links import halo as links_halo
from tilepipe_kernels.polylines.crack_lines import trace_crack_lines
from tilepipe_kernels.polylines.groups import meet_others

ELEMENT_COLUMNS = ("pixel", "direction", "magnitude", "links")
FRAGMENT_COLUMNS = ("offsets", "vertices", "cut", "contrast", "step")


@dataclass(frozen=True)
class FieldContext:
    """What the pass needs to know; picklable."""

    photograph: Photograph
    scale: LevelScale
    parameters: EdgeParameters
    levels: StateArray
    lines: StateArray
    threshold: float
    seed: int
    backend: Backend = "numpy"

    @classmethod
    def of(cls, run: Work, photograph: Photograph, scale: LevelScale, threshold: float) -> FieldContext:
        """Of a run whose levels are known."""
        return cls(
            photograph,
            scale,
            run.parameters,
            run.state("levels"),
            run.state("lines"),
            threshold,
            run.options.seed,
            run.backend,
        )


_TRACING = 115
"""Bytes per pixel of grey values and of edge lines between all pixels, as measured."""

_BEYOND = 2
"""Pixels around a core whose lines its fragments and the terms of its energy depend on."""


def halo(setting: Setting) -> int:
    """Pixels around a core on which its levels, lines and edge elements depend."""
    p: EdgeParameters = setting.parameters
    if p.scheme == "integrated":
        fields = lines_halo(p.model(), p.line_search(), integrated=True)
        fields += labels_halo(p.search()) if p.optimiser == "messages" else 0
    else:
        fields = labels_halo(p.search()) + _halo_of_lines(p)
    return max(fields + _BEYOND, links_halo() if p.nevatia_babu else 0)


def _halo_of_lines(p: EdgeParameters) -> int:
    """Pixels on whose labels a line element depends, where labels are given."""
    return lines_halo(p.model(), p.line_search())


def bytes_per_pixel(setting: Setting) -> int:
    """Peak memory of the pass per pixel, as measured: grey values, and what finding levels or both fields takes."""
    parameters: EdgeParameters = setting.parameters
    k = parameters.levels
    levels = 60 + 18 * k if parameters.optimiser == "messages" else 36 + 4 * k
    return 16 + max(levels, 72 if parameters.scheme == "integrated" else 0, _TRACING)


def find_fields(context: FieldContext, tile: Tile) -> Facts:
    """Tile function: writes levels and lines; facts are the fragments of edge lines, edge elements, and counts."""
    p, raster = context.parameters, context.photograph.raster
    values = to_backend(context.photograph.read(tile.padded), context.backend)
    grey = context.scale.grey(values)
    observed = context.scale.levels(grey)
    levels, h, v, unresolved = _fields(context, observed, tile)
    near = tile.core.padded(_BEYOND, raster.shape)
    part, core = near.relative_to(tile.padded).slices, tile.core.relative_to(near)
    facts = _energy(energy_terms(observed[part], levels, h, v, p.levels, core=core.slices), unresolved)
    if p.nevatia_babu:
        facts |= _elements(context, values, tile)
    # from here on the host works: it joins lines
    grey, levels, h, v = (to_host(array) for array in (grey[part], levels, h, v))
    # a line is never longer than its cracks, and counts with those that it meets
    facts |= _fragments(grey, h, v, core, near.origin, p.minimum_length / raster.geometry.resolution)
    lines = h[core.slices] | v[core.slices] << 1
    lines[levels[core.slices] == NODATA] = NODATA
    arrays = {"levels": context.levels, "lines": context.lines}
    return facts | write_state(arrays, tile, {"levels": levels[core.slices], "lines": lines})


FIELDS = Pass(
    "fields",
    find_fields,
    halo=halo,
    bytes_per_pixel=bytes_per_pixel,
    # measured on noise: joined, smoothed, compared with each other, and written
    gathers=(
        Gathered("edge lines", "contrast", bytes_per_row=240, most=most_cracks),
        Gathered("corners of edge lines", "vertices", bytes_per_row=50, most=lambda setting: 2 * most_cracks(setting)),
        # thin: of two neighbours across an edge one is an element
        Gathered(
            "edge elements", "element:pixel", bytes_per_row=80, most=lambda setting: math.prod(setting.shape) // 2
        ),
    ),
    fewer="use fewer levels, a larger minimum_length, or a smaller edge_share",
    writes={"levels": State("uint8", NODATA), "lines": State("uint8", NODATA)},
)


def write_fields(run: Work, context: FieldContext) -> list[Path]:
    """Write both fields into the state folder."""
    return [run.write_raster(SEGMENTS.name, context.levels.read), run.write_raster(LINES.name, context.lines.read)]


def _fields(
    context: FieldContext, observed: NDArray[np.float32], tile: Tile
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], int]:
    """Levels, horizontal and vertical elements of a core and `_BEYOND` around it; unresolved sites of the core."""
    p, model, origin = context.parameters, context.parameters.model(context.scale.noise), tile.padded.origin
    search, line_search, part = p.search(context.seed), p.line_search(context.seed), tile.core_in_padded.slices
    shape = context.photograph.raster.shape
    near = tile.core.padded(_BEYOND, shape)
    if p.scheme == "integrated":
        start = None
        if p.optimiser == "messages":
            start = intensity_field(observed, model, search=search, origin=origin).labels
        both = coupled_fields(observed, model, search=line_search, start=start, origin=origin, core=part)
        inner = near.relative_to(tile.padded).slices
        return both.labels[inner], both.horizontal[inner], both.vertical[inner], both.unresolved
    found = intensity_field(observed, model, search=search, origin=origin, core=part)
    # of the labels only those that lines depend on
    around = near.padded(_halo_of_lines(p), shape)
    labels, inner = found.labels[around.relative_to(tile.padded).slices], near.relative_to(around).slices
    core = tile.core.relative_to(around).slices
    drawn = line_field(labels, model, search=line_search, origin=around.origin, core=core)
    return labels[inner], drawn.horizontal[inner], drawn.vertical[inner], found.unresolved + drawn.unresolved


def _elements(context: FieldContext, values: NDArray[np.float32], tile: Tile) -> Facts:
    """Edge elements of the classical method."""
    shape = context.photograph.raster.shape
    near = tile.core.padded(links_halo(), shape)
    core = tile.core.relative_to(near).as_tuple()
    block = values[near.relative_to(tile.padded).slices]
    elements = find_elements(block, context.threshold, core, near.origin, shape[1])
    return {f"element:{name}": getattr(elements, name) for name in ELEMENT_COLUMNS}


def _fragments(
    grey: NDArray[np.float32],
    h: NDArray[np.uint8],
    v: NDArray[np.uint8],
    core: Window,
    origin: tuple[int, int],
    least: float,
) -> Facts:
    """Fragments of lines; those that meet no other, in this tile or beyond it, only if they are long enough."""
    window = core.as_tuple()
    found = trace_crack_lines(h, v, grey, window, origin)
    kept = (found.lengths() >= least) | found.cut.any(axis=1) | meet_others(found, window, origin)
    # where lines lie thickest all meet, and no room is left for a second copy of them
    found = found if kept.all() else found.taken(kept)
    return {name: getattr(found, name) for name in FRAGMENT_COLUMNS}


def _energy(terms: EnergyTerms, unresolved: int) -> Facts:
    """Terms of the core; observed values are whole steps of a level, so that their sum is exact."""
    counts = [terms.unparted, terms.broken, terms.corners, terms.crowded, unresolved]
    return {
        "squares": np.array([round(terms.squares * LEVEL_STEPS**2)], np.int64),
        "differences": terms.differences,
        "terms": np.array(counts, np.int64),
    }


@dataclass(frozen=True)
class FieldCounts:
    """What both fields of the whole raster are made of, and how many sites still wanted to change."""

    terms: EnergyTerms
    unresolved: int


def count_fields(facts: Iterable[Facts]) -> FieldCounts:
    """Sum of the counts of all tiles."""
    parts = list(facts)
    squares, differences, terms = (
        np.sum([part[name] for part in parts], axis=0) for name in ("squares", "differences", "terms")
    )
    *counted, unresolved = (int(count) for count in terms)
    return FieldCounts(EnergyTerms(float(squares[0]) / LEVEL_STEPS**2, differences, *counted), unresolved)
