"""The pass of `streets` that finds lines: centerline fragments of a tile, by ridge lines and by skeleton."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Pass, Setting
from tilepipe.engine.tiles.relabel import read_relabelled
from tilepipe.engine.tiles.state import StateArray
from tilepipe.engine.work import Work
from tilepipe.pipelines.streets.layers import NODATA
from tilepipe.pipelines.streets.line_nets import Net, bytes_per_pixel, gathered
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.pipelines.streets.pass_levels import GreyScale
from tilepipe.pipelines.streets.reconcile_regions import LOOKUP, Regions
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid, Window
from tilepipe_kernels.core.arrays import Backend, namespace, to_backend, to_host
from tilepipe_kernels.image import borders, diffusion, distance, morphology
from tilepipe_kernels.image.grey_levels import NO_GREY, street_image
from tilepipe_kernels.network import skeleton, tracing
from tilepipe_kernels.ridges.links import LINK_RADIUS, link_points
from tilepipe_kernels.ridges.points import LinePoints, line_points
from tilepipe_kernels.ridges.ridges import halo as ridges_halo
from tilepipe_kernels.ridges.width import line_widths

RIDGE, AXIS = "ridge", "axis"
"""Prefixes of the facts of the two ways to centerlines."""


@dataclass(frozen=True)
class LineContext:
    """What the pass needs to know; picklable.

    ``low`` is the lower threshold of the line response in grey levels per pixel²; lengths of the parameters are
    turned into pixels by ``resolution`` (m).
    """

    parameters: StreetParameters
    scale: GreyScale
    grid: TileGrid
    labels: StateArray
    grey: StateArray
    lookup: Path
    offsets: tuple[int, ...]
    resolution: float
    low: float
    backend: Backend = "numpy"

    @classmethod
    def of(cls, run: Work, scale: GreyScale, regions: Regions, low: float) -> LineContext:
        """Of a run whose regions are known."""
        return cls(
            run.parameters,
            scale,
            run.grid,
            run.state("labels"),
            run.state("grey"),
            run.folder / LOOKUP,
            tuple(regions.numbering.offsets.tolist()),
            run.resolution,
            low,
            run.backend,
        )

    def pixels(self, metres: float) -> float:
        """A length in pixels."""
        return metres / self.resolution

    @property
    def cap(self) -> int:
        """Half the width of the widest street in whole pixels."""
        return self.parameters.half_width_in_pixels(self.resolution)

    @property
    def sigma(self) -> float:
        """Scale of the ridge lines in pixels."""
        return self.parameters.sigma_in_pixels(self.resolution)


@dataclass(frozen=True)
class Streets:
    """Arrays of a padded tile: region ids, stored grey levels, cleaned mask and grey image of the streets."""

    ids: NDArray[np.uint32]
    packed: NDArray[np.uint16]
    mask: NDArray[np.bool_]
    image: NDArray[np.float32]


def halo(setting: Setting) -> int:
    """Pixels that the pass reads around a core."""
    parameters, resolution = setting.parameters, setting.resolution
    cleaning = morphology.halo(parameters.closing_radius / resolution) + morphology.halo(
        parameters.opening_radius / resolution
    )
    cleaning += morphology.speck_halo(speck_pixels(parameters, resolution))
    sigma = parameters.sigma_in_pixels(resolution)
    width = parameters.maximum_width / resolution
    ridge = ridges_halo(sigma, width)
    cap = parameters.half_width_in_pixels(resolution)
    reach = border_reach(parameters, resolution)
    measured = borders.halo(reach) + max(ridge, distance.halo(cap + reach))
    return cleaning + max(measured, skeleton.halo(cap) + 2)


def border_reach(parameters: StreetParameters, resolution: float) -> int:
    """Pixels that noise may keep the border of a street out of its region: as far as a step of the diffusion sees."""
    return diffusion.halo(1, parameters.gradient_sigma / resolution, parameters.diffusion_model)


def read_regions(context: LineContext, window: Window) -> NDArray[np.uint32]:
    """Published region ids (0 = none) of a window of pixels, put together from the tiles that it touches."""
    rows, columns = context.parameters.rectangle_rows, context.parameters.rectangle_columns
    top, left = window.top // rows, window.left // columns
    coarse = Window(top, left, -(-window.bottom // rows), -(-window.right // columns))
    coarse = coarse.intersection(Window(0, 0, *context.labels.grid.shape))
    ids = read_relabelled(context.labels, context.lookup, context.offsets, coarse)
    if (rows, columns) != (1, 1):
        ids = np.repeat(np.repeat(ids, rows, axis=0), columns, axis=1)
    return ids[window.top - top * rows :, window.left - left * columns :][: window.rows, : window.columns]


def published_regions(context: LineContext, window: Window) -> NDArray[np.uint32]:
    """Values of ``streets.tif`` in a window: region ids, 0 = none, `NODATA` where the input is nodata."""
    missing = (context.grey.read(window) & 1).astype(np.bool_)
    return np.where(missing, np.uint32(NODATA), read_regions(context, window))


def read_streets(context: LineContext, tile: Tile) -> Streets:
    """Read regions and grey levels of a padded tile, and clean the regions."""
    ids, scale = read_regions(context, tile.padded), context.scale
    if not ids.any():
        nothing, bright = np.zeros(ids.shape, np.bool_), np.full(ids.shape, scale.bright, np.float32)
        return Streets(ids, np.full(ids.shape, NO_GREY, np.uint16), nothing, bright)
    ids, packed = (to_backend(values, context.backend) for values in (ids, context.grey.read(tile.padded)))
    mask = _clean(context, ids > 0)
    image = street_image(mask, ids, packed, dark=scale.dark, bright=scale.bright, threshold=scale.threshold)
    return Streets(ids, packed, mask, image)


def find_lines(context: LineContext, tile: Tile) -> Facts:
    """Tile function: trace the fragments of both ways to centerlines."""
    streets = read_streets(context, tile)
    measured = _with_borders(context, streets)
    return _ridge_lines(context, tile, streets, measured) | _medial_axis(context, tile, streets, measured)


def _with_borders(context: LineContext, streets: Streets) -> Streets:
    """The streets as their widths are measured: with the borders that noise has kept out of the regions."""
    if not streets.mask.any():
        return streets
    scale, reach = context.scale, border_reach(context.parameters, context.resolution)
    mask, image = borders.with_borders(
        streets.mask,
        streets.image,
        streets.ids,
        streets.packed,
        dark=scale.dark,
        bright=scale.bright,
        reach=reach,
        noise=scale.noise,
    )
    return replace(streets, mask=mask, image=image)


LINES = Pass(
    "lines",
    find_lines,
    halo=halo,
    bytes_per_pixel=bytes_per_pixel,
    gathers=gathered(RIDGE, Net.of_ridges) + gathered(AXIS, Net.of_axes),
    fewer="drop more of the regions (minimum_size, minimum_elongation)",
)


def _clean(context: LineContext, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Regions with gaps closed, specks filled and whiskers opened (step 6 of the method)."""
    p = context.parameters
    cleaned = morphology.close_mask(mask, context.pixels(p.closing_radius))
    if speck := speck_pixels(p, context.resolution):
        cleaned = morphology.fill_specks(cleaned, speck)
    return morphology.open_mask(cleaned, context.pixels(p.opening_radius))


