"""Energy of the coupled intensity and line fields (`edges`; Barbosa 1994, after Geman & Geman 1984).

Two fields lie on one grid: labels x on the pixels and line elements on the cracks between them, h[i, j] between the
pixels (i, j) and (i + 1, j), v[i, j] between (i, j) and (i, j + 1); 1 = there is an edge.  With the observed grey
values y in units in which adjacent labels differ by one::

    U = Σ_pixels (y - x)² / (2 σ²)  +  Σ_pairs β f(x_s - x_t)                        intensity
      + Σ_elements α (x_s - x_t)² (1 - e)                                            lines: contrast
      + Σ_elements γ e |e_before - e_after|  +  Σ_corners ξ h v  +  Σ_triples ζ e_above e e_below

where s, t are the two pixels that an element parts, `before` and `after` the collinear elements that continue it, a
corner the two perpendicular elements of one pixel that meet there, and a triple three parallel elements in adjacent
rows (h) or columns (v).  f(d) = d² is the quadratic potential and ``f(d) = -1/(1 + |d|)`` the reciprocal one.

A term is counted only if everything it speaks of exists and is committed: no pixel without data, no element beside
one or beyond the raster, no label or element that is still `UNCOMMITTED`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import as_array, namespace
from tilepipe_kernels.core.compiled import rule

UNCOMMITTED = np.uint8(255)
"""Label or element that has no value (yet); also the label of a pixel without data."""

MAXIMUM_LEVELS = 254

_ONE = np.float32(1)
_HALF = np.float32(0.5)

Floats = NDArray[np.float32]
Field = NDArray[np.uint8]
Counts = NDArray[np.int64]
Window = tuple[slice, slice]


@dataclass(frozen=True)
class EdgeModel:
    """Parameters of the energy; the defaults are Barbosa's (1994).

    Parameters
    ----------
    levels
        Number of labels K: label k has the grey value k.  2 to 254.
    potential
        f of the intensity pairs: "quadratic" or "reciprocal".
    alpha, gamma, xi, zeta
        Weights of contrast without a line, of a line that breaks off, of a corner, of three parallel lines.
    beta
        Weight of the intensity pairs.
    sigma
        Standard deviation of the noise, grey levels.

    Raises
    ------
    ValueError
        For a parameter out of its range.

    Examples
    --------
    The reciprocal potential: equal labels cost least, and beyond some difference all cost nearly the same.

    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> EdgeModel(levels=4).pairwise()[0].astype(float).round(2).tolist()
    [-1.0, -0.5, -0.33, -0.25]
    >>> EdgeModel(levels=4, potential="quadratic").pairwise()[0].tolist()
    [0.0, 1.0, 4.0, 9.0]
    """

    levels: int = 2
    potential: Literal["quadratic", "reciprocal"] = "reciprocal"
    alpha: float = 0.5
    gamma: float = 0.5
    xi: float = 0.5
    zeta: float = 0.5
    beta: float = 1.0
    sigma: float = 0.3

    def __post_init__(self) -> None:
        if not 2 <= self.levels <= MAXIMUM_LEVELS:
            raise ValueError(f"levels must be from 2 to {MAXIMUM_LEVELS}, not {self.levels}")
        if self.potential not in ("quadratic", "reciprocal"):
            raise ValueError(f"potential must be 'quadratic' or 'reciprocal', not {self.potential!r}")
        for name in ("alpha", "gamma", "xi", "zeta", "beta"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and 0 or more, not {value}")
        if not 0 < self.sigma < math.inf:
            raise ValueError(f"sigma must be finite and more than 0 grey levels, not {self.sigma}")

    @property
    def reciprocal(self) -> bool:
        """Whether the potential is the reciprocal one, as the rules take it."""
        return self.potential == "reciprocal"

    def pairwise(self) -> Floats:
        """Table of β f(a - b), float32 (K, K)."""
        label = np.arange(self.levels, dtype=np.float64)
        difference = np.abs(label[:, None] - label)
        f = -1 / (1 + difference) if self.reciprocal else difference**2
        return (self.beta * f).astype(np.float32)


# ------------------------------------------------------------------------------------------------- site rules


@rule
def potential(difference: np.float32, reciprocal: bool) -> np.float32:
    """Intensity potential f of the difference of two labels: -1/(1 + |d|) or d²; in the precision of its argument."""
    if reciprocal:
        return -_ONE / (_ONE + abs(difference))
    return difference * difference


@rule
def data_energy(observed: np.float32, label: np.float32, sigma: np.float32) -> np.float32:
    """(y - x)² / (2 σ²)."""
    residual = observed - label
    return residual * residual * (_HALF / (sigma * sigma))


@rule
def pair_energy(
    label: int, other: int, element: int, beta: np.float32, alpha: np.float32, reciprocal: bool
) -> np.float32:
    """Energy of two adjacent labels and the element between them: β f + α d² (1 - e), as far as committed.

    Parameters
    ----------
    label, other
        Labels; 255 counts for nothing.
    element
        0 or 1; 255 leaves out the second term, as the sequential form does.
    """
    zero = beta - beta  # in the precision of the parameters
    if label == UNCOMMITTED or other == UNCOMMITTED:
        return zero
    difference = zero + np.float32(np.int32(label) - np.int32(other))
    energy = beta * potential(difference, reciprocal)
    return energy + (alpha * (difference * difference) if element == 0 else zero)


@rule
def label_energy(
    observed: np.float32, label: int,
    up: int, left: int, right: int, down: int,
    line_up: int, line_left: int, line_right: int, line_down: int,
    beta: np.float32, sigma: np.float32, alpha: np.float32, reciprocal: bool,
) -> np.float32:  # fmt: skip
    """All terms of the energy that a pixel's label is in: its data and its four pairs.

    Parameters
    ----------
    observed, label
        Of the pixel; the label is committed.
    up, left, right, down
        Labels of its neighbours; 255 where uncommitted, without data or beyond the raster.
    line_up, line_left, line_right, line_down
        Elements between the pixel and each; 255 where uncommitted or when lines are not looked at.
    beta, sigma, alpha, reciprocal
        Of the model.
    """
    energy = data_energy(observed, np.float32(label), sigma)
    energy += pair_energy(label, up, line_up, beta, alpha, reciprocal)
    energy += pair_energy(label, left, line_left, beta, alpha, reciprocal)
    energy += pair_energy(label, right, line_right, beta, alpha, reciprocal)
    return energy + pair_energy(label, down, line_down, beta, alpha, reciprocal)


@rule
def breaks_off(before: int, element: int, after: int) -> int:
    """1 if an element is continued on one side only, else 0; 0 if one of the three is 255."""
    return 1 if element == 1 and (before | after) < 2 and before != after else 0


@rule
def turns(first: int, second: int) -> int:
    """1 if two perpendicular elements of a pixel that meet at its corner are both edges, else 0."""
    return 1 if first == 1 and second == 1 else 0


@rule
def crowds(above: int, element: int, below: int) -> int:
    """1 if three parallel elements side by side are all edges, else 0."""
    return 1 if above == 1 and element == 1 and below == 1 else 0


@rule
def element_energy(
    element: int, contrast: np.float32,
    second_before: int, before: int, after: int, second_after: int,
    second_above: int, above: int, below: int, second_below: int,
    corner_a: int, corner_b: int, corner_c: int, corner_d: int,
    alpha: np.float32, gamma: np.float32, xi: np.float32, zeta: np.float32,
) -> np.float32:  # fmt: skip
    """All terms of the line energy that an element is in: its own, and those of the elements within two of it.

    Parameters
    ----------
    element
        0 or 1, committed.
    contrast
        Squared difference of the two labels that it parts; 0 if one is uncommitted.
    second_before, before, after, second_after
        Collinear elements along it; 255 where uncommitted or where there is none.
    second_above, above, below, second_below
        Parallel elements across it, likewise.
    corner_a, corner_b, corner_c, corner_d
        The four perpendicular elements of its two pixels that touch its ends, in any order.
    alpha, gamma, xi, zeta
        Of the model.
    """
    broken = breaks_off(before, element, after)
    broken += breaks_off(second_before, before, element) + breaks_off(element, after, second_after)
    corners = turns(element, corner_a) + turns(element, corner_b) + turns(element, corner_c) + turns(element, corner_d)
    crowded = crowds(above, element, below)
    crowded += crowds(second_above, above, element) + crowds(element, below, second_below)
    energy = alpha * contrast if element == 0 else contrast - contrast
    return energy + gamma * np.float32(broken) + xi * np.float32(corners) + zeta * np.float32(crowded)


# ------------------------------------------------------------------------------------------------- checks


def checked_observed(observed: ArrayLike) -> Floats:
    """Observed grey values as a contiguous float32 block, where they lie.

    Raises
    ------
    ValueError
        For an array that is not two-dimensional and real.
    """
    array: NDArray[Any] = as_array(observed)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"observed must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    block: Floats = namespace(array).ascontiguousarray(array, dtype=np.float32)
    return block


def checked_field(name: str, field: ArrayLike, shape: tuple[int, ...], values: int) -> Field:
    """Labels or elements as a contiguous uint8 block of values below `values`, or 255, where they lie.

    Raises
    ------
    ValueError
        For another shape, or other values.
    """
    array: NDArray[Any] = as_array(field)
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape} of the observed block, not {array.shape}")
    if array.dtype.kind not in "bui":
        raise ValueError(f"{name} must be integers, not {array.dtype}")
    if array.size and not bool(((array >= 0) & (array < values) | (array == UNCOMMITTED)).all()):
        raise ValueError(f"{name} must be from 0 to {values - 1}, or 255 where uncommitted")
    block: Field = namespace(array).ascontiguousarray(array, dtype=np.uint8)
    return block


def checked_elements(
    horizontal: ArrayLike | None, vertical: ArrayLike | None, like: NDArray[Any]
) -> tuple[Field, Field]:
    """Both fields of elements as `checked_field` gives them; None: no element is committed.

    Raises
    ------
    ValueError
        As `checked_field`.
    """
    xp = namespace(like, horizontal, vertical)

    def checked(name: str, field: ArrayLike | None) -> Field:
        uncommitted: Field = xp.full(like.shape, UNCOMMITTED)
        return uncommitted if field is None else checked_field(name, field, like.shape, 2)

    return checked("horizontal", horizontal), checked("vertical", vertical)
