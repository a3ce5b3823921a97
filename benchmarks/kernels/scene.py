"""The scene that the kernels work on: a synthetic city and what the pipeline would have made of it up to there."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tilepipe.synthetic import City, render
from tilepipe_kernels.image import diffusion, histogram, morphology
from tilepipe_kernels.image.fill import fill_voids
from tilepipe_kernels.network import skeleton
from tilepipe_kernels.regions import growing
from tilepipe_kernels.ridges.bar_profile import response_of_bar

Result = TypeVar("Result")

STEPS = 50
TOLERANCE = 4.0
SIGMA = 4.0
LINE_WIDTH = 12.0
LINE_CONTRAST = 40.0
LOW = response_of_bar(LINE_WIDTH / 2, LINE_CONTRAST, SIGMA)
"""Response of the faintest line that is sought: 12 pixels wide, 40 grey levels darker than its sides."""
CAP, SEPARATION = 40, 8.0
BRANCH = 30.0


@dataclass(frozen=True)
class Scene:
    """A square city of ``size`` pixels a side, each part made when first asked for."""

    size: int
    seed: int = 0

    @property
    def megapixels(self) -> float:
        """Number of pixels in millions."""
        return self.size**2 / 1e6

    @cached_property
    def grey(self) -> NDArray[np.float32]:
        """Intensity from 1 to 255 without voids, for no peer knows nodata."""
        intensity = render(City(seed=self.seed, rows=self.size, columns=self.size), "intensity").astype(np.float32)
        intensity[intensity == 0] = np.nan
        filled = fill_voids(intensity, 64)
        return np.nan_to_num(filled, nan=float(np.nanmean(filled)))

    @cached_property
    def grey_bytes(self) -> NDArray[np.uint8]:
        """The same in 8 bits."""
        return self.grey.astype(np.uint8)

    @cached_property
    def diffused(self) -> NDArray[np.float32]:
        """The intensity after the diffusion of `streets`."""
        return diffuse(self.grey, STEPS)

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """Dark regions of some size, cleaned: the streets as the pipeline sees them, ragged borders and all."""
        counts = np.bincount(self.diffused.astype(np.uint8).ravel(), minlength=256)
        threshold = histogram.otsu_classes(counts)[0] + 0.5
        labels = growing.grow_regions(self.diffused, TOLERANCE, maximum=threshold)
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        return morphology.open_mask(morphology.close_mask((sizes >= 2000)[labels], 3.0), 2.0)

    @cached_property
    def skeleton(self) -> NDArray[np.bool_]:
        """The streets' medial axis."""
        return skeleton.medial_axis(self.mask, cap=CAP, separation=SEPARATION)


def diffuse(
    block: NDArray[np.float32], steps: int, core: tuple[int, int, int, int] | None = None
) -> NDArray[np.float32]:
    """The diffusion of `streets` with its default parameters at 0.5 m."""
    return diffusion.diffuse(
        block, steps=steps, time_step=0.5, conductance=0.01, gradient_sigma=1.0, fidelity=0.5, core=core
    )


@dataclass(frozen=True)
class Band:
    """Rows ``start:stop`` to compute from the rows ``low:high``."""

    start: int
    stop: int
    low: int
    high: int

    @property
    def padded(self) -> slice:
        """Rows to read."""
        return slice(self.low, self.high)

    @property
    def core(self) -> slice:
        """Rows to keep of what was read."""
        return slice(self.start - self.low, self.stop - self.low)


def over_bands(function: Callable[[Band], Result], rows: int, halo: int, workers: int) -> list[Result]:
    """Call a function on one band of rows per thread: what a pass does with tiles."""
    edges = np.linspace(0, rows, workers + 1).astype(int).tolist()
    bands = [
        Band(start, stop, max(0, start - halo), min(rows, stop + halo)) for start, stop in itertools.pairwise(edges)
    ]
    if workers == 1:
        return [function(bands[0])]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, bands))