def speck_pixels(parameters: StreetParameters, resolution: float) -> int:
    """Side of the square that a filled hole fits in, in pixels; 0 = none is filled."""
    return math.floor(parameters.speck_size / resolution)


def _ridge_lines(
    context: LineContext,
    tile: Tile,
    streets: Streets,
    measured: Streets,
) -> Facts:
    """Fragments of Steger's ridge lines."""
    mask, sigma = streets.mask, context.sigma
    near = tile.core.padded(LINK_RADIUS, context.grid.shape).relative_to(tile.padded)
    xp = namespace(mask)
    wanted = xp.zeros(mask.shape, xp.bool_)
    wanted[near.slices] = mask[near.slices]
    points = line_points(streets.image, sigma, low=context.low, mask=wanted)
    links = xp.zeros(mask.shape, xp.uint8)
    links[points.row, points.col] = link_points(points)
    core = tile.core_in_padded
    inside = (
        (points.row >= core.top)
        & (points.row < core.bottom)
        & (points.col >= core.left)
        & (points.col < core.right)
        & (links[points.row, points.col] > 0)
    )
    points = points.take(inside)
    width, contrast = _sampled_widths(context, tile, streets, measured, points)
    values = {
        "dx": points.dx,
        "dy": points.dy,
        "response": points.response,
        "width": width,
        "contrast": contrast,
        "region": streets.ids[points.row, points.col].astype(np.float32),
    }
    flat = points.row.astype(xp.int64) * mask.shape[1] + points.col
    return _fragments(RIDGE, links, tile, context, values, flat)


