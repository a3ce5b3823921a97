"""`diffusion` on the device: one launch a step, which reads u and I once and writes u once.

A block of threads takes a tile of u with all that a step needs around it into shared memory and there makes the
Gaussian sums down the columns, then along the rows, in the CPU's order.  Two arrays of u take turns.

What a rule returns is wrapped in `np.float32` before it goes on: a simulated rule returns a number of Python, and the
next one would be computed in double precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.simulated import simulating
from tilepipe_kernels.image.diffusion_loops import CURVATURE, EXPONENTIAL, Terms, Window
from tilepipe_kernels.image.diffusion_rules import (
    exponential_flux,
    flowed,
    limited,
    moved_by_curvature,
    rational_flux,
    with_pair,
)

# A simulated thread is one of Python.  Two warps lie side by side, so that what they read is contiguous.
TILE_ROWS, TILE_COLUMNS = (14, 14) if simulating() else (40, 64)
THREAD_ROWS, THREAD_COLUMNS = (1, 2) if simulating() else (4, 64)

# Tiles of a larger reach would mostly be margin: the sums then go through the memory of the device.
LARGEST_REACH = 5 if simulating() else 10

MISSING = np.float32(np.nan)


@cuda.jit(device=True)
def _value(u: Any, row: int, column: int, rows: int, columns: int) -> np.float32:
    """Value of a pixel; missing outside the block."""
    return u[row, column] if row >= 0 and row < rows and column >= 0 and column < columns else MISSING


@cuda.jit(device=True)
def _step_in_tile(
    tile: Any, sums: Any, smooth: Any, given: Any, result: Any, top: int, left: int, bottom: int, right: int,
    weights: Any, time_step: np.float32, conductance: np.float32, fidelity: np.float32, gaps: bool | None,
) -> None:  # fmt: skip
    """Step of the tile whose first result, `reach` rows and columns inside it, is the pixel (top, left)."""
    radius, first, column = len(weights) - 1, cuda.threadIdx.y, cuda.threadIdx.x
    for i in range(first + radius, TILE_ROWS - radius, THREAD_ROWS):
        for j in range(column, TILE_COLUMNS, THREAD_COLUMNS):
            here = tile[i, j]
            total = weights[0] * here
            for k in range(1, radius + 1):
                total = np.float32(with_pair(total, weights[k], tile[i - k, j], tile[i + k, j], here, gaps))
            sums[i, j] = total
    cuda.syncthreads()
    for i in range(first + radius, TILE_ROWS - radius, THREAD_ROWS):
        for j in range(column + radius, TILE_COLUMNS - radius, THREAD_COLUMNS):
            here = sums[i, j]
            total = weights[0] * here
            for k in range(1, radius + 1):
                total = np.float32(with_pair(total, weights[k], sums[i, j - k], sums[i, j + k], here, gaps))
            smooth[i, j] = total
    cuda.syncthreads()
    reach = radius + 1
    for i in range(first + reach, min(TILE_ROWS - reach, bottom - top + reach), THREAD_ROWS):
        for j in range(column + reach, min(TILE_COLUMNS - reach, right - left + reach), THREAD_COLUMNS):
            row, at = top + i - reach, left + j - reach
            near = (
                tile[i - 1, j - 1], tile[i - 1, j], tile[i - 1, j + 1], tile[i, j - 1], tile[i, j], tile[i, j + 1],
                tile[i + 1, j - 1], tile[i + 1, j], tile[i + 1, j + 1],
            )  # fmt: skip
            smoothed = (smooth[i - 1, j], smooth[i, j - 1], smooth[i, j], smooth[i, j + 1], smooth[i + 1, j])
            pixel = given[row, at]
            moved = moved_by_curvature(near, smoothed, pixel, time_step, conductance, fidelity, gaps)
            result[row, at] = limited(np.float32(moved), near, pixel, gaps)


@grid
def _curvature_step(
    u: Any, given: Any, result: Any, top: int, left: int, bottom: int, right: int, weights: Any,
    time_step: np.float32, conductance: np.float32, fidelity: np.float32,
) -> None:  # fmt: skip
    """One step of the window (top, left, bottom, right), tile by tile."""
    tile = cuda.shared.array((TILE_ROWS, TILE_COLUMNS), np.float32)
    sums = cuda.shared.array((TILE_ROWS, TILE_COLUMNS), np.float32)
    smooth = cuda.shared.array((TILE_ROWS, TILE_COLUMNS), np.float32)
    rows, columns = u.shape
    reach = len(weights)
    first_row = top + cuda.blockIdx.y * (TILE_ROWS - 2 * reach)
    first_column = left + cuda.blockIdx.x * (TILE_COLUMNS - 2 * reach)
    missing = 0
    for i in range(cuda.threadIdx.y, TILE_ROWS, THREAD_ROWS):
        for j in range(cuda.threadIdx.x, TILE_COLUMNS, THREAD_COLUMNS):
            value = _value(u, first_row + i - reach, first_column + j - reach, rows, columns)
            tile[i, j] = value
            missing |= value != value
    # also the barrier behind which the tile is whole
    if cuda.syncthreads_or(missing):
        _step_in_tile(
            tile, sums, smooth, given, result, first_row, first_column, bottom, right, weights, time_step,
            conductance, fidelity, True,
        )  # fmt: skip
    else:
        _step_in_tile(
            tile, sums, smooth, given, result, first_row, first_column, bottom, right, weights, time_step,
            conductance, fidelity, None,
        )  # fmt: skip


@grid
def _sums_down(count: int, u: Any, sums: Any, weights: Any) -> None:
    rows, columns = u.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        row, column = p // columns, p % columns
        here = u[row, column]
        total = weights[0] * here
        for k in range(1, weights.size):
            above, below = _value(u, row - k, column, rows, columns), _value(u, row + k, column, rows, columns)
            total = np.float32(with_pair(total, weights[k], above, below, here, True))
        sums[row, column] = total


@grid
def _sums_along(count: int, sums: Any, smooth: Any, weights: Any) -> None:
    rows, columns = sums.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        row, column = p // columns, p % columns
        here = sums[row, column]
        total = weights[0] * here
        for k in range(1, weights.size):
            before, after = _value(sums, row, column - k, rows, columns), _value(sums, row, column + k, rows, columns)
            total = np.float32(with_pair(total, weights[k], before, after, here, True))
        smooth[row, column] = total


@grid
def _curvature_step_from_smooth(
    count: int, u: Any, smooth: Any, given: Any, result: Any, time_step: np.float32, conductance: np.float32,
    fidelity: np.float32,
) -> None:  # fmt: skip
    rows, columns = u.shape
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = p // columns, p % columns
        near = (
            _value(u, i - 1, j - 1, rows, columns), _value(u, i - 1, j, rows, columns),
            _value(u, i - 1, j + 1, rows, columns), _value(u, i, j - 1, rows, columns), u[i, j],
            _value(u, i, j + 1, rows, columns), _value(u, i + 1, j - 1, rows, columns),
            _value(u, i + 1, j, rows, columns), _value(u, i + 1, j + 1, rows, columns),
        )  # fmt: skip
        smoothed = (
            _value(smooth, i - 1, j, rows, columns), _value(smooth, i, j - 1, rows, columns), smooth[i, j],
            _value(smooth, i, j + 1, rows, columns), _value(smooth, i + 1, j, rows, columns),
        )  # fmt: skip
        moved = moved_by_curvature(near, smoothed, given[i, j], time_step, conductance, fidelity, True)
        result[i, j] = limited(np.float32(moved), near, given[i, j], True)


@grid
def _perona_malik_step(
    u: Any, result: Any, top: int, left: int, bottom: int, right: int, exponential: bool, time_step: np.float32,
    inverse_squared: np.float32,
) -> None:  # fmt: skip
    """One step of the window (top, left, bottom, right), a thread a pixel; what neighbours share is in the caches."""
    rows, columns = u.shape
    i = top + cuda.blockIdx.y * THREAD_ROWS + cuda.threadIdx.y
    j = left + cuda.blockIdx.x * THREAD_COLUMNS + cuda.threadIdx.x
    if i < bottom and j < right:
        here = u[i, j]
        n, s = _value(u, i - 1, j, rows, columns), _value(u, i + 1, j, rows, columns)
        w, e = _value(u, i, j - 1, rows, columns), _value(u, i, j + 1, rows, columns)
        if exponential:
            n = np.float32(exponential_flux(n, here, inverse_squared, True))
            w = np.float32(exponential_flux(w, here, inverse_squared, True))
            e = np.float32(exponential_flux(e, here, inverse_squared, True))
            s = np.float32(exponential_flux(s, here, inverse_squared, True))
        else:
            n = np.float32(rational_flux(n, here, inverse_squared, True))
            w = np.float32(rational_flux(w, here, inverse_squared, True))
            e = np.float32(rational_flux(e, here, inverse_squared, True))
            s = np.float32(rational_flux(s, here, inverse_squared, True))
        result[i, j] = flowed(here, n, w, e, s, time_step)


def run_steps(image: Any, window: Window, steps: int, terms: Terms) -> Any:
    """All steps of a float32 device array; its window, as of `diffusion.diffuse`."""
    xp = namespace(image)
    given = xp.where(xp.isfinite(image), image, MISSING)
    u, following, spare = given, xp.empty_like(given), xp.empty_like(given) if steps > 1 else None
    step = _curvature_stepper(given, terms) if terms.model == CURVATURE else _perona_malik_stepper(terms)
    rows, columns = image.shape
    for behind in range(steps - 1, -1, -1):
        grown = behind * terms.reach
        top, bottom = max(0, window[0] - grown), min(rows, window[1] + grown)
        left, right = max(0, window[2] - grown), min(columns, window[3] + grown)
        step(u, following, (top, left, bottom, right))
        u, following = following, spare if u is given else u
    return u[window[0] : window[1], window[2] : window[3]].copy()


def _curvature_stepper(given: Any, terms: Terms) -> Any:
    factors = terms.time_step, terms.strength, terms.fidelity
    xp, reach = namespace(given), terms.reach
    if reach <= LARGEST_REACH:
        # a tuple: its length is known to the compiler, which unrolls the sums
        weights = tuple(terms.weights)

        def in_tiles(u: Any, result: Any, window: Window) -> None:
            top, left, bottom, right = window
            blocks = -(-(right - left) // (TILE_COLUMNS - 2 * reach)), -(-(bottom - top) // (TILE_ROWS - 2 * reach))
            threads = THREAD_COLUMNS, THREAD_ROWS
            _curvature_step.blocks(blocks, threads, u, given, result, top, left, bottom, right, weights, *factors)

        return in_tiles

    sums, smooth, weights = xp.empty_like(given), xp.empty_like(given), xp.asarray(terms.weights)

    def in_passes(u: Any, result: Any, _: Window) -> None:
        _sums_down(u.size, u, sums, weights)
        _sums_along(u.size, sums, smooth, weights)
        _curvature_step_from_smooth(u.size, u, smooth, given, result, *factors)

    return in_passes


def _perona_malik_stepper(terms: Terms) -> Any:
    exponential, factors = terms.model == EXPONENTIAL, (terms.time_step, terms.strength)

    def step(u: Any, result: Any, window: Window) -> None:
        top, left, bottom, right = window
        blocks = -(-(right - left) // THREAD_COLUMNS), -(-(bottom - top) // THREAD_ROWS)
        _perona_malik_step.blocks(blocks, (THREAD_COLUMNS, THREAD_ROWS), u, result, *window, exponential, *factors)

    return step
