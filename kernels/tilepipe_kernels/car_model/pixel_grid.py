"""Checkerboard Gibbs sampler of the CAR model on the pixels of a grid."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.car_model.chain import Variances, check_lengths, moments, run_chain, spread_blocks
from tilepipe_kernels.car_model.model import Float64, Posterior, Priors
from tilepipe_kernels.car_model.sweeps import NODE_STREAM
from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop
from tilepipe_kernels.core.random import as_seed, fill_normals
from tilepipe_kernels.core.sums import sum_of_lanes
from tilepipe_kernels.regions.growing import grow_regions

ROW_LANES = 64
"""Lanes of a row, as `sums` has them for its blocks; rows are shorter."""

Four = tuple[float, float, float, float]
"""Of the neighbours above, left, right and below."""


@inlined_rule
def draw_pixel(height: float, valid: Four, near: Four, smooth: float, fit: float, noise: float) -> float:
    """Draw a pixel given its neighbours' x, 0 where they are nodata, and which of them are valid, 1 or 0."""
    total = valid[0] + valid[1] + valid[2] + valid[3]
    pull = near[0] + near[1] + near[2] + near[3]
    precision = fit + total * smooth
    return (fit * height + pull * smooth) / precision + noise / math.sqrt(precision)


@inlined_rule
def roughness_at(x: float, valid: Four, near: Four) -> float:
    """Sum of squared differences to the valid neighbours."""
    up, left, right, down = x - near[0], x - near[1], x - near[2], x - near[3]
    return valid[0] * (up * up) + valid[1] * (left * left) + (valid[2] * (right * right) + valid[3] * (down * down))


@inlined_rule
def columns_of_colour(columns: int, parity: int) -> int:
    """Columns of a row whose colour starts at column `parity`, 0 or 1."""
    return (columns + 1 - parity) // 2