def _sampled_widths(
    context: LineContext, tile: Tile, streets: Streets, measured: Streets, points: LinePoints
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Width (pixels) and contrast of every fifth point along a line in any of the eight directions, NaN elsewhere."""
    top, left = tile.padded.origin
    xp = namespace(streets.image)
    sample = xp.flatnonzero((points.row + top + 2 * (points.col + left)) % 5 == 0)
    maximum_width, sampled = context.pixels(context.parameters.maximum_width), points.take(sample)
    found, bordered = (
        line_widths(each.image, sampled, context.sigma, maximum_width=maximum_width) for each in (streets, measured)
    )
    own, other = found.left + found.right, bordered.left + bordered.right
    # edges that lie farther off than borders reach are those of something else
    near = bordered.valid & (abs(other - own) <= 2 * border_reach(context.parameters, context.resolution))
    width, contrast = xp.full((2, len(points)), xp.nan, xp.float32)
    width[sample] = xp.where(found.valid, xp.where(near, other, own), xp.nan)
    contrast[sample] = xp.where(found.valid, found.contrast, xp.nan)
    return width, contrast


def _medial_axis(
    context: LineContext,
    tile: Tile,
    streets: Streets,
    measured: Streets,
) -> Facts:
    """Fragments of the skeleton."""
    axis = skeleton.medial_axis(
        streets.mask,
        cap=context.cap,
        separation=context.pixels(context.parameters.separation),
        origin=tile.padded.origin,
    )
    links = skeleton.skeleton_links(axis)
    xp = namespace(links)
    row, col = xp.nonzero(links != 0)
    zero = xp.zeros(row.size, xp.float32)
    contrast = np.float32(context.scale.bright) - streets.image[row, col]
    reach = border_reach(context.parameters, context.resolution)
    squared = distance.nearest_background(measured.mask, context.cap + reach)[0]
    values = {
        "dx": zero,
        "dy": zero,
        "response": zero,
        "width": skeleton.width_at(squared[row, col]),
        "contrast": contrast,
        "region": streets.ids[row, col].astype(np.float32),
    }
    return _fragments(AXIS, links, tile, context, values, row * links.shape[1] + col)


def _fragments(
    prefix: str,
    links: NDArray[np.uint8],
    tile: Tile,
    context: LineContext,
    values: dict[str, NDArray[Any]],
    flat: NDArray[np.int64],
) -> Facts:
    """Trace the core and attach to each fragment's pixels the values of the points at block indices ``flat``.

    Chains are followed on the host, from the links, which leave the device here, and only once.
    """
    core = tile.core_in_padded
    found = tracing.trace(
        to_host(links),
        core=(core.top, core.left, core.bottom, core.right),
        origin=tile.padded.origin,
        width=context.grid.shape[1],
    )
    facts: Facts = {f"{prefix}:{name}": value for name, value in vars(found).items()}
    row, column = np.divmod(found.pixels, context.grid.shape[1])
    local = (row - tile.padded.top) * links.shape[1] + column - tile.padded.left
    index = np.searchsorted(to_host(flat), local)
    for name, value in values.items():
        facts[f"{prefix}:at:{name}"] = to_host(value)[index]
    return facts
