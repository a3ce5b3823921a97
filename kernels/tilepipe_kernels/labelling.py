"""A labelling problem on the pixel grid.

Every pixel s takes one of K labels, at the cost Σ_s U_s(x_s) + Σ_st w_st V_st(x_s, x_t) over pixels and pairs of
4-adjacent ones; V_st is one of a few symmetric tables, w_st >= 0 the weight of the pair.  The intensity field of
`edge_model` is the special case U = (y - x)²/(2 σ²), V = β f, w = 1.

The loops walk a block framed by one site on each side, flat, so that the neighbours of site p are p - stride, p - 1,
p + 1 and p + stride everywhere.  What does not exist or is not committed is the label K, a row of zeros in each table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAXIMUM_LABELS = 254

Floats = NDArray[np.float32]
Field = NDArray[np.uint8]
Sites = NDArray[np.int32]
Window = tuple[slice, slice]
Place = int | np.int64

EVERYWHERE: Window = (slice(None), slice(None))

_UNWEIGHTED = np.empty(0, np.float32)


class Labelling(NamedTuple):
    """Problem of a block framed by one site on each side.

    Attributes
    ----------
    unary
        float32 (sites, K): U; 0 where there is no data.
    tables
        float32 (T + 1, K + 1, K): V by kind of pair, the label K of the second pixel being none; the last is zero.
    down, right
        uint8 (sites,): kind of the pair of a site and the one below, or right of it; T where there is none.
    down_weight, right_weight
        float32 (sites,): w of the same pairs; (0,) where all are 1.
    exists
        bool (sites,): whether the site is a pixel with data.
    stride
        Sites in a row of the frame.
    row, column
        Global place of site 0.
    """

    unary: Floats
    tables: Floats
    down: Field
    right: Field
    down_weight: Floats
    right_weight: Floats
    exists: NDArray[np.bool_]
    stride: int
    row: int
    column: int


@dataclass(frozen=True)
class Labels:
    """Result of an optimiser.

    Attributes
    ----------
    labels
        uint8 (rows, columns); 255 where there is no data.
    rounds
        Rounds (or sweeps) after which no site of the block wanted to change, or their cap.
    unresolved
        Pixels of the core that still wanted to change then; 0 = converged.
    """

    labels: Field
    rounds: int
    unresolved: int


# ------------------------------------------------------------------------------------------------- making


def _pairs(has_data: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pairs of pixels one below the other, and side by side, have data."""
    return has_data[:-1] & has_data[1:], has_data[:, :-1] & has_data[:, 1:]


def _checked_kind(name: str, given: ArrayLike | None, shape: tuple[int, int], tables: int) -> Field:
    kind: NDArray[Any] = np.zeros(shape, np.uint8) if given is None else np.asarray(given)
    if kind.shape != shape or (kind.size and not 0 <= int(kind.min()) <= int(kind.max()) < tables):
        raise ValueError(f"{name} must name one of {tables} tables for each of {shape[0]} x {shape[1]} pixels")
    return kind.astype(np.uint8)


def _checked_weight(name: str, given: ArrayLike | None, shape: tuple[int, int], pairs: NDArray[np.bool_]) -> Floats:
    """Weights of the pairs as float32; `pairs` leaves out the last row or column."""
    weight: NDArray[Any] = np.ones(shape, np.float32) if given is None else np.asarray(given)
    if weight.shape != shape or weight.dtype.kind not in "buif":
        raise ValueError(f"{name} must be a real weight for each of {shape[0]} x {shape[1]} pixels")
    weight = weight.astype(np.float32)
    looked_at = weight[: pairs.shape[0], : pairs.shape[1]][pairs]
    if not (np.isfinite(looked_at) & (looked_at >= 0)).all():
        raise ValueError(f"{name} must be finite and not negative where both pixels have data")
    return weight


def framed_labelling(
    unary: Floats, has_data: NDArray[np.bool_], tables: Floats, down: Field, right: Field, origin: tuple[int, int],
    weights: tuple[Floats, Floats] | None = None,
) -> Labelling:  # fmt: skip
    """Make the problem of a framed block.

    Parameters
    ----------
    unary
        float32 (rows + 2, columns + 2, K), framed.
    has_data
        bool (rows, columns), not framed.
    tables
        float32 (T, K, K).
    down, right
        uint8 (rows, columns): kinds of pairs, below T; not looked at where there is no pair.
    origin
        Global row and column of the block's first pixel.
    weights
        float32 (rows, columns), two: w of the pairs down and right; not looked at where there is no pair.  None: 1.
    """
    rows, columns = has_data.shape
    kinds, labels, _ = tables.shape
    padded = np.zeros((kinds + 1, labels + 1, labels), np.float32)
    padded[:kinds, :labels] = tables
    exists = np.zeros((rows + 2, columns + 2), np.bool_)
    exists[1:-1, 1:-1] = has_data
    pairs_down, pairs_right = (np.full(exists.shape, kinds, np.uint8) for _ in range(2))
    both_down, both_right = _pairs(has_data)
    np.copyto(pairs_down[1:-2, 1:-1], down[:-1], where=both_down)
    np.copyto(pairs_right[1:-1, 1:-2], right[:, :-1], where=both_right)
    down_weight = right_weight = _UNWEIGHTED
    if weights is not None:
        down_weight, right_weight = (np.zeros(exists.shape, np.float32) for _ in range(2))
        np.copyto(down_weight[1:-2, 1:-1], weights[0][:-1], where=both_down)
        np.copyto(right_weight[1:-1, 1:-2], weights[1][:, :-1], where=both_right)
    return Labelling(
        unary.reshape(-1, labels), padded, pairs_down.reshape(-1), pairs_right.reshape(-1), down_weight.reshape(-1),
        right_weight.reshape(-1), exists.reshape(-1), columns + 2, origin[0] - 1, origin[1] - 1,
    )  # fmt: skip


