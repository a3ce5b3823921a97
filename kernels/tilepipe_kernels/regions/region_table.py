"""Measures of regions that add up over blocks, and selection by a lookup table (`streets`, step 3).

Arrays of a device stay there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import as_array, namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.core.rounding import nearest_integer

Floats = NDArray[np.float32]
Labels = NDArray[np.int32]
Counts = NDArray[np.int64]

GREY_UNITS = 256
"""Units per grey level in `RegionTable.grey_sum`: sums of integers do not depend on their order."""


@dataclass(frozen=True)
class RegionTable:
    """Measures of the regions 1..n of one block, one int64 element per region, so that parts add up.

    Attributes
    ----------
    count
        Number of rectangles.
    first
        Flat index in the block of the first rectangle, row-major.
    horizontal_cracks, vertical_cracks
        Number of horizontal (vertical) rectangle sides between the region and anything else.
    grey_sum
        Sum of ``rint(value * GREY_UNITS)``.
    top, left, bottom, right
        Bounding box: first and last row and column, inclusive.
    """

    count: NDArray[np.int64]
    first: NDArray[np.int64]
    horizontal_cracks: NDArray[np.int64]
    vertical_cracks: NDArray[np.int64]
    grey_sum: NDArray[np.int64]
    top: NDArray[np.int64]
    left: NDArray[np.int64]
    bottom: NDArray[np.int64]
    right: NDArray[np.int64]


@loop
def _different_sides(row: Labels, start: int, stop: int, other: Labels) -> int:
    """Number of columns start..stop whose label differs from the row above or below."""
    different = 0
    for j in range(start, stop):
        different += 1 if row[j] != other[j] else 0
    return different


@rule
def grey_units(value: np.float32, units: np.float32) -> int:
    """A grey value in whole units."""
    return nearest_integer(np.float64(value * units))


@loop
def _grey(values: Floats, start: int, stop: int, units: np.float32) -> int:
    total = 0
    for j in range(start, stop):
        total += grey_units(values[j], units)
    return total


@loop
def _measure(
    labels: Labels, values: Floats, borders: tuple[bool, bool, bool, bool], units: np.float32,
    count: Counts, first: Counts, horizontal: Counts, vertical: Counts, grey: Counts, top: Counts,
    left: Counts, bottom: Counts, right: Counts,
) -> None:  # fmt: skip
    rows, columns = labels.shape
    for i in range(rows):
        row = labels[i]
        stop = 0
        while stop < columns:
            start = stop
            label = row[start]
            while stop < columns and row[stop] == label:
                stop += 1
            if label == 0:
                continue
            k = label - 1
            if count[k] == 0:
                first[k], top[k], left[k] = i * columns + start, i, start
            count[k] += stop - start
            bottom[k], left[k], right[k] = i, min(left[k], start), max(right[k], stop - 1)
            grey[k] += _grey(values[i], start, stop, units)
            if i > 0:
                horizontal[k] += _different_sides(row, start, stop, labels[i - 1])
            elif borders[0]:
                horizontal[k] += stop - start
            if i + 1 < rows:
                horizontal[k] += _different_sides(row, start, stop, labels[i + 1])
            elif borders[1]:
                horizontal[k] += stop - start
            vertical[k] += (1 if start > 0 or borders[2] else 0) + (1 if stop < columns or borders[3] else 0)


def region_table(
    labels: NDArray[np.int32],
    values: ArrayLike,
    count: int,
    *,
    borders: tuple[bool, bool, bool, bool] = (True, True, True, True),
) -> RegionTable:
    """Measure the regions of one block in one pass.

    Parameters
    ----------
    labels
        Labels 0..count, shape (rows, columns); 0 = no region, but a neighbour that cracks part a region from.
    values
        Grey values, same shape; finite wherever a label is not 0.
    count
        Number of regions.
    borders
        Whether the top, bottom, left, right side of the block is the raster's border.  Sides of rectangles on
        the raster's border are cracks; on the other sides of the block the caller counts them when joining
        the seam.

    Returns
    -------
    RegionTable
        One element per label 1..count.  A label that does not occur has count 0 and otherwise no meaning.

    Raises
    ------
    ValueError
        For labels outside 0..count, or shapes that differ.

    Examples
    --------
    A street of 2 × 4 pixels, beside which nothing is region.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.region_table import region_table
    >>> labels = np.pad(np.ones((2, 4), np.int32), 1)
    >>> table = region_table(labels, np.full((4, 6), 80.0), count=1)
    >>> table.count.item(), table.horizontal_cracks.item(), table.vertical_cracks.item()
    (8, 8, 4)
    """
    labels, grey = as_array(labels), as_array(values)
    device, xp = on_device(labels, grey), namespace(labels)
    labels, grey = xp.ascontiguousarray(labels, dtype=xp.int32), xp.ascontiguousarray(grey, dtype=xp.float32)
    if labels.ndim != 2 or labels.shape != grey.shape:
        raise ValueError(f"labels and values must have one shape (rows, columns): {labels.shape}, {grey.shape}")
    if labels.size and not (labels.min() >= 0 and labels.max() <= count):
        raise ValueError(f"labels must lie in 0..{count}")
    if device:
        return RegionTable(*device_form(__name__).measure(labels, grey, count, borders, np.float32(GREY_UNITS)))
    table = RegionTable(*(np.zeros(count, np.int64) for _ in range(9)))
    _measure(
        labels, grey, borders, np.float32(GREY_UNITS), table.count, table.first, table.horizontal_cracks,
        table.vertical_cracks, table.grey_sum, table.top, table.left, table.bottom, table.right,
    )  # fmt: skip
    return table


def contour_length(
    horizontal_cracks: NDArray[np.int64],
    vertical_cracks: NDArray[np.int64],
    pixel_height: float,
    pixel_width: float,
) -> NDArray[np.float64]:
    """Length of the outer and inner contours of regions, from their cracks.

    Cauchy–Crofton formula with two directions of lines: the columns of pixels, `pixel_width` apart, meet the
    contour once per horizontal crack, the rows once per vertical crack, so that ``L = π/4 (horizontal_cracks
    * pixel_width + vertical_cracks * pixel_height)``.  In the mean over all directions it is unbiased; a
    straight line along the grid comes out π/4 times, a diagonal one π/(2√2) times its length.  The counts are
    integers and add up over blocks, so the length is the same for any tiling.

    Parameters
    ----------
    horizontal_cracks, vertical_cracks
        Counts, any shape.
    pixel_height, pixel_width
        Size of a rectangle on the ground; gives the unit of the result.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.regions.region_table import contour_length
    >>> contour_length(np.array([200]), np.array([40]), 0.5, 0.5).round(1).tolist()  # of a street of 50 m × 10 m
    [94.2]
    """
    length = np.asarray(horizontal_cracks) * pixel_width + np.asarray(vertical_cracks) * pixel_height
    return np.asarray(math.pi / 4 * length, dtype=np.float64)


# ------------------------------------------------------------------------------------------------- contacts


@rule
def contact_key(a: int, b: int, side: int) -> np.int64:
    """Two labels in order and the kind of their contact: 0 horizontal, 1 vertical."""
    return (np.int64(min(a, b)) << 32) | (np.int64(max(a, b)) << 1) | side


@loop
def _contact_keys(labels: Labels, flagged: NDArray[np.bool_], keys: Counts) -> int:
    """Number of rectangle sides between two different flagged labels; their keys go to `keys` while it has room."""
    rows, columns = labels.shape
    found = 0
    for i in range(rows):
        for j in range(columns):
            a = labels[i, j]
            if a == 0 or not flagged[a]:
                continue
            for side in range(2):
                if (i + 1 == rows) if side == 0 else (j + 1 == columns):
                    continue
                b = labels[i + 1, j] if side == 0 else labels[i, j + 1]
                if b != a and b != 0 and flagged[b]:
                    if found < keys.size:
                        keys[found] = contact_key(a, b, side)
                    found += 1
    return found


def region_contacts(labels: NDArray[np.int32], flagged: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Count the cracks between each two regions of a block that a seam may yet unite.

    Two parts of one region can touch inside a block without being joined there, because their grey values differ too
    much at the contact and what joins them lies beyond a seam.  The cracks between them, which `region_table` counted
    for both, must be taken back when the seams are reconciled.

    Parameters
    ----------
    labels
        Labels 0..n, shape (rows, columns).
    flagged
        bool, shape (n + 1,): labels that reach a seam; entry 0 is False.

    Returns
    -------
    ndarray of int64, shape (m, 4)
        Lower label, higher label, number of horizontal and of vertical rectangle sides between them; sorted.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.regions.region_table import region_contacts
    >>> labels = np.array([[1, 1, 2], [1, 1, 2], [3, 3, 3]], np.int32)
    >>> region_contacts(labels, np.array([False, True, True, False])).tolist()  # 1 and 2 reach a seam
    [[1, 2, 0, 2]]
    """
    xp = namespace(labels, flagged)
    labels = xp.ascontiguousarray(labels, dtype=xp.int32)
    if on_device(labels):
        keys = device_form(__name__).contact_keys(labels, flagged)
    else:
        keys = np.empty(4096, np.int64)
        found = _contact_keys(labels, flagged, keys)
        if found > keys.size:
            keys = np.empty(found, np.int64)
            _contact_keys(labels, flagged, keys)
        keys = keys[:found]
    unique, count = xp.unique(keys, return_counts=True)
    pairs, index = xp.unique(unique >> 1, return_inverse=True)
    result: NDArray[np.int64] = xp.zeros((pairs.size, 4), xp.int64)
    result[:, 0], result[:, 1] = pairs >> 31, pairs & 0x7FFFFFFF
    result[index, 2 + (unique & 1)] = count
    return result


