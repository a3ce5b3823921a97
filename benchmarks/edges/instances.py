"""The labelling problems that the optimisers of `edges` are compared on, and the photograph that most are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure.contest import Unsuitable
from benchmarks.objects.scenes import DATA
from tilepipe.pipelines.edges.pass_bands import LUMINANCE
from tilepipe.synthetic import City, render
from tilepipe_kernels.image.grey_levels import stretch, to_levels
from tilepipe_kernels.image.histogram import class_means, histogram, percentile
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.minimise import minimise
from tilepipe_kernels.mrf.labels.problem import Labels
from tilepipe_kernels.mrf.search import DEFAULT, Search

PHOTOGRAPH = "autzen_north/ortho_rgb_1ft.tif"
SEGMENTATION = "mrf_small/example_SMR.mat"
"""An energy of Osokin & Vetrov (2015), in the form of MATLAB 7.3."""

PERCENTILES = (1.0, 99.0)
"""Percentiles of an image that become black and white."""

MANY = 16
"""Labels of the noisy instances."""
NOISE = 1.0
"""Standard deviation of the noise that they add, in levels."""
LARGEST_MANY, LARGEST_CONVEX = 512, 512
"""Sides of the noisy instances and of the convex one of four labels in pixels."""
STEPS = 32
"""Different weights of pairs that `minimise` is given at most, which costs messages time; more gain next to nothing."""

_NOISY = f"at most {LARGEST_MANY}² pixels, with noise of {NOISE:g} level;"

Floats = NDArray[np.float32]
Field = NDArray[np.uint8]


@dataclass(frozen=True)
class Grey:
    """Grey values 0–255 of an aerial image, float32, and where it is from."""

    values: Floats
    source: str

    def part(self, size: int) -> Grey:
        """The middle, at most ``size`` pixels a side."""
        middle = tuple(slice((n - min(n, size)) // 2, (n + min(n, size)) // 2) for n in self.values.shape)
        return Grey(np.ascontiguousarray(self.values[middle]), self.source)

    def observed(self, count: int) -> Floats:
        """The image in units of a level; levels are the means of the classes of least variance."""
        counts = histogram(self.values)
        darkest, brightest = (percentile(counts, percent) for percent in PERCENTILES)
        grey = stretch(self.values, darkest, brightest)
        of_grey = np.bincount(np.rint(grey).astype(np.int64).ravel(), minlength=256)
        return to_levels(grey, class_means(of_grey, count))

    @cached_property
    def bytes(self) -> Field:
        """The same in 8 bits, for the peers."""
        return np.rint(self.values).astype(np.uint8)


def luminance(bands: NDArray[Any]) -> Floats:
    """Luminance of red, green and blue, (3, rows, columns)."""
    return np.tensordot(np.float32(LUMINANCE), bands[:3].astype(np.float32), axes=1)


def aerial(size: int, data: Path = DATA) -> Grey:
    """The middle of the photograph; where that is not here, the aerial image of the synthetic city."""
    path = data / PHOTOGRAPH
    if not path.is_file():
        return Grey(luminance(render(City(rows=size, columns=size), "aerial")), "synthetic city, aerial image")
    import rasterio

    with rasterio.open(path) as raster:
        return Grey(luminance(raster.read()), "photograph of Autzen at 1 ft").part(size)


# ------------------------------------------------------------------------------------------------- instances


@dataclass(frozen=True)
class Instance:
    """A labelling problem: Σ U + Σ w V over pixels and pairs of 4-adjacent ones.

    Attributes
    ----------
    name
        As in the table.
    unary
        U, float32 (rows, columns, K).
    table
        V, float64 (K, K), symmetric.
    observed, model
        The image and model that U and V follow from, where there are such.
    down, right
        w of the pairs, float64 (rows - 1, columns) and (rows, columns - 1); None = 1 everywhere.
    note
        What else a reader must know.
    """

    name: str
    unary: Floats
    table: NDArray[np.float64]
    observed: Floats | None = None
    model: EdgeModel | None = None
    down: NDArray[np.float64] | None = None
    right: NDArray[np.float64] | None = None
    note: str = ""

    @property
    def megapixels(self) -> float:
        """Number of pixels in millions."""
        return self.unary.shape[0] * self.unary.shape[1] / 1e6

    @property
    def labels(self) -> int:
        """K."""
        return self.unary.shape[2]

    @cached_property
    def _tables(self) -> tuple[NDArray[np.float64], Field | None, Field | None]:
        """Tables of `minimise` and which of them each pair takes: quantiles of the weights."""
        if self.down is None or self.right is None:
            return self.table, None, None
        steps = np.unique(
            np.quantile(np.concatenate([self.down.ravel(), self.right.ravel()]), np.linspace(0, 1, STEPS))
        )
        middles = (steps[1:] + steps[:-1]) / 2
        kinds = np.zeros((2, *self.unary.shape[:2]), np.uint8)
        kinds[0, :-1] = np.searchsorted(middles, self.down)
        kinds[1, :, :-1] = np.searchsorted(middles, self.right)
        return steps[:, None, None] * self.table, kinds[0], kinds[1]

    def solve(self, rows: slice, search: Search = DEFAULT) -> Labels:
        """Labels of some rows, by `intensity_field` or `minimise`."""
        if self.observed is not None and self.model is not None:
            return intensity_field(self.observed[rows], self.model, search=search, origin=(rows.start, 0))
        tables, down, right = self._tables
        chosen = {name: None if kind is None else kind[rows] for name, kind in (("down", down), ("right", right))}
        return minimise(self.unary[rows], tables, **chosen, search=search, origin=(rows.start, 0))

    def corner(self, size: int) -> Instance:
        """The first ``size`` rows and columns as a problem of its own."""
        rows, columns = (min(n, size) for n in self.unary.shape[:2])
        return replace(
            self,
            unary=np.ascontiguousarray(self.unary[:rows, :columns]),
            observed=None if self.observed is None else np.ascontiguousarray(self.observed[:rows, :columns]),
            down=None if self.down is None else self.down[: rows - 1, :columns],
            right=None if self.right is None else self.right[:rows, : columns - 1],
        )

    def energy(self, labels: NDArray[Any]) -> float:
        """Energy of labels, in float64."""
        chosen = labels.astype(np.intp)
        data = np.take_along_axis(self.unary, chosen[..., None], axis=2).sum(dtype=np.float64)
        down, right = self.table[chosen[:-1], chosen[1:]], self.table[chosen[:, :-1], chosen[:, 1:]]
        weights = (1.0 if self.down is None else self.down), (1.0 if self.right is None else self.right)
        return float(data + (weights[0] * down).sum() + (weights[1] * right).sum())


def of_model(name: str, observed: Floats, model: EdgeModel, note: str = "") -> Instance:
    """The intensity field of an image."""
    label = np.arange(model.levels, dtype=np.float32)
    unary = (observed[..., None] - label) ** 2 / np.float32(2 * model.sigma**2)
    return Instance(name, unary, model.pairwise().astype(np.float64), observed, model, note=note)


def noisy(grey: Grey, seed: int = 0) -> Floats:
    """An image in 16 levels with noise of one level."""
    y = grey.part(LARGEST_MANY).observed(MANY)
    return (y + NOISE * np.random.default_rng(seed).standard_normal(y.shape)).astype(np.float32)


def truncated(observed: Floats) -> Instance:
    """Truncated linear potential: what α-expansion is made for."""
    label = np.arange(MANY, dtype=np.float32)
    unary = (observed[..., None] - label) ** 2 / np.float32(2 * NOISE**2)
    table = 0.7 * np.minimum(np.abs(label[:, None] - label), 2).astype(np.float64)
    return Instance(f"K = {MANY}, truncated linear", unary, table, note=f"{_NOISY} U = (y - x)²/2, V = 0.7 min(|d|, 2)")


def segmentation(data: Path = DATA) -> Instance:
    """The Potts energy of `SEGMENTATION`: an image of objects, a weight for each pair of pixels.

    Raises
    ------
    Unsuitable
        When the file is not here, or h5py is not installed.
    """
    path = data / SEGMENTATION
    if not path.is_file():
        raise Unsuitable(f"no file {path}")
    try:
        import h5py
    except ImportError:
        raise Unsuitable("not installed: h5py") from None
    with h5py.File(path) as file:
        stored = file["exampleEnergy"]
        rows, columns, count = (int(stored[name][()].item()) for name in ("nRows", "nCols", "nLabels"))
        unary = stored["unary"][()]
        pairs = stored["pairwisePotts"]
        one, starts, weight = pairs["ir"][()].astype(np.int64), pairs["jc"][()].astype(np.int64), pairs["data"][()]
    # MATLAB counts pixels down the columns; a pair is stored once
    other = np.repeat(np.arange(rows * columns), np.diff(starts))
    first, second = np.minimum(one, other), np.maximum(one, other)
    (left, top), below = np.divmod(first, rows), second - first == 1
    down, right = np.zeros((rows - 1, columns)), np.zeros((rows, columns - 1))
    down[top[below], left[below]] = weight[below]
    right[top[~below], left[~below]] = weight[~below]
    grid = np.ascontiguousarray(unary.reshape(columns, rows, count).swapaxes(0, 1))
    return Instance(
        f"K = {count}, Potts, {rows} × {columns}", grid, 1 - np.eye(count), down=down, right=right,
        note=f"of Osokin & Vetrov (2015); ours takes its {len(np.unique(weight)):,} weights rounded to {STEPS}",
    )  # fmt: skip


def instances(grey: Grey, data: Path = DATA) -> Sequence[Callable[[], Instance]]:
    """All instances, each made when called."""

    def photograph(count: int, potential: Literal["quadratic", "reciprocal"], size: int = 1 << 30) -> Instance:
        observed = grey.part(size).observed(count)
        return of_model(f"K = {count}, {potential}", observed, EdgeModel(count, potential))

    return (
        lambda: photograph(2, "reciprocal"),
        lambda: photograph(2, "quadratic"),
        lambda: photograph(4, "reciprocal"),
        lambda: photograph(4, "quadratic", LARGEST_CONVEX),
        lambda: truncated(noisy(grey)),
        lambda: of_model(
            f"K = {MANY}, reciprocal", noisy(grey), EdgeModel(MANY, sigma=NOISE), f"{_NOISY} β = 1, σ = 1"
        ),
        lambda: segmentation(data),
    )
