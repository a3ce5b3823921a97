"""What the energy of edge_model.py is made of, counted over a block or over the core of a tile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compiled import loop
from .edge_model import (
    UNCOMMITTED,
    Counts,
    EdgeModel,
    Field,
    Floats,
    Window,
    breaks_off,
    checked_field,
    checked_observed,
    crowds,
    turns,
)


class EnergyTerms(NamedTuple):
    """What the energy of a block, or of its core, is made of; those of the cores of a tiling add up to the whole.

    Attributes
    ----------
    squares
        Σ (y - x)², grey levels squared.
    differences
        int64 (K,): pairs of committed neighbours whose labels differ by d.
    unparted
        Σ (x_s - x_t)² over the elements that are 0.
    broken, corners, crowded
        Elements continued on one side only, corners turned, triples of parallel elements.
    """

    squares: float
    differences: Counts
    unparted: int
    broken: int
    corners: int
    crowded: int

    def __add__(self, other: EnergyTerms) -> EnergyTerms:  # type: ignore[override]
        """Terms of two cores that do not overlap."""
        return EnergyTerms(
            self.squares + other.squares,
            self.differences + other.differences,
            self.unparted + other.unparted,
            self.broken + other.broken,
            self.corners + other.corners,
            self.crowded + other.crowded,
        )

    def intensity(self, model: EdgeModel) -> float:
        """Σ (y - x)² / (2 σ²) + Σ β f."""
        d = np.arange(self.differences.size, dtype=np.float64)
        f = -1 / (1 + d) if model.reciprocal else d**2
        return self.squares / (2 * model.sigma**2) + model.beta * float(f @ self.differences)

    def lines(self, model: EdgeModel) -> float:
        """Contrast, continuity, corners and parallels."""
        return (
            model.alpha * self.unparted
            + model.gamma * self.broken
            + model.xi * self.corners
            + model.zeta * self.crowded
        )

    def total(self, model: EdgeModel) -> float:
        """U."""
        return self.intensity(model) + self.lines(model)


@loop
def _existing(horizontal: Field, vertical: Field, has_data: NDArray[np.bool_]) -> tuple[Field, Field]:
    """The elements framed by two of 255, and 255 where there is none: the rules then count what exists."""
    rows, columns = has_data.shape
    h = np.full((rows + 4, columns + 4), UNCOMMITTED)
    v = np.full((rows + 4, columns + 4), UNCOMMITTED)
    for i in range(rows):
        for j in range(columns):
            if has_data[i, j]:
                if i + 1 < rows and has_data[i + 1, j]:
                    h[i + 2, j + 2] = horizontal[i, j]
                if j + 1 < columns and has_data[i, j + 1]:
                    v[i + 2, j + 2] = vertical[i, j]
    return h, v


@loop
def _count_lines(h: Field, v: Field, top: int, bottom: int, left: int, right: int) -> tuple[int, int, int]:
    """Broken elements, corners and crowded triples of the sites top..bottom, left..right of the unframed block."""
    broken = corners = crowded = 0
    for i in range(top + 2, bottom + 2):
        for j in range(left + 2, right + 2):
            broken += breaks_off(h[i, j - 1], h[i, j], h[i, j + 1]) + breaks_off(v[i - 1, j], v[i, j], v[i + 1, j])
            crowded += crowds(h[i - 1, j], h[i, j], h[i + 1, j]) + crowds(v[i, j - 1], v[i, j], v[i, j + 1])
            corners += turns(h[i - 1, j], v[i, j - 1]) + turns(h[i - 1, j], v[i, j])
            corners += turns(h[i, j], v[i, j - 1]) + turns(h[i, j], v[i, j])
    return broken, corners, crowded


@loop
def _count_pairs(
    observed: Floats, labels: Field, h: Field, v: Field,
    top: int, bottom: int, left: int, right: int, differences: Counts,
) -> tuple[float, np.int64]:  # fmt: skip
    """Σ (y - x)² and Σ d² without a line, of the same sites; a pair belongs to its upper or left pixel."""
    rows, columns = labels.shape
    squares = 0.0
    unparted = np.int64(0)
    for i in range(top, bottom):
        for j in range(left, right):
            if labels[i, j] == UNCOMMITTED or np.isnan(observed[i, j]):
                continue
            label = np.int64(labels[i, j])
            residual = np.float64(observed[i, j]) - label
            squares += residual * residual
            if i + 1 < rows and labels[i + 1, j] != UNCOMMITTED and not np.isnan(observed[i + 1, j]):
                d = abs(label - np.int64(labels[i + 1, j]))
                differences[d] += 1
                unparted += d * d * (h[i + 2, j + 2] == 0)
            if j + 1 < columns and labels[i, j + 1] != UNCOMMITTED and not np.isnan(observed[i, j + 1]):
                d = abs(label - np.int64(labels[i, j + 1]))
                differences[d] += 1
                unparted += d * d * (v[i + 2, j + 2] == 0)
    return squares, unparted


def energy_terms(
    observed: ArrayLike,
    labels: ArrayLike,
    horizontal: ArrayLike | None,
    vertical: ArrayLike | None,
    levels: int,
    *,
    core: Window = (slice(None), slice(None)),
) -> EnergyTerms:
    """Count what the energy of a block is made of.

    Parameters
    ----------
    observed
        Grey values y, shape (rows, columns), float32; NaN = no data.
    labels
        uint8, same shape: 0..levels - 1, or 255 where uncommitted or without data.
    horizontal, vertical
        Elements h and v, uint8, same shape: 0, 1, or 255 where uncommitted; those that do not exist (last row of h,
        last column of v, beside a pixel without data) are not looked at.  None: no element is committed.
    levels
        Number of labels K.
    core
        Rows and columns whose terms are counted.  A pair belongs to its upper or left pixel, an element and its
        triples to the pixel above or left of it, a corner to its pixel; the block must go on by 2 beyond the core
        for these to be the terms of the whole.

    Returns
    -------
    EnergyTerms

    Raises
    ------
    ValueError
        For arrays of different shapes, labels or elements out of range.
    """
    y = checked_observed(observed)
    x = checked_field("labels", labels, y.shape, levels)
    h, v = (
        np.full(y.shape, UNCOMMITTED) if field is None else checked_field(name, field, y.shape, 2)
        for name, field in (("horizontal", horizontal), ("vertical", vertical))
    )
    (top, bottom, _), (left, right, _) = (part.indices(n) for part, n in zip(core, y.shape, strict=True))
    h, v = _existing(h, v, ~np.isnan(y))
    differences = np.zeros(levels, np.int64)
    squares, unparted = _count_pairs(y, x, h, v, top, bottom, left, right, differences)
    return EnergyTerms(squares, differences, int(unparted), *_count_lines(h, v, top, bottom, left, right))


def energy(
    observed: ArrayLike,
    labels: ArrayLike,
    horizontal: ArrayLike | None,
    vertical: ArrayLike | None,
    model: EdgeModel,
) -> float:
    """U of a configuration; arguments and errors as `energy_terms`."""
    return energy_terms(observed, labels, horizontal, vertical, model.levels).total(model)
