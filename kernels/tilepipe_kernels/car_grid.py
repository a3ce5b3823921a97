"""Checkerboard Gibbs sampler of the CAR model on the pixels of a grid."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from .car_chain import Variances, check_lengths, moments, run_chain, spread_blocks
from .car_model import Float64, Posterior, Priors
from .car_sweeps import NODE_STREAM
from .compiled import loop
from .random import as_seed, fill_normals


@loop
def _update_rows(
    heights: Float64, present: NDArray[np.uint8], colour: int, first: int, last: int, smooth: float,
    fit: float, seed: np.uint64, sweep: np.uint64, x: Float64, sums: Float64,
) -> None:  # fmt: skip
    """Draw the pixels of one colour of the checkerboard in rows `first` to `last`; x and `present` have a margin."""
    columns = heights.shape[1]
    ids = np.empty(columns // 2 + 1, np.int64)
    noise = np.empty(columns // 2 + 1)
    for i in range(first, last):
        parity = (i + colour) & 1
        size = (columns + 1 - parity) // 2
        for k in range(size):
            ids[k] = i * columns + 2 * k + parity
        fill_normals(ids[:size], seed, sweep, NODE_STREAM, noise)
        here, up, down = x[i + 1], x[i], x[i + 2]
        valid, valid_up, valid_down = present[i + 1], present[i], present[i + 2]
        roughness = misfit = 0.0
        for k in range(size):
            j = 2 * k + parity + 1
            if not valid[j]:
                continue
            total = float(valid_up[j]) + float(valid[j - 1]) + float(valid[j + 1]) + float(valid_down[j])
            pull = up[j] + here[j - 1] + here[j + 1] + down[j]
            height = heights[i, j - 1]
            precision = fit + total * smooth
            value = (fit * height + pull * smooth) / precision + noise[k] / math.sqrt(precision)
            here[j] = value
            d = value - height
            misfit += d * d
            # All neighbours of the second colour are of the first, hence final.
            if colour:
                roughness += valid_up[j] * (value - up[j]) ** 2 + valid[j - 1] * (value - here[j - 1]) ** 2
                roughness += valid[j + 1] * (value - here[j + 1]) ** 2 + valid_down[j] * (value - down[j]) ** 2
        sums[i, 0] = roughness + (sums[i, 0] if colour else 0.0)
        sums[i, 1] = misfit + (sums[i, 1] if colour else 0.0)


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


def _grid_components(valid: NDArray[np.bool_]) -> int:
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
    the flat indices of the pixels.

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
    """
    check_lengths(burn_in, draws, thinning, workers)
    array = np.asarray(heights)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"heights must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    if not (0 <= spread < math.inf and 0 <= spread_count < math.inf):
        raise ValueError(f"spread and spread_count must be 0 or more, not {spread} and {spread_count}")
    array = np.ascontiguousarray(array, dtype=np.float64)
    valid = ~np.isnan(array)
    if not valid.any() or np.isinf(array).any():
        raise ValueError("heights must have a valid pixel, and be finite or NaN")
    rows, key = array.shape[0], as_seed(seed)
    present, x = np.pad(valid.astype(np.uint8), 1), np.pad(np.where(valid, array, 0.0), 1)
    shift, square, sums = np.zeros(array.shape), np.zeros(array.shape), np.zeros((rows, 2))
    ones, known = np.ones(int(valid.sum())), array[valid]
    variances = Variances.start(
        priors or Priors(), len(known) - _grid_components(valid), ones, known, spread, len(known) + spread_count,
        fixed_variance, key,
    )  # fmt: skip
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(workers)) if workers > 1 else None

        def draw(variances: Variances, sweep: int) -> tuple[float, float]:
            smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)
            for colour in (0, 1):

                def work(first: int, last: int, colour: int = colour) -> None:
                    _update_rows(array, present, colour, first, last, smooth, fit, key, at, x, sums)

                spread_blocks(pool, workers, work, 0, rows)
            roughness, misfit = sums.sum(axis=0)
            return float(roughness), float(misfit)

        def keep() -> None:
            def work(first: int, last: int) -> None:
                _add_rows(array, present, x, first, last, shift, square)

            spread_blocks(pool, workers, work, 0, rows)

        traces = run_chain(draw, keep, variances, burn_in, draws, thinning)
    mean, sd = moments(array, shift, square, draws)
    sd[~valid] = np.nan
    return Posterior(*traces, mean, sd, None)
