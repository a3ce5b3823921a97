"""A labelling problem on the pixel grid, and the stability of its sites.

Every pixel s takes one of K labels, at the cost Σ_s U_s(x_s) + Σ_st V_st(x_s, x_t) over pixels and pairs of
4-adjacent ones; V_st is one of a few symmetric tables.  The intensity field of `edge_model` is the special case
U = (y - x)²/(2 σ²), V = β f.

The loops walk a block framed by one site on each side, flat, so that the neighbours of site p are p - stride, p - 1,
p + 1 and p + stride everywhere.  What does not exist or is not committed is the label K, a row of zeros in each table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compiled import loop, rule
from .hcf import site_rank

MAXIMUM_LABELS = 254

Floats = NDArray[np.float32]
Field = NDArray[np.uint8]
Sites = NDArray[np.int32]
Window = tuple[slice, slice]
Place = int | np.int64

EVERYWHERE: Window = (slice(None), slice(None))

_INFINITY = np.float32(np.inf)


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


def framed_labelling(
    unary: Floats, has_data: NDArray[np.bool_], tables: Floats, down: Field, right: Field, origin: tuple[int, int]
) -> Labelling:
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
    """
    rows, columns = has_data.shape
    kinds, labels, _ = tables.shape
    padded = np.zeros((kinds + 1, labels + 1, labels), np.float32)
    padded[:kinds, :labels] = tables
    exists = np.zeros((rows + 2, columns + 2), np.bool_)
    exists[1:-1, 1:-1] = has_data
    pairs_down, pairs_right = (np.full(exists.shape, kinds, np.uint8) for _ in range(2))
    np.copyto(pairs_down[1:-2, 1:-1], down[:-1], where=has_data[:-1] & has_data[1:])
    np.copyto(pairs_right[1:-1, 1:-2], right[:, :-1], where=has_data[:, :-1] & has_data[:, 1:])
    return Labelling(
        unary.reshape(-1, labels), padded, pairs_down.reshape(-1), pairs_right.reshape(-1), exists.reshape(-1),
        columns + 2, origin[0] - 1, origin[1] - 1,
    )  # fmt: skip


def labelling(
    unary: ArrayLike,
    pairwise: ArrayLike,
    *,
    down: ArrayLike | None = None,
    right: ArrayLike | None = None,
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
    origin
        Global row and column of the first pixel.

    Raises
    ------
    ValueError
        For shapes that do not fit together, costs that are infinite, a table that is not symmetric, a table that
        is not there.
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
    kinds = []
    for name, given in (("down", down), ("right", right)):
        kind = np.zeros((rows, columns), np.uint8) if given is None else np.asarray(given)
        if kind.shape != (rows, columns) or (kind.size and not 0 <= int(kind.min()) <= int(kind.max()) < len(tables)):
            raise ValueError(f"{name} must name one of {len(tables)} tables for each of {rows} x {columns} pixels")
        kinds.append(kind.astype(np.uint8))
    framed = np.zeros((rows + 2, columns + 2, count), np.float32)
    framed[1:-1, 1:-1] = costs
    inside = framed[1:-1, 1:-1]
    has_data: NDArray[np.bool_] = np.logical_not(np.isnan(inside).any(axis=2))
    inside[~has_data] = 0
    if not np.isfinite(inside).all():
        raise ValueError("unary must be finite; give a label that a pixel cannot have a large cost instead")
    return framed_labelling(framed, has_data, tables, kinds[0], kinds[1], origin)


def framed_labels(problem: Labelling, labels: ArrayLike | None) -> Field:
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
            raise ValueError(f"start must have the shape of the block, not {given.shape}")
        framed[1:-1, 1:-1] = given
        sites[~problem.exists] = none
        if bool((sites[problem.exists] >= none).any()):
            raise ValueError(f"start must be from 0 to {none - 1} where there is data")
    return sites


def as_result(problem: Labelling, sites: Field, rounds: int, wanting: Sites, core: Window = EVERYWHERE) -> Labels:
    """Result of the labels of all sites and the list of those that still want to change."""
    framed = np.where(problem.exists, sites, np.uint8(255)).reshape(-1, problem.stride)
    labels = framed[1:-1, 1:-1].copy()
    open_ends = np.zeros(framed.size, np.bool_)
    open_ends[wanting] = True
    inside = open_ends.reshape(framed.shape)[1:-1, 1:-1][core]
    return Labels(labels, rounds, int(np.count_nonzero(inside)))


# ------------------------------------------------------------------------------------------------- site rules


@loop
def stability(
    unary: Floats, tables: Floats, down: Field, right: Field, labels: Field, stride: int, none: int, p: Place
) -> tuple[np.float32, np.uint8]:
    """Stability G of a site, and the label it would change to: the lowest of those of least energy.

    G is the least energy of the other labels minus that of its own, or minus the difference of the two least
    energies if it is uncommitted (Chou & Brown 1990).  Arrays as in `Labelling`, one by one: a tuple of them would
    be counted as a reference at each call.
    """
    above = tables[down[p - stride], labels[p - stride]]
    before = tables[right[p - 1], labels[p - 1]]
    after = tables[right[p], labels[p + 1]]
    below = tables[down[p], labels[p + stride]]
    cost = unary[p]
    own = labels[p]
    best = np.uint8(0)
    least = second = current = _INFINITY
    for label in range(none):
        energy = cost[label] + ((above[label] + before[label]) + (after[label] + below[label]))
        if label == own:
            current = energy
        elif energy < least:
            second = least
            least = energy
            best = np.uint8(label)
        elif energy < second:
            second = energy
    return (least - second if own == none else least - current), best


@rule
def rank_of(row: int, column: int, stride: int, p: Place) -> np.uint32:
    """`site_rank` of a site of a frame whose first is at (row, column)."""
    return site_rank(row + p // stride, column + p % stride)


@loop
def cheapest_labels(problem: Labelling, labels: Field) -> None:
    """Give every pixel the label of least unary cost, the lowest of equals."""
    for p in range(labels.size):
        if problem.exists[p]:
            unary = problem.unary[p]
            best = 0
            for label in range(1, unary.size):
                best = label if unary[label] < unary[best] else best
            labels[p] = best


@loop
def wanting_sites(problem: Labelling, labels: Field) -> Sites:
    """Committed sites whose energy another label would lower, ascending."""
    unary, tables, down, right = problem.unary, problem.tables, problem.down, problem.right
    stride, none = problem.stride, unary.shape[1]
    found = np.empty(labels.size, np.int32)
    count = 0
    for p in range(labels.size):
        if problem.exists[p] and stability(unary, tables, down, right, labels, stride, none, p)[0] < 0:
            found[count] = p
            count += 1
    return found[:count].copy()
