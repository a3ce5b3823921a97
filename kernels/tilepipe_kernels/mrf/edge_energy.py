"""What the energy of `mrf.edge_model` is made of, counted over a block or over the core of a tile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device, to_host
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.sums import ordered_sum
from tilepipe_kernels.mrf.edge_model import (
    UNCOMMITTED,
    Counts,
    EdgeModel,
    Field,
    Floats,
    Window,
    breaks_off,
    checked_elements,
    checked_field,
    checked_observed,
    crowds,
    turns,
)

PIECE = 64
"""Pixels of a row whose squares are summed in order; the sums of pieces are then summed."""

Bounds = tuple[int, int, int, int]


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


# ------------------------------------------------------------------------------------------------- counting


@rule
def known(label: np.uint8, observed: np.float32) -> bool:
    """Whether a pixel has data and a committed label."""
    return bool((label != UNCOMMITTED) & (observed == observed))


@rule
def squared_residual(observed: np.float32, label: np.uint8) -> np.float64:
    """(y - x)², in float64."""
    residual = np.float64(observed) - np.float64(label)
    return residual * residual


@rule
def difference(label: np.uint8, other: np.uint8) -> np.int64:
    """|x_s - x_t|."""
    return abs(np.int64(label) - np.int64(other))


@rule
def unparted_square(d: np.int64, element: np.uint8) -> np.int64:
    """d² of a pair without a line between."""
    return d * d * np.int64(element == 0)


@rule
def corners_of(above: int, below: int, left: int, right: int) -> int:
    """Corners turned at a pixel, given its four elements."""
    return turns(above, left) + turns(above, right) + turns(below, left) + turns(below, right)


@loop
def _existing(horizontal: Field, vertical: Field, observed: Floats, h: Field, v: Field) -> None:
    rows, columns = observed.shape
    for i in range(rows):
        for j in range(columns):
            if not np.isnan(observed[i, j]):
                if i + 1 < rows and not np.isnan(observed[i + 1, j]):
                    h[i + 2, j + 2] = horizontal[i, j]
                if j + 1 < columns and not np.isnan(observed[i, j + 1]):
                    v[i + 2, j + 2] = vertical[i, j]


def _framed(elements: tuple[Field, Field], observed: Floats) -> tuple[Field, Field]:
    """The elements framed by two of 255, and 255 where there is none: the rules then count what exists."""
    rows, columns = observed.shape
    h, v = (namespace(observed).full((rows + 4, columns + 4), UNCOMMITTED) for _ in range(2))
    fill = device_form(__name__).existing if on_device(observed) else _existing
    fill(*elements, observed, h, v)
    return h, v


@loop
def _count_lines(h: Field, v: Field, bounds: Bounds, counts: Counts) -> None:
    top, bottom, left, right = bounds
    broken = corners = crowded = 0
    for i in range(top + 2, bottom + 2):
        for j in range(left + 2, right + 2):
            broken += breaks_off(h[i, j - 1], h[i, j], h[i, j + 1]) + breaks_off(v[i - 1, j], v[i, j], v[i + 1, j])
            corners += corners_of(h[i - 1, j], h[i, j], v[i, j - 1], v[i, j])
            crowded += crowds(h[i - 1, j], h[i, j], h[i + 1, j]) + crowds(v[i, j - 1], v[i, j], v[i, j + 1])
    counts[1], counts[2], counts[3] = broken, corners, crowded


@loop
def _count_pairs(
    observed: Floats, labels: Field, h: Field, v: Field, bounds: Bounds, differences: Counts, counts: Counts,
    squares: NDArray[np.float64],
) -> None:  # fmt: skip
    rows, columns = labels.shape
    top, bottom, left, right = bounds
    pieces = squares.shape[1]
    unparted = np.int64(0)
    for i in range(top, bottom):
        for piece in range(pieces):
            first = left + piece * PIECE
            total = 0.0
            for j in range(first, min(first + PIECE, right)):
                if not known(labels[i, j], observed[i, j]):
                    continue
                total += squared_residual(observed[i, j], labels[i, j])
                if i + 1 < rows and known(labels[i + 1, j], observed[i + 1, j]):
                    d = difference(labels[i, j], labels[i + 1, j])
                    differences[d] += 1
                    unparted += unparted_square(d, h[i + 2, j + 2])
                if j + 1 < columns and known(labels[i, j + 1], observed[i, j + 1]):
                    d = difference(labels[i, j], labels[i, j + 1])
                    differences[d] += 1
                    unparted += unparted_square(d, v[i + 2, j + 2])
            squares[i - top, piece] = total
    counts[0] = unparted


def _count(
    observed: Floats, labels: Field, h: Field, v: Field, bounds: Bounds, differences: Counts, counts: Counts,
    squares: NDArray[np.float64],
) -> None:  # fmt: skip
    """Count differences of labels; squares without a line, broken, corners, crowded; sum the squares of pieces.

    A pair belongs to its upper or left pixel.  Bounds are those of the core in the unframed block.
    """
    _count_pairs(observed, labels, h, v, bounds, differences, counts, squares)
    _count_lines(h, v, bounds, counts)


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

    Arrays of a device are counted there; the terms are numbers of the host, the very same.

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

    Examples
    --------
    A dark and a bright half, and an edge between them in three of four rows.

    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_energy import energy_terms
    >>> labels = np.repeat(np.array([[0, 0, 1, 1]], np.uint8), 4, axis=0)
    >>> vertical = np.array([[0, 1, 0, 0]] * 3 + [[0, 0, 0, 0]], np.uint8)
    >>> terms = energy_terms(labels.astype(np.float32), labels, np.zeros_like(labels), vertical, levels=2)
    >>> terms.differences.tolist(), terms.unparted, terms.broken
    ([20, 4], 1, 1)
    """
    y = checked_observed(observed)
    x = checked_field("labels", labels, y.shape, levels)
    xp = namespace(y, x)
    h, v = _framed(checked_elements(horizontal, vertical, y), y)
    (top, bottom, _), (left, right, _) = (part.indices(n) for part, n in zip(core, y.shape, strict=True))
    differences, counts = xp.zeros(levels, xp.int64), xp.zeros(4, xp.int64)
    squares = xp.zeros((max(bottom - top, 0), -(-max(right - left, 0) // PIECE)), xp.float64)
    count = device_form(__name__).count if on_device(y) else _count
    count(y, x, h, v, (top, bottom, left, right), differences, counts, squares)
    unparted, broken, corners, crowded = to_host(counts).tolist()
    return EnergyTerms(ordered_sum(squares.reshape(-1)), to_host(differences), unparted, broken, corners, crowded)


def energy(
    observed: ArrayLike,
    labels: ArrayLike,
    horizontal: ArrayLike | None,
    vertical: ArrayLike | None,
    model: EdgeModel,
) -> float:
    """U of a configuration; arguments and errors as `energy_terms`.

    Examples
    --------
    An edge where the labels change costs less than no edge there.

    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.edge_energy import energy
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> labels = np.repeat(np.array([[0, 0, 3, 3]], np.uint8), 5, axis=0)
    >>> grey, none = labels.astype(np.float32), np.zeros_like(labels)
    >>> edge = np.repeat(np.array([[0, 1, 0, 0]], np.uint8), 5, axis=0)
    >>> model = EdgeModel(levels=4)
    >>> energy(grey, labels, none, edge, model) < energy(grey, labels, none, none, model)
    True
    """
    return energy_terms(observed, labels, horizontal, vertical, model.levels).total(model)
