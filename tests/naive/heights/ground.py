"""Ground and shape of a surface by looking at every window anew."""

from __future__ import annotations

import math

import numpy as np


def window_lowest(values: np.ndarray, half_width: int) -> np.ndarray:
    """Minimum of the square around every pixel."""
    lowest = np.empty_like(values)
    for i, j in np.ndindex(values.shape):
        rows, columns = (
            slice(max(0, i - half_width), i + half_width + 1),
            slice(max(0, j - half_width), j + half_width + 1),
        )
        lowest[i, j] = values[rows, columns].min()
    return lowest


def window_highest(values: np.ndarray, half_width: int) -> np.ndarray:
    """Maximum of the square around every pixel."""
    return -window_lowest(-values, half_width)


def opening(values: np.ndarray, half_width: int) -> np.ndarray:
    """Opening by a square; infinity is missing and stays out of both steps."""
    eroded = window_lowest(values, half_width)
    opened = window_highest(np.where(np.isinf(eroded), -np.inf, eroded), half_width)
    return np.where(np.isinf(opened), np.inf, opened)


def lowest_of_cells(dsm: np.ndarray, side: int, origin: tuple[int, int]) -> dict[tuple[int, int], float]:
    """Robust minimum of each cell of the global grid."""
    heights: dict[tuple[int, int], list[float]] = {}
    for i, j in np.ndindex(dsm.shape):
        if np.isfinite(dsm[i, j]):
            cell = ((i + origin[0]) // side, (j + origin[1]) // side)
            heights.setdefault(cell, []).append(float(dsm[i, j]))
    return {cell: sorted(values)[1 if len(values) >= 4 else 0] for cell, values in heights.items()}


def is_object(low: np.ndarray, widths: list[int], metres: float, slope: float, step: float) -> np.ndarray:
    """Cells that lose more than terrain may between two openings, each computed from the surface itself."""
    objects = np.isinf(low)
    opened, before = low, 0
    for width in widths:
        after = opening(low, width)
        allowed = min(step, 0.1 + 0.05 * metres * width) + math.sqrt(2) * slope * metres * (width - before)
        objects |= np.nan_to_num(opened - after) > allowed
        opened, before = after, width
    return objects


def plane(ticks: np.ndarray, missing: int, i: int, j: int, half_width: int) -> float:
    """Standard deviation (in ticks) about the plane fitted to the window by lstsq."""
    rows, columns = np.nonzero(ticks != missing)
    near = (abs(rows - i) <= half_width) & (abs(columns - j) <= half_width)
    x, y = columns[near] - j, rows[near] - i
    z = ticks[rows[near], columns[near]].astype(float)
    design = np.stack([np.ones(x.size), x, y], axis=1)
    if ticks[i, j] == missing or x.size < 6 or np.linalg.matrix_rank(design) < 3:
        return math.nan
    fit = np.linalg.lstsq(design, z - z.mean(), rcond=None)[0]
    squares = float(((z - z.mean() - design @ fit) ** 2).sum())
    return math.sqrt(squares / (x.size - 3))


def bend(ticks: np.ndarray, missing: int, i: int, j: int, lag: int) -> float:
    """Least second difference over four directions, in ticks."""
    least = math.inf
    for down, right in ((0, lag), (lag, 0), (lag, lag), (lag, -lag)):
        ends = [(i - down, j - right), (i + down, j + right)]
        if all(0 <= y < ticks.shape[0] and 0 <= x < ticks.shape[1] and ticks[y, x] != missing for y, x in ends):
            least = min(least, abs(sum(int(ticks[end]) for end in ends) - 2 * int(ticks[i, j])))
    return least if ticks[i, j] != missing and least < math.inf else math.nan