# ------------------------------------------------------------------------------------------------- selection


@loop
def _select(result: NDArray[Any], labels: Labels, lookup: NDArray[Any]) -> bool:
    """Map labels row by row; return whether all of them lay in the lookup table."""
    for i in range(labels.shape[0]):
        row, into = labels[i], result[i]
        lowest, highest = row[0], row[0]
        for j in range(row.size):
            lowest, highest = min(lowest, row[j]), max(highest, row[j])
        if lowest < 0 or highest >= lookup.size:
            return False
        for j in range(row.size):
            into[j] = lookup[row[j]]
    return True


def select_labels(labels: NDArray[np.int32], lookup: NDArray[Any]) -> NDArray[Any]:
    """Replace each label by its entry in a lookup table.

    Parameters
    ----------
    labels
        Labels 0..len(lookup)-1, shape (rows, columns), integer.
    lookup
        One entry per label, shape (n + 1,), any dtype; entry 0 is for what belongs to no region.

    Returns
    -------
    ndarray
        ``lookup[labels]``, dtype of `lookup`.

    Raises
    ------
    ValueError
        For a label that has no entry, or arrays of other dimensions.

    Examples
    --------
    Of three regions the second is no street.

    >>> import numpy as np
    >>> from tilepipe_kernels.regions.region_table import select_labels
    >>> select_labels(np.array([[1, 2], [3, 0]], np.int32), np.array([False, True, False, True])).tolist()
    [[True, False], [True, False]]
    """
    if labels.ndim != 2 or lookup.ndim != 1:
        raise ValueError("labels must be two-dimensional and the lookup table one-dimensional")
    if on_device(labels, lookup):
        if labels.size and not (labels.min() >= 0 and labels.max() < lookup.size):
            raise ValueError(f"the lookup table has {lookup.size} entries, but some labels have no entry: extend it")
        return lookup[labels]
    result = np.empty(labels.shape, lookup.dtype)
    if labels.size and not _select(result, np.ascontiguousarray(labels), np.ascontiguousarray(lookup)):
        raise ValueError(f"the lookup table has {lookup.size} entries, but some labels have no entry: extend it")
    return result