def labelling(
    unary: ArrayLike,
    pairwise: ArrayLike,
    *,
    down: ArrayLike | None = None,
    right: ArrayLike | None = None,
    down_weight: ArrayLike | None = None,
    right_weight: ArrayLike | None = None,
    origin: tuple[int, int] = (0, 0),
) -> Labelling:
    """Make a labelling problem of given costs.

    Parameters
    ----------
    unary
        U, shape (rows, columns, K), K from 2 to 254, real, computed in float32.  NaN = the pixel has no data.
    pairwise
        V, shape (K, K), symmetric and finite; or (T, K, K): several tables, T up to 254.
    down, right
        uint8 (rows, columns): which table the pair of a pixel and the one below, or right of it, takes; None: the
        first.  The last row of `down` and last column of `right` are not looked at.
    down_weight, right_weight
        w, real (rows, columns), not negative, computed in float32: what the table of the pair of a pixel and the one
        below, or right of it, is multiplied by; None: 1.  Not looked at (NaN, for one) where there is no such pair.
    origin
        Global row and column of the first pixel.

    Raises
    ------
    ValueError
        For shapes that do not fit together, costs that are infinite, a table that is not symmetric, a table that
        is not there, a weight that is negative or not finite.
    """
    costs: NDArray[Any] = np.asarray(unary)
    if costs.ndim != 3 or not 2 <= costs.shape[2] <= MAXIMUM_LABELS or costs.dtype.kind not in "buif":
        raise ValueError(
            f"unary must be real, of shape (rows, columns, 2 to {MAXIMUM_LABELS} labels), not {costs.dtype} of shape "
            f"{costs.shape}"
        )
    rows, columns, count = costs.shape
    if (rows + 2) * (columns + 2) >= 2**31:
        raise ValueError(f"{rows} x {columns} pixels are too many for one block; label smaller blocks")
    tables: NDArray[Any] = np.asarray(pairwise, dtype=np.float32)
    tables = tables[None] if tables.ndim == 2 else tables
    if tables.ndim != 3 or tables.shape[1:] != (count, count) or not 1 <= len(tables) <= MAXIMUM_LABELS:
        raise ValueError(f"pairwise must be tables of {count} x {count} labels, not of shape {np.shape(pairwise)}")
    if not (np.isfinite(tables).all() and np.array_equal(tables, tables.transpose(0, 2, 1))):
        raise ValueError("pairwise must be finite and symmetric")
    framed = np.zeros((rows + 2, columns + 2, count), np.float32)
    framed[1:-1, 1:-1] = costs
    inside = framed[1:-1, 1:-1]
    has_data: NDArray[np.bool_] = np.logical_not(np.isnan(inside).any(axis=2))
    inside[~has_data] = 0
    if not np.isfinite(inside).all():
        raise ValueError("unary must be finite; give a label that a pixel cannot have a large cost instead")
    shape = (rows, columns)
    kinds = _checked_kind("down", down, shape, len(tables)), _checked_kind("right", right, shape, len(tables))
    weights = None
    if down_weight is not None or right_weight is not None:
        both_down, both_right = _pairs(has_data)
        weights = (
            _checked_weight("down_weight", down_weight, shape, both_down),
            _checked_weight("right_weight", right_weight, shape, both_right),
        )
    return framed_labelling(framed, has_data, tables, *kinds, origin, weights)


def framed_labels(problem: Labelling, labels: ArrayLike | None, name: str = "start") -> Field:
    """Labels of the sites, framed and flat: those given, K where there is no data or none are given.

    Raises
    ------
    ValueError
        For labels of another shape, or a pixel with data that has none of the K labels.
    """
    none = problem.unary.shape[1]
    sites = np.full(problem.exists.size, none, np.uint8)
    if labels is not None:
        given = np.asarray(labels)
        framed = sites.reshape(-1, problem.stride)
        if given.shape != (framed.shape[0] - 2, framed.shape[1] - 2):
            raise ValueError(f"{name} must have the shape of the block, not {given.shape}")
        framed[1:-1, 1:-1] = np.where((given >= 0) & (given < none), given, none)
        sites[~problem.exists] = none
        if bool((sites[problem.exists] >= none).any()):
            raise ValueError(f"{name} must be from 0 to {none - 1} where there is data")
    return sites


def as_result(problem: Labelling, sites: Field, rounds: int, wanting: Sites, core: Window = EVERYWHERE) -> Labels:
    """Result of the labels of all sites and the list of those that still want to change."""
    framed = np.where(problem.exists, sites, np.uint8(255)).reshape(-1, problem.stride)
    labels = framed[1:-1, 1:-1].copy()
    open_ends = np.zeros(framed.size, np.bool_)
    open_ends[wanting] = True
    inside = open_ends.reshape(framed.shape)[1:-1, 1:-1][core]
    return Labels(labels, rounds, int(np.count_nonzero(inside)))
