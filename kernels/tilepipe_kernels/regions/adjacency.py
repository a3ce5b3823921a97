"""Contacts of labelled regions: which are 4-adjacent, and along how many cracks (`objects`, step 3).

A crack is the side between two 4-adjacent pixels of different regions.  Cracks between the same two regions that
continue one another in a straight line form one *run*; two dyadic squares meet in one run, so runs are hardly more
than contacts.  Runs are counted first, so that memory follows their number, then written, then sorted by two stable
counting sorts, which are linear whatever the regions look like.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule

Labels = NDArray[np.int32]
Runs = NDArray[np.int32]
"""Shape (3, m): lower label, higher label and number of cracks of each run."""


class Contacts(NamedTuple):
    """Contacts of regions 1..n.

    Attributes
    ----------
    edges
        int32, shape (m, 2): lower and higher label, sorted lexicographically.
    length
        int32, shape (m,): number of cracks between the two, >= 1.
    """

    edges: NDArray[np.int32]
    length: NDArray[np.int32]


@rule
def parted(a: np.int32, b: np.int32) -> bool:
    """Whether there is a crack between adjacent pixels of these labels."""
    return bool((a != b) & (a != 0) & (b != 0))


@rule
def continued(a: np.int32, b: np.int32, a_before: np.int32, b_before: np.int32) -> bool:
    """Whether the crack between two pixels is in one straight run with the one between the two before."""
    return bool((a == a_before) & (b == b_before))


# ------------------------------------------------------------------------------------------------- runs


@loop
def _extremes(labels: Labels) -> tuple[np.int32, np.int32]:
    lowest, highest = np.int32(0), np.int32(0)
    for i in range(labels.shape[0]):
        row = labels[i]
        for j in range(row.size):
            lowest, highest = min(lowest, row[j]), max(highest, row[j])
    return lowest, highest


@loop
def _count_starts(first: Labels, second: Labels, first_before: Labels, second_before: Labels) -> np.int64:
    """Number of cracks between two lines of pixels that do not continue the crack between the two before."""
    starts = np.int32(0)
    for j in range(first.size):
        a, b = first[j], second[j]
        starts += np.int32(parted(a, b) & (not continued(a, b, first_before[j], second_before[j])))
    return np.int64(starts)


@loop
def _count_runs(labels: Labels) -> np.int64:
    rows, columns = labels.shape
    runs = np.int64(0)
    for i in range(rows):
        row = labels[i]
        if i == 0:
            nothing = np.zeros(columns, np.int32)
            runs += _count_starts(row[:-1], row[1:], nothing, nothing)
            continue
        above = labels[i - 1]
        runs += _count_starts(row[:-1], row[1:], above[:-1], above[1:])
        runs += np.int64(parted(above[0], row[0]))
        runs += _count_starts(above[1:], row[1:], above[:-1], row[:-1])
    return runs


@loop
def _open_run(runs: Runs, index: int, a: np.int32, b: np.int32) -> int:
    """Write a run of one crack."""
    runs[0, index], runs[1, index], runs[2, index] = min(a, b), max(a, b), 1
    return index + 1


@loop
def _write_runs(labels: Labels, runs: Runs) -> None:
    """Write the runs of cracks in the order of their first cracks."""
    rows, columns = labels.shape
    # The run that the crack right of a pixel of the row above belongs to.
    runs_right = np.zeros(columns, np.int64)
    above = np.zeros(columns, np.int32)
    found = 0
    for i in range(rows):
        row = labels[i]
        a = above_a = np.int32(0)
        runs_below = 0
        for j in range(columns):
            b, above_b = row[j], above[j]
            if parted(above_b, b):
                if continued(above_b, b, above_a, a):
                    runs[2, runs_below] += 1
                else:
                    runs_below = found
                    found = _open_run(runs, found, above_b, b)
            if parted(a, b):
                if continued(a, b, above_a, above_b):
                    runs[2, runs_right[j]] += 1
                else:
                    runs_right[j] = found
                    found = _open_run(runs, found, a, b)
            a, above_a = b, above_b
        above = row


# ------------------------------------------------------------------------------------------------- sorting


@loop
def _sort_by(key: Labels, starts: NDArray[np.int64], runs: Runs, into: Runs) -> None:
    """Stable counting sort of runs by a key 1..n, where `starts` has n + 2 elements."""
    starts[:] = 0
    for run in range(key.size):
        starts[key[run] + 1] += 1
    for label in range(1, starts.size):
        starts[label] += starts[label - 1]
    for run in range(key.size):
        place = starts[key[run]]
        starts[key[run]] += 1
        into[0, place], into[1, place], into[2, place] = runs[0, run], runs[1, run], runs[2, run]


@loop
def _unite(runs: Runs) -> int:
    """Add up sorted runs of the same two regions in place; return the number of contacts."""
    lower, higher, length = runs[0], runs[1], runs[2]
    last = -1
    for run in range(lower.size):
        if last >= 0 and lower[run] == lower[last] and higher[run] == higher[last]:
            length[last] += length[run]
        else:
            last += 1
            lower[last], higher[last], length[last] = lower[run], higher[run], length[run]
    return last + 1


def _range(labels: Labels) -> tuple[int, int]:
    """Lowest and highest label of a block, not above and not below 0."""
    if on_device(labels):
        return device_form(__name__).label_range(labels)
    lowest, highest = _extremes(labels)
    return int(lowest), int(highest)


def contacts(labels: NDArray[np.int32], count: int) -> Contacts:
    """Find the 4-adjacent pairs of regions of a block, and the number of cracks between the two.

    Parameters
    ----------
    labels
        Labels 0..count, int32, shape (rows, columns), of any regions, connected or not; 0 = no region, which touches
        nothing.
    count
        Number of regions.

    Returns
    -------
    Contacts
        Pairs ``a < b`` in lexicographical order with their cracks.  Memory: 24 bytes per straight run of cracks, of
        which there are at most two a pixel, and 8 bytes per region.  Arrays of a device stay there.

    Raises
    ------
    ValueError
        For labels that are not two-dimensional int32, or lie outside 0..count.

    Examples
    --------
    Region 1 touches region 2 along three pixel sides and region 3 along one.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.adjacency import contacts
    >>> found = contacts(np.array([[1, 1, 1, 3], [2, 2, 2, 3]], np.int32), count=3)
    >>> found.edges.tolist(), found.length.tolist()
    ([[1, 2], [1, 3], [2, 3]], [3, 1, 1])
    """
    if labels.ndim != 2 or labels.dtype != np.int32:
        raise ValueError(f"labels must be a two-dimensional int32 array, not {labels.dtype} of shape {labels.shape}")
    if labels.size >= 2**30:
        raise ValueError(f"{labels.size} pixels are too many for one block; find the contacts of smaller blocks")
    labels = namespace(labels).ascontiguousarray(labels)
    lowest, highest = _range(labels)
    if lowest < 0 or highest > count:
        raise ValueError(f"labels must lie in 0..{count}, not in {lowest}..{highest}")
    if on_device(labels):
        return device_form(__name__).contacts(labels, count)
    number = int(_count_runs(labels)) if labels.size else 0
    runs = np.empty((3, number), np.int32)
    spare = np.empty_like(runs)
    _write_runs(labels, runs)
    starts = np.empty(count + 2, np.int64)
    _sort_by(runs[1], starts, runs, spare)
    _sort_by(spare[0], starts, spare, runs)
    number = _unite(runs)
    return Contacts(np.ascontiguousarray(runs[:2, :number].T), runs[2, :number].copy())