@loop
def _update_rows(
    heights: Float64, present: NDArray[np.uint8], colour: int, first: int, last: int, smooth: float,
    fit: float, seed: np.uint64, sweep: np.uint64, x: Float64, sums: Float64,
) -> None:  # fmt: skip
    """Draw the pixels of one colour of the checkerboard in rows `first` to `last`; x and `present` have a margin.

    `sums` holds roughness and misfit of each colour and row.
    """
    columns = heights.shape[1]
    ids = np.empty(columns // 2 + 1, np.int64)
    noise = np.empty(columns // 2 + 1)
    rough, misfits = np.zeros(ROW_LANES), np.zeros(ROW_LANES)
    for i in range(first, last):
        parity = (i + colour) & 1
        size = columns_of_colour(columns, parity)
        for k in range(size):
            ids[k] = i * columns + 2 * k + parity
        fill_normals(ids[:size], seed, sweep, NODE_STREAM, noise)
        here, up, down = x[i + 1], x[i], x[i + 2]
        valid, valid_up, valid_down = present[i + 1], present[i], present[i + 2]
        for k in range(size):
            j = 2 * k + parity + 1
            if not valid[j]:
                continue
            which = float(valid_up[j]), float(valid[j - 1]), float(valid[j + 1]), float(valid_down[j])
            near = up[j], here[j - 1], here[j + 1], down[j]
            height = heights[i, j - 1]
            value = draw_pixel(height, which, near, smooth, fit, noise[k])
            here[j] = value
            misfits[k % ROW_LANES] += (value - height) * (value - height)
            # All neighbours of the second colour are of the first, hence final.
            if colour:
                rough[k % ROW_LANES] += roughness_at(value, which, near)
        sums[colour, i, 0], sums[colour, i, 1] = sum_of_lanes(rough, misfits, size)


@loop
def _add_rows(
    heights: Float64, present: NDArray[np.uint8], x: Float64, first: int, last: int, shift: Float64, square: Float64
) -> None:
    for i in range(first, last):
        for j in range(heights.shape[1]):
            if present[i + 1, j + 1]:
                d = x[i + 1, j + 1] - heights[i, j]
                shift[i, j] += d
                square[i, j] += d * d


class _Grid:
    """State of one chain on the host."""

    def __init__(
        self, heights: Float64, valid: NDArray[np.bool_], seed: np.uint64, workers: int, pool: ThreadPoolExecutor | None
    ) -> None:
        self.heights, self.seed, self.spread_out = heights, seed, partial(spread_blocks, pool, workers)
        self.present, self.x = np.pad(valid.astype(np.uint8), 1), np.pad(np.where(valid, heights, 0.0), 1)
        self.shift, self.square = np.zeros(heights.shape), np.zeros(heights.shape)
        self.sums = np.zeros((2, len(heights), 2))

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all pixels; return roughness and misfit."""
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)
        for colour in (0, 1):

            def work(first: int, last: int, colour: int = colour) -> None:
                _update_rows(
                    self.heights, self.present, colour, first, last, smooth, fit, self.seed, at, self.x, self.sums
                )  # fmt: skip

            self.spread_out(work, 0, len(self.heights))
        roughness, misfit = (self.sums[0] + self.sums[1]).sum(axis=0)
        return float(roughness), float(misfit)

    def keep(self) -> None:
        """Add the heights to the sums of their moments."""

        def work(first: int, last: int) -> None:
            _add_rows(self.heights, self.present, self.x, first, last, self.shift, self.square)

        self.spread_out(work, 0, len(self.heights))


def _grid_components(valid: NDArray[np.bool_]) -> int:
    if on_device(valid):
        xp = namespace(valid)
        # the host reads their number
        return int(grow_regions(xp.where(valid, xp.float32(0), xp.float32(xp.nan)), 0).max())
    from scipy.ndimage import label

    return int(label(valid)[1])


def sample_grid(
    heights: Float64,
    *,
    burn_in: int,
    draws: int,
    thinning: int = 1,
    seed: int = 0,
    fixed_variance: float | None = None,
    spread: float = 0.0,
    spread_count: float = 0.0,
    priors: Priors | None = None,
    workers: int = 1,
) -> Posterior:
    """Draw from the same model with every valid pixel a node of count 1, joined to its 4 neighbours with w = 1.

    Two colours of a checkerboard take turns.  The numbers are those that `sample` draws for a graph whose ids are
    the flat indices of the pixels.  Heights of a device are sampled there, to the same bits.

    Parameters
    ----------
    heights
        Real, shape (rows, columns), m; NaN is nodata.
    burn_in, draws, thinning, seed, fixed_variance, workers
        As for `sample`.
    spread, spread_count
        Sum of squared deviations (m²) of further measurements about their pixels, and their number less one for
        each pixel: what s2 is learned from, for one height a pixel cannot tell noise from roughness.
    priors
        Of the variances.

    Returns
    -------
    Posterior
        Mean and standard deviation of shape (rows, columns), NaN at nodata; no edge probabilities.

    Raises
    ------
    ValueError
        For arguments out of their ranges, an array that is not two-dimensional and real, infinite heights or none.

    Examples
    --------
    A plateau of 5 m with a void in it: the mean of the draws is the plateau's height, and the void stays.

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.pixel_grid import sample_grid
    >>> heights = np.full((6, 6), 5.0)
    >>> heights[2, 2] = np.nan
    >>> posterior = sample_grid(heights, burn_in=50, draws=200, fixed_variance=0.01)
    >>> posterior.mean[2].round(1).tolist()
    [5.0, 5.0, nan, 5.0, 5.0, 5.0]
    """
    check_lengths(burn_in, draws, thinning, workers)
    xp = namespace(heights)
    array = xp.asarray(heights)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"heights must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    if not (0 <= spread < math.inf and 0 <= spread_count < math.inf):
        raise ValueError(f"spread and spread_count must be 0 or more, not {spread} and {spread_count}")
    array = xp.ascontiguousarray(array, dtype=xp.float64)
    valid = ~xp.isnan(array)
    if not valid.any() or not (xp.isfinite(array) | ~valid).all():
        raise ValueError("heights must have a valid pixel, and be finite or NaN")
    key, known = as_seed(seed), array[valid]
    variances = Variances.start(
        priors or Priors(), len(known) - _grid_components(valid), xp.ones(len(known)), known, spread,
        len(known) + spread_count, fixed_variance, key,
    )  # fmt: skip
    with ExitStack() as stack:
        if on_device(array):
            chain: Any = device_form(__name__).Grid(array, valid, key)
        else:
            pool = stack.enter_context(ThreadPoolExecutor(workers)) if workers > 1 else None
            chain = _Grid(array, valid, key, workers, pool)
        traces = run_chain(chain.draw, chain.keep, variances, burn_in, draws, thinning)
    mean, sd = moments(array, chain.shift, chain.square, draws)
    sd[~valid] = xp.nan
    return Posterior(*traces, mean, sd, None)
