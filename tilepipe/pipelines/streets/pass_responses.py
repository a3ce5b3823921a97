"""Global thresholds of the line response, and the noise of the grey levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tilepipe.engine.pipeline import Pass, Setting
from tilepipe.engine.work import Work
from tilepipe.errors import InputError
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.pipelines.streets.pass_levels import GreyScale
from tilepipe.pipelines.streets.pass_lines import LineContext, halo, read_streets
from tilepipe.pipelines.streets.reconcile_regions import Regions
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile
from tilepipe_kernels.core.arrays import namespace, to_host
from tilepipe_kernels.ridges.bar_profile import response_bins, response_of_bar, thresholds_from_histogram
from tilepipe_kernels.ridges.points import line_points

RESPONSE_EDGES = response_bins(1e-3, 1e3, 240)
"""Edges of the bins in which line responses are counted (grey per pixel²): 40 a decade, 10⁻³ to 10³."""


@dataclass(frozen=True)
class Thresholds:
    """``low`` and ``high`` of the line response (grey per pixel²), ``sigma`` in pixels, ``noise`` in grey levels."""

    low: float
    high: float
    sigma: float
    noise: float


def count_responses(context: LineContext, tile: Tile) -> Facts:
    """Tile function: histogram of the line responses of the core."""
    streets = read_streets(context, tile)
    mask = streets.mask
    xp = namespace(mask)
    wanted = xp.zeros(mask.shape, xp.bool_)
    inner = tile.core_in_padded.slices
    wanted[inner] = mask[inner]
    if not wanted.any():
        return {"responses": np.zeros(RESPONSE_EDGES.size - 1, np.int64)}
    points = line_points(streets.image, context.sigma, low=context.low, mask=wanted)
    return {"responses": np.histogram(to_host(points.response), RESPONSE_EDGES)[0].astype(np.int64)}


def _from_histogram(setting: Setting) -> bool:
    thresholds: str = setting.parameters.thresholds
    return thresholds == "histogram"


RESPONSES = Pass("responses", count_responses, halo=halo, bytes_per_pixel=40, needed=_from_histogram)

_LEAST_RESPONSE = 1e-6
"""Line responses from which on points are counted (grey per pixel²): below the bins of the histogram."""


def find_thresholds(run: Work, scale: GreyScale, regions: Regions) -> Thresholds:
    """Thresholds of the line response and the noise of the grey levels, both global; counts responses if need be."""
    responses: list[Facts] = []
    if RESPONSES.needed(run.setting):
        context = LineContext.of(run, scale, regions, _LEAST_RESPONSE)
        responses = run.over_tiles(RESPONSES, context).all_facts()
    return line_thresholds(run.parameters, scale, run.resolution, responses)


def line_thresholds(
    parameters: StreetParameters, scale: GreyScale, resolution: float, responses: list[Facts]
) -> Thresholds:
    """Thresholds as the parameters mean them.

    ``contrast``: the response of a bar of that share of the contrast between the bright and the dark class, for the
    less responsive of the narrowest and the widest street (Steger's closed form).  ``histogram``: that share of the
    threshold that parts the responses of the raster in two classes.  ``absolute``: grey levels per m².

    Raises
    ------
    InputError
        When the histogram of responses is too poor to part it.
    """
    p = parameters
    sigma = p.sigma_in_pixels(resolution)
    if p.thresholds == "absolute":
        unit = resolution**2
    elif p.thresholds == "contrast":
        contrast = max(scale.bright - scale.dark, 1.0)
        widths = (p.minimum_street_width, p.line_width)
        unit = min(response_of_bar(w / resolution / 2, contrast, sigma) for w in widths)
    else:
        counts = np.sum([f["responses"] for f in responses], axis=0)
        try:
            unit = thresholds_from_histogram(counts, RESPONSE_EDGES)[1]
        except ValueError as error:
            raise InputError(f"parameter thresholds='histogram': {error}; use thresholds='contrast'") from None
    low, high = p.low * unit, p.high * unit
    return Thresholds(low, high, sigma, scale.noise)
