"""The grey levels of a photograph: one pass that counts values, from which the levels of the whole image follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Pass, Setting
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.errors import InputError
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_bands import Photograph
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile
from tilepipe.tiling.histograms import added, as_facts
from tilepipe.tiling.noise import count_differences, noise
from tilepipe_kernels.core.arrays import Backend, to_backend
from tilepipe_kernels.image.grey_levels import LARGEST_GREY, stretch, to_levels
from tilepipe_kernels.image.histogram import bin_values, class_means, histogram, percentile
from tilepipe_kernels.nevatia_babu.elements import count_magnitudes, thin_edges, threshold_from_histogram
from tilepipe_kernels.nevatia_babu.elements import halo as elements_halo
from tilepipe_kernels.nevatia_babu.masks import edge_responses

LEAST_NOISE = 0.3
"""Noise in levels of an image that shows none: what its surfaces differ by (Barbosa 1994 takes it for all)."""


@dataclass(frozen=True)
class LevelScale:
    """How grey values of a photograph become levels.

    ``darkest`` and ``brightest`` are the values that become 0 and 255; ``means`` are the grey values of the levels on
    that scale, ascending; ``noise`` is the standard deviation of the noise in levels.
    """

    darkest: float
    brightest: float
    means: tuple[float, ...]
    noise: float

    def grey(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values on the scale of 0–255."""
        return stretch(values, self.darkest, self.brightest)

    def levels(self, grey: NDArray[np.float32]) -> NDArray[np.float32]:
        """Grey values of 0–255 in units of a level."""
        return to_levels(grey, np.array(self.means))


@dataclass(frozen=True)
class CountContext:
    """What the pass needs to know; picklable."""

    photograph: Photograph
    nevatia_babu: bool
    backend: Backend = "numpy"


def count_greys(context: CountContext, tile: Tile) -> Facts:
    """Tile function: histograms of grey values, of their differences, and of edge responses."""
    values = to_backend(context.photograph.read(tile.padded), context.backend)
    core = tile.core_in_padded.slices
    counted = {"grey": histogram(values[core]), "difference": count_differences(values, tile)}
    if context.nevatia_babu:
        magnitude, direction = edge_responses(values)
        elements = thin_edges(magnitude, direction)
        counted["edge"] = count_magnitudes(magnitude[core], elements[core])
    return as_facts(counted)


def halo(setting: Setting) -> int:
    """Pixels around a core that differences, and the responses of edges, depend on."""
    return elements_halo() if setting.parameters.nevatia_babu else 1


LEVELS = Pass("levels", count_greys, halo=halo, bytes_per_pixel=24)


def find_levels(run: Work, ledger: Ledger) -> tuple[LevelScale, float]:
    """Levels of the whole image, and the threshold of the classical method (0 without it)."""
    p: EdgeParameters = run.parameters
    counts = list(ledger.each())
    scale = level_scale(added(counts, "grey"), added(counts, "difference"), p, run.raster.names[0])
    return scale, edge_threshold(added(counts, "edge"), p.edge_share) if p.nevatia_babu else 0.0


def edge_threshold(counts: NDArray[np.int64], share: float | None) -> float:
    """Threshold of the classical method; infinite where the image has no edge at all."""
    return threshold_from_histogram(counts, share) if counts.any() else np.inf


def level_scale(
    counts: NDArray[np.int64], differences: NDArray[np.int64], parameters: EdgeParameters, name: str
) -> LevelScale:
    """Levels of least variance within them (`levels.class_means`), from the histograms of the whole image.

    Raises
    ------
    InputError
        When the image holds only nodata, or fewer grey values than levels.
    """
    filled = np.flatnonzero(counts)
    if filled.size == 0:
        raise InputError(f"{name}: holds nothing but nodata; check the file and its nodata value")
    darkest = percentile(counts, parameters.lowest_percentile)
    brightest = percentile(counts, parameters.highest_percentile)
    if not brightest > darkest:
        darkest, brightest = (float(value) for value in bin_values(filled[[0, -1]]))
    if filled.size < parameters.levels or not brightest > darkest:
        raise InputError(
            f"{name}: holds {filled.size} grey values, fewer than the {parameters.levels} levels asked for; "
            "use --set levels=n"
        )
    grey = np.rint(stretch(bin_values(filled)[None], darkest, brightest)[0]).astype(np.int64)
    of_grey = np.bincount(grey, counts[filled], int(LARGEST_GREY) + 1).astype(np.int64)
    try:
        means = class_means(of_grey, parameters.levels)
    except ValueError as error:
        raise InputError(f"{name}: {error}; use --set levels=n") from None
    gap = (means[-1] - means[0]) / (means.size - 1) * (brightest - darkest) / LARGEST_GREY
    deviation = parameters.noise if parameters.noise is not None else max(LEAST_NOISE, noise(differences) / gap)
    return LevelScale(darkest, brightest, tuple(float(mean) for mean in means), float(deviation))
