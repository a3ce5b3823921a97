"""The pass of `edges` that finds both fields of a tile, and the edge elements of the classical method."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Pass, Setting, State
from tilepipe.engine.state import StateArray, write_state
from tilepipe.engine.work import Work
from tilepipe.pipelines.edges.layers import LINES, NODATA, SEGMENTS
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_bands import Photograph
from tilepipe.pipelines.edges.pass_levels import LevelScale
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, Window
from tilepipe_kernels.core.arrays import Backend, to_backend, to_host
from tilepipe_kernels.image.grey_levels import LEVEL_STEPS
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_energy import EnergyTerms, energy_terms
from tilepipe_kernels.mrf.labels import minimise
from tilepipe_kernels.mrf.lines import minimise as line_field
from tilepipe_kernels.nevatia_babu import links
from tilepipe_kernels.polylines import crack_lines
from tilepipe_kernels.polylines.join import Chains, end_points, place_numbers, taken

ELEMENT_COLUMNS = ("pixel", "direction", "magnitude", "links")
PIECE_COLUMNS = ("offsets", "vertices", "cut", "contrast", "step")


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


_BEYOND = 2
"""Pixels around a core whose lines its pieces and the terms of its energy depend on."""


def halo(setting: Setting) -> int:
    """Pixels around a core on which its levels, lines and edge elements depend."""
    p: EdgeParameters = setting.parameters
    annealing = Annealing(sweeps=p.sweeps)
    if p.scheme == "integrated":
        method = p.line_method
        fields = line_field.halo(p.model(), p.rounds, method=method, integrated=True, annealing=annealing)
        fields += minimise.halo(p.rounds, method="messages") if p.optimiser == "messages" else 0
    else:
        fields = minimise.halo(p.rounds, method=p.optimiser, annealing=annealing) + _halo_of_lines(p)
    return max(fields + _BEYOND, links.halo() if p.nevatia_babu else 0)


def _halo_of_lines(p: EdgeParameters) -> int:
    """Pixels on whose labels a line element depends, where labels are given."""
    return line_field.halo(p.model(), p.rounds, method=p.line_method, annealing=Annealing(sweeps=p.sweeps))


def bytes_per_pixel(setting: Setting) -> int:
    """Peak memory of the pass per pixel, as measured: grey values, and what finding levels or both fields takes."""
    parameters: EdgeParameters = setting.parameters
    k = parameters.levels
    levels = 60 + 18 * k if parameters.optimiser == "messages" else 36 + 4 * k
    return 16 + max(levels, 72 if parameters.scheme == "integrated" else 0)


def find_fields(context: FieldContext, tile: Tile) -> Facts:
    """Tile function: writes levels and lines; facts are the pieces of edge lines, edge elements, and counts."""
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
    facts |= _pieces(grey, h, v, core, near.origin, p.minimum_length / raster.geometry.resolution)
    lines = h[core.slices] | v[core.slices] << 1
    lines[levels[core.slices] == NODATA] = NODATA
    arrays = {"levels": context.levels, "lines": context.lines}
    return facts | write_state(arrays, tile, {"levels": levels[core.slices], "lines": lines})


FIELDS = Pass(
    "fields",
    find_fields,
    halo=halo,
    bytes_per_pixel=bytes_per_pixel,
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
    annealing, part = Annealing(sweeps=p.sweeps, seed=context.seed), tile.core_in_padded.slices
    shape = context.photograph.raster.shape
    near = tile.core.padded(_BEYOND, shape)
    if p.scheme == "integrated":
        start = None
        if p.optimiser == "messages":
            start = minimise.intensity_field(observed, model, method="messages", rounds=p.rounds, origin=origin).labels
        both = line_field.coupled_fields(
            observed, model, method=p.line_method, rounds=p.rounds, start=start, origin=origin, core=part,
            annealing=annealing,
        )  # fmt: skip
        inner = near.relative_to(tile.padded).slices
        return both.labels[inner], both.horizontal[inner], both.vertical[inner], both.unresolved
    found = minimise.intensity_field(
        observed, model, method=p.optimiser, rounds=p.rounds, origin=origin, core=part, annealing=annealing
    )
    # of the labels only those that lines depend on
    around = near.padded(_halo_of_lines(p), shape)
    labels, inner = found.labels[around.relative_to(tile.padded).slices], near.relative_to(around).slices
    drawn = line_field.line_field(
        labels, model, method=p.line_method, rounds=p.rounds, origin=around.origin,
        core=tile.core.relative_to(around).slices, annealing=annealing,
    )  # fmt: skip
    return labels[inner], drawn.horizontal[inner], drawn.vertical[inner], found.unresolved + drawn.unresolved


def _elements(context: FieldContext, values: NDArray[np.float32], tile: Tile) -> Facts:
    """Edge elements of the classical method."""
    shape = context.photograph.raster.shape
    near = tile.core.padded(links.halo(), shape)
    core = tile.core.relative_to(near).as_tuple()
    block = values[near.relative_to(tile.padded).slices]
    elements = links.find_elements(block, context.threshold, core, near.origin, shape[1])
    return {f"element:{name}": getattr(elements, name) for name in ELEMENT_COLUMNS}


def _pieces(
    grey: NDArray[np.float32],
    h: NDArray[np.uint8],
    v: NDArray[np.uint8],
    core: Window,
    origin: tuple[int, int],
    least: float,
) -> Facts:
    """Pieces of lines; those that meet no other, in this tile or beyond it, only if they are long enough."""
    pieces = crack_lines.trace_lines(h, v, grey, core.as_tuple(), origin)
    lengths = Chains(pieces.offsets, pieces.vertices).lengths()
    kept = (lengths >= least) | pieces.cut.any(axis=1) | _meets(pieces, core, origin)
    offsets, vertices = taken(pieces.offsets, pieces.vertices, kept)
    others = {name: getattr(pieces, name)[kept] for name in ("cut", "contrast", "step")}
    return {"offsets": offsets, "vertices": vertices} | others


def _meets(pieces: crack_lines.LinePieces, core: Window, origin: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether a piece shares one of its ends with another piece, or ends where another tile's may end."""
    ends = end_points(pieces.offsets, pieces.vertices)
    _, place, count = np.unique(place_numbers(ends), return_inverse=True, return_counts=True)
    top, left = origin[0] + core.top, origin[1] + core.left
    row, column = ends.T
    inside = (row > top) & (row < top + core.rows) & (column > left) & (column < left + core.columns)
    # both ends of a ring are one place
    rings = (ends[::2] == ends[1::2]).all(axis=1)
    alone = inside & (count[place] == np.where(np.repeat(rings, 2), 2, 1))
    meets: NDArray[np.bool_] = ~alone.reshape(-1, 2).all(axis=1)
    return meets


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
