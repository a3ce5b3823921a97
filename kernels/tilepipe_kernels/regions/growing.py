"""Region growing as HALCON's `regiongrowing` does it (`streets`, step 2).

The raster is divided in rectangles; two 4-adjacent rectangles join when the grey values of their centre
pixels differ by at most a tolerance; a region is the transitive closure.  Regions are thus the connected
components of a graph: there is one right answer, whatever the order of the work.  A region has no bounded
halo: labels of neighbouring blocks are united at their seams by the caller.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import as_array, namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.union_find import unite

_LARGEST = np.finfo(np.float32).max

Floats = NDArray[np.float32]
Labels = NDArray[np.int32]
Marks = NDArray[np.uint8]
Counts = NDArray[np.int64]


# ------------------------------------------------------------------------------------------------- rectangles


def rectangle_centers(block: NDArray[Any], rows: int, columns: int, origin: tuple[int, int] = (0, 0)) -> NDArray[Any]:
    """Grey value of each rectangle: that of its centre pixel.

    Parameters
    ----------
    block
        Pixels, shape (height, width), any dtype.
    rows, columns
        Size of a rectangle, pixels; odd.
    origin
        Global row and column of ``block[0, 0]``; multiples of `rows` and `columns`, for the rectangles are
        anchored to the global grid.

    Returns
    -------
    ndarray
        Shape (ceil(height / rows), ceil(width / columns)), dtype of `block`.  A last rectangle cut by the end
        of the block, which must be the raster's, has the centre ``min(i * rows + rows // 2, height - 1)``.
        With 1 x 1 rectangles the block itself, not a copy.

    Raises
    ------
    ValueError
        For even or non-positive sizes, an origin off the grid, a block that is not two-dimensional.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.regions.growing import rectangle_centers
    >>> rectangle_centers(np.arange(36).reshape(6, 6), rows=3, columns=3).tolist()
    [[7, 10], [25, 28]]
    """
    if rows < 1 or columns < 1 or rows % 2 == 0 or columns % 2 == 0:
        raise ValueError(f"rectangles need odd sizes to have a centre pixel, not {rows} x {columns}")
    if origin[0] % rows or origin[1] % columns:
        raise ValueError(f"the block must start on a rectangle: origin {origin} is off the {rows} x {columns} grid")
    if block.ndim != 2:
        raise ValueError(f"block must be two-dimensional, not of shape {block.shape}")
    if rows == columns == 1:
        return block
    height, width = block.shape
    xp = namespace(block)
    i = xp.minimum(xp.arange(rows // 2, height + rows // 2, rows), height - 1)
    j = xp.minimum(xp.arange(columns // 2, width + columns // 2, columns), width - 1)
    return block[i[:, None], j]


# ------------------------------------------------------------------------------------------------- growing


@rule
def joined(a: np.float32, b: np.float32, tolerance: np.float32) -> np.bool_:
    """Whether two adjacent rectangles belong to one region."""
    return abs(a - b) <= tolerance


@loop
def _starts(
    starts: Marks, belongs: Marks, row: Floats, lowest: np.float32, highest: np.float32, tolerance: np.float32
) -> None:
    """Mark which rectangles of a row belong to a region, and which of those start a new run."""
    for j in range(row.size):
        belongs[j] = (row[j] >= lowest) & (row[j] <= highest)
    starts[0] = belongs[0]
    left, left_belongs, right, right_belongs, right_starts = row, belongs, row[1:], belongs[1:], starts[1:]
    for j in range(right.size):
        together = joined(left[j], right[j], tolerance) & (left_belongs[j] != 0)
        right_starts[j] = (right_belongs[j] != 0) & (not together)


@loop
def _contacts(
    contacts: Marks, above: Floats, row: Floats, above_belongs: Marks, belongs: Marks, tolerance: np.float32
) -> None:
    """Mark the rectangles that join the one above."""
    for j in range(row.size):
        both = (above_belongs[j] != 0) & (belongs[j] != 0)
        contacts[j] = joined(above[j], row[j], tolerance) & both


@loop
def _new_contacts(contacts: Marks, above_starts: Marks, starts: Marks, news: Marks) -> None:
    """Of the contacts, keep those that unite other runs than the contact just left of them does."""
    news[0] = contacts[0]
    here, left, a, b, into = contacts[1:], contacts, above_starts[1:], starts[1:], news[1:]
    for j in range(here.size):
        into[j] = here[j] & ((left[j] ^ 1) | a[j] | b[j])


@loop
def _unite_rows(parent: Labels, above_runs: Labels, runs: Labels, news: Marks, words: NDArray[np.uint64]) -> None:
    """Unite the runs of two rows at the marked contacts; `words` are the marks by eight, to skip zeros."""
    for word in range(words.size):
        if words[word] == 0:
            continue
        for j in range(8 * word, min(8 * word + 8, runs.size)):
            if news[j]:
                unite(parent, above_runs[j], runs[j])


@loop
def _number_runs(runs: Labels, starts: Marks, belongs: Marks, count: int) -> int:
    """Write the number of its run at each rectangle, 0 where it belongs to none; return the runs so far."""
    for j in range(runs.size):
        count += starts[j]
        runs[j] = count * belongs[j]
    return count


@loop
def _grow(
    labels: Labels, values: Floats, lowest: np.float32, highest: np.float32, tolerance: np.float32,
    parent: Labels,
) -> None:  # fmt: skip
    rows, columns = values.shape
    width = (columns + 7) // 8 * 8
    marks = np.zeros((6, width), np.uint8)
    belongs, starts, above_belongs, above_starts = marks[0], marks[1], marks[2], marks[3]
    contacts, news = marks[4], marks[5]
    words = news.view(np.uint64)
    count = 0
    parent[0] = 0
    for i in range(rows):
        row, runs = values[i], labels[i]
        _starts(starts[:columns], belongs[:columns], row, lowest, highest, tolerance)
        before = count
        count = _number_runs(runs, starts, belongs, count)
        for run in range(before + 1, count + 1):
            parent[run] = run
        if i > 0:
            _contacts(contacts[:columns], values[i - 1], row, above_belongs, belongs, tolerance)
            _new_contacts(contacts[:columns], above_starts, starts, news[:columns])
            _unite_rows(parent, labels[i - 1], runs, news, words)
        belongs, above_belongs = above_belongs, belongs
        starts, above_starts = above_starts, starts
    found = 0
    # A root is the smallest run of its region, hence its first in row-major order.
    for run in range(1, count + 1):
        if parent[run] == run:
            found += 1
            parent[run] = found
        else:
            parent[run] = parent[parent[run]]
    for i in range(rows):
        runs = labels[i]
        for j in range(columns):
            runs[j] = parent[runs[j]]


def grow_regions(values: ArrayLike, tolerance: float, *, maximum: float = math.inf) -> NDArray[np.int32]:
    """Label the regions of rectangles whose grey values are linked by steps of at most `tolerance`.

    Parameters
    ----------
    values
        Grey value of each rectangle, shape (rows, columns), any real dtype; computed in float32.  Values that
        are not finite are nodata and belong to no region.
    tolerance
        Largest difference of two 4-adjacent rectangles that join, >= 0.
    maximum
        Only rectangles at most this bright can belong to a region.

    Returns
    -------
    ndarray of int32
        Labels 1..n numbered by first rectangle in row-major order; 0 = no region.

    Raises
    ------
    ValueError
        For a negative tolerance, an array that is not two-dimensional and real, or one of 2³¹ rectangles or
        more.

    Examples
    --------
    A street whose grey changes slowly is one region; the roof beside it is another.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.growing import grow_regions
    >>> grey = np.array([[40, 44, 48, 200], [42, 46, 50, 202], [np.nan, 49, 53, 203]])
    >>> grow_regions(grey, tolerance=5).tolist()
    [[1, 1, 1, 2], [1, 1, 1, 2], [0, 1, 1, 2]]
    >>> grow_regions(grey, tolerance=5, maximum=100)[0].tolist()  # the dark regions alone
    [1, 1, 1, 0]
    """
    array = as_array(values)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"values must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    if not tolerance >= 0:
        raise ValueError(f"tolerance must be 0 or more grey levels, not {tolerance}")
    if math.isnan(maximum):
        raise ValueError("maximum must be a grey value or infinity, not NaN")
    if array.size >= 2**31 - 1:
        raise ValueError(f"{array.size} rectangles are too many for one block; label smaller blocks")
    xp = namespace(array)
    labels: NDArray[np.int32] = xp.zeros(array.shape, xp.int32)
    if array.size == 0:
        return labels
    array = xp.ascontiguousarray(array, dtype=xp.float32)
    highest = np.float32(min(maximum, float(_LARGEST)))
    if on_device(array):
        return device_form(__name__).grow(array, -_LARGEST, highest, np.float32(tolerance))
    # Pages that no run needs are never touched, so the worst case costs address space only.
    parent = np.empty(array.size + 1, np.int32)
    _grow(labels, array, -_LARGEST, highest, np.float32(tolerance), parent)
    return labels
