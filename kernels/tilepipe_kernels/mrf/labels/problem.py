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

from tilepipe_kernels.core.arrays import as_array, namespace, on_device

MAXIMUM_LABELS = 254

Floats = NDArray[np.float32]
Field = NDArray[np.uint8]
Sites = NDArray[np.int32]
Window = tuple[slice, slice]
Place = int | np.int64

EVERYWHERE: Window = (slice(None), slice(None))


class Labelling(NamedTuple):
    """Problem of a block framed by one site on each side.

    Attributes
    ----------
    unary
        float32 (sites, K): U; 0 where there is no data.  On a device the costs of one label lie side by side.
    tables
        float32 (T + 1, K + 1, K): V by kind of pair, the label K of the second pixel being none; the last is zero.
    down, right
        uint8 (sites,): kind of the pair of a site and the one below, or right of it; T where there is none.
    down_weight, right_weight
        float32 (sites,): w of the same pairs; None where all are 1.
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
    down_weight: Floats | None
    right_weight: Floats | None
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


def _checked_kind(name: str, given: ArrayLike, shape: tuple[int, int], tables: int) -> Field:
    kind: NDArray[Any] = as_array(given)
    if kind.shape != shape or not bool(((kind >= 0) & (kind < tables)).all()):
        raise ValueError(f"{name} must name one of {tables} tables for each of {shape[0]} x {shape[1]} pixels")
    return kind.astype(np.uint8)


def _checked_weight(name: str, given: ArrayLike, shape: tuple[int, int], pairs: NDArray[np.bool_]) -> Floats:
    """Weights of the pairs as float32; `pairs` leaves out the last row or column."""
    weight: NDArray[Any] = as_array(given)
    if weight.shape != shape or weight.dtype.kind not in "buif":
        raise ValueError(f"{name} must be a real weight for each of {shape[0]} x {shape[1]} pixels")
    xp = namespace(weight)
    weight = weight.astype(xp.float32)
    beside = weight[: pairs.shape[0], : pairs.shape[1]]
    if not bool((~pairs | (xp.isfinite(beside) & (beside >= 0))).all()):
        raise ValueError(f"{name} must be finite and not negative where both pixels have data")
    return weight


def framed_costs(rows: int, columns: int, labels: int, like: NDArray[Any]) -> Floats:
    """Zeros for the unary costs of a framed block, float32 (rows + 2, columns + 2, labels), where `like` lies.

    Threads of a device go through the sites at once and want those of one label side by side, a CPU all of one site.
    """
    xp = namespace(like)
    if on_device(like):
        planes: Floats = xp.zeros((labels, rows + 2, columns + 2), xp.float32)
        return planes.transpose(1, 2, 0)
    return np.zeros((rows + 2, columns + 2, labels), np.float32)


def framed_labelling(
    unary: Floats, has_data: NDArray[np.bool_], tables: Floats, kinds_of_pairs: tuple[Field, ...],
    origin: tuple[int, int], weights: tuple[Floats, ...] | None = None,
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
    kinds_of_pairs
        uint8 (rows, columns), two: kinds of the pairs down and right, below T; not looked at where there is no pair.
    origin
        Global row and column of the block's first pixel.
    weights
        float32 (rows, columns), two: w of the same pairs, likewise.  None: 1.
    """
    down, right = kinds_of_pairs
    xp = namespace(unary, has_data, tables, down, right)
    rows, columns = has_data.shape
    kinds, labels, _ = tables.shape
    padded = xp.zeros((kinds + 1, labels + 1, labels), xp.float32)
    padded[:kinds, :labels] = tables
    exists = xp.zeros((rows + 2, columns + 2), xp.bool_)
    exists[1:-1, 1:-1] = has_data
    pairs_down, pairs_right = (xp.full(exists.shape, kinds, xp.uint8) for _ in range(2))
    both_down, both_right = _pairs(has_data)
    xp.copyto(pairs_down[1:-2, 1:-1], down[:-1], where=both_down)
    xp.copyto(pairs_right[1:-1, 1:-2], right[:, :-1], where=both_right)
    down_weight = right_weight = None
    if weights is not None:
        framed = xp.zeros((2, *exists.shape), xp.float32)
        xp.copyto(framed[0, 1:-2, 1:-1], weights[0][:-1], where=both_down)
        xp.copyto(framed[1, 1:-1, 1:-2], weights[1][:, :-1], where=both_right)
        down_weight, right_weight = framed[0].reshape(-1), framed[1].reshape(-1)
    return Labelling(
        unary.reshape(-1, labels), padded, pairs_down.reshape(-1), pairs_right.reshape(-1), down_weight, right_weight,
        exists.reshape(-1), columns + 2, origin[0] - 1, origin[1] - 1,
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
    """Make a labelling problem of given costs, all on the host or all on a device; it stays there.

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

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.mrf.labels.problem import labelling
    >>> problem = labelling(np.zeros((2, 3, 4)), 1 - np.eye(4))
    >>> problem.unary.shape, problem.exists.sum().item()  # framed: 4 × 5 sites, of which 2 × 3 are pixels
    ((20, 4), 6)
    >>> labelling(np.zeros((2, 3, 4)), np.triu(np.ones((4, 4))))
    Traceback (most recent call last):
        ...
    ValueError: pairwise must be finite and symmetric
    """
    costs: NDArray[Any] = as_array(unary)
    if costs.ndim != 3 or not 2 <= costs.shape[2] <= MAXIMUM_LABELS or costs.dtype.kind not in "buif":
        raise ValueError(
            f"unary must be real, of shape (rows, columns, 2 to {MAXIMUM_LABELS} labels), not {costs.dtype} of shape "
            f"{costs.shape}"
        )
    rows, columns, count = costs.shape
    if (rows + 2) * (columns + 2) >= 2**31:
        raise ValueError(f"{rows} x {columns} pixels are too many for one block; label smaller blocks")
    xp = namespace(unary, pairwise, down, right, down_weight, right_weight)
    tables: NDArray[Any] = xp.asarray(pairwise, dtype=xp.float32)
    tables = tables[None] if tables.ndim == 2 else tables
    if tables.ndim != 3 or tables.shape[1:] != (count, count) or not 1 <= len(tables) <= MAXIMUM_LABELS:
        raise ValueError(f"pairwise must be tables of {count} x {count} labels, not of shape {np.shape(pairwise)}")
    if not bool((xp.isfinite(tables) & (tables == tables.transpose(0, 2, 1))).all()):
        raise ValueError("pairwise must be finite and symmetric")
    framed = framed_costs(rows, columns, count, costs)
    inside = framed[1:-1, 1:-1]
    inside[...] = costs
    has_data: NDArray[np.bool_] = xp.logical_not(xp.isnan(inside).any(axis=2))
    inside[~has_data] = 0
    if not bool(xp.isfinite(inside).all()):
        raise ValueError("unary must be finite; give a label that a pixel cannot have a large cost instead")
    shape = (rows, columns)
    kinds = tuple(
        xp.zeros(shape, xp.uint8) if given is None else _checked_kind(name, given, shape, len(tables))
        for name, given in (("down", down), ("right", right))
    )
    weights = None
    if down_weight is not None or right_weight is not None:
        given_weights = ("down_weight", down_weight), ("right_weight", right_weight)
        weights = tuple(
            xp.ones(shape, xp.float32) if given is None else _checked_weight(name, given, shape, pairs)
            for (name, given), pairs in zip(given_weights, _pairs(has_data), strict=True)
        )
    return framed_labelling(framed, has_data, tables, kinds, origin, weights)


def framed_labels(problem: Labelling, labels: ArrayLike | None, name: str = "start") -> Field:
    """Labels of the sites, framed and flat: those given, K where there is no data or none are given.

    Raises
    ------
    ValueError
        For labels of another shape, or a pixel with data that has none of the K labels.
    """
    none = problem.unary.shape[1]
    xp = namespace(problem.exists, labels)
    sites: Field = xp.full(problem.exists.size, none, xp.uint8)
    if labels is not None:
        given = as_array(labels)
        framed = sites.reshape(-1, problem.stride)
        if given.shape != (framed.shape[0] - 2, framed.shape[1] - 2):
            raise ValueError(f"{name} must have the shape of the block, not {given.shape}")
        framed[1:-1, 1:-1] = xp.where((given >= 0) & (given < none), given, none).astype(xp.uint8)
        sites[~problem.exists] = none
        if bool((problem.exists & (sites >= none)).any()):
            raise ValueError(f"{name} must be from 0 to {none - 1} where there is data")
    return sites


def as_result(problem: Labelling, sites: Field, rounds: int, wanting: Sites, core: Window = EVERYWHERE) -> Labels:
    """Result of the labels of all sites and the list of those that still want to change."""
    xp = namespace(problem.exists, sites, wanting)
    framed = xp.where(problem.exists, sites, xp.uint8(255)).reshape(-1, problem.stride)
    labels = framed[1:-1, 1:-1].copy()
    open_ends = xp.zeros(framed.size, xp.bool_)
    open_ends[wanting] = True
    inside = open_ends.reshape(framed.shape)[1:-1, 1:-1][core]
    return Labels(labels, rounds, int(xp.count_nonzero(inside)))
