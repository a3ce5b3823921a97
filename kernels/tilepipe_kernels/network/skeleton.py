"""Skeletons of street masks: thin, centred, with the topology of the mask, and the same whatever the tiling.

Two steps.  *Anchors* are the integer medial axis of Hesselink & Roerdink (2008, "Euclidean skeletons of
digital image and volume data in linear time by the integer medial axis transform", IEEE PAMI 30): pixels
whose neighbour sees a nearest background pixel far from their own.  *Distance-ordered homotopic thinning*
(Pudney 1998, CVIU 72) then peels everything else, one layer of the Euclidean distance after the other, by
deleting simple points only.

Each layer is peeled in four subfields, by the parity of the global row and column.  No two pixels of a
subfield touch, so deleting all simple points of one at once is the same as deleting them one by one: topology
is kept exactly and the order inside a subfield is immaterial.  The number of subfield steps is fixed by `cap`
and never by the image, so a pixel depends on a bounded neighbourhood (`halo`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image import distance
from tilepipe_kernels.network.neighbours import IS_REMOVABLE, IS_SIMPLE, LINKS, code_at

SUBFIELDS = 4
CLEANING_SWEEPS = 4

# of a pixel's state the lowest bit says whether it is there
BACKGROUND, ANCHOR = np.uint8(0), np.uint8(3)
# positions in a block are int32
_LARGEST_BLOCK = 1 << 30
_WIDTH_BIAS = np.float32(0.2)


def halo(cap: int) -> int:
    """Pixels around a block that its medial axis can depend on.

    The distance reaches `cap`, an anchor one pixel more; every subfield step reaches one more pixel, and
    there are four a layer, `cap` layers, and four a cleaning sweep.

    Examples
    --------
    >>> from tilepipe_kernels.network.skeleton import halo
    >>> halo(cap=15)
    92
    """
    return distance.halo(cap) + 1 + SUBFIELDS * (distance.checked_cap(cap) + CLEANING_SWEEPS)


def medial_axis(
    mask: NDArray[Any],
    *,
    cap: int,
    separation: float = 5.0,
    angle: float = 110.0,
    origin: tuple[int, int] = (0, 0),
) -> NDArray[np.bool_]:
    """Thin Euclidean skeleton of a mask: the first result of :func:`medial_axis_and_distance`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.skeleton import medial_axis
    >>> street = np.zeros((11, 40), bool)
    >>> street[2:9] = True
    >>> np.flatnonzero(medial_axis(street, cap=6).any(axis=1)).tolist()  # the middle of rows 2 to 8
    [5]
    """
    return medial_axis_and_distance(mask, cap=cap, separation=separation, angle=angle, origin=origin)[0]


def medial_axis_and_distance(
    mask: NDArray[Any],
    *,
    cap: int,
    separation: float = 5.0,
    angle: float = 110.0,
    origin: tuple[int, int] = (0, 0),
) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Thin Euclidean skeleton of a mask, and the distance transform that it was made from.

    Parameters
    ----------
    mask
        Shape (rows, columns), bool or integer; nonzero is foreground.
    cap
        Half the width of the widest street, in pixels.  What is deeper is a yard and no street: it is kept
        whole while its surroundings are thinned, and then dropped, so that streets end where it begins.
    separation
        An anchor's disc touches the background in two pixels farther apart than this, in pixels; so bumps of
        the edge that are less wide make no branch.  A narrower street has no anchors, but what it connects
        stays connected, and a free end of it is drawn back by no more than a few pixels.
    angle
        An anchor sees those two pixels at more than this angle, in degrees (bisector angle; Couprie,
        Coeurjolly & Zrour 2007, Image and Vision Computing 25).  Along a street it is 180; above 90 the axis
        of a square-ended street does not fork towards the corners.
    origin
        Global (row, column) of ``mask[0, 0]``.

    Returns
    -------
    skeleton
        bool, shape (rows, columns): a subset of the mask.  Where the mask is no deeper than `cap` it has the
        mask's 8-connected components and 4-connected holes.  A street that runs off the array keeps its axis
        to the border.
    squared
        int32, as from :func:`tilepipe_kernels.image.distance.distance_squared`.

    Raises
    ------
    ValueError
        As :func:`~tilepipe_kernels.image.distance.distance_squared`; for a negative `separation`, or an `angle`
        outside 0 .. 180.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.skeleton import medial_axis_and_distance, width_at
    >>> street = np.zeros((12, 40), bool)
    >>> street[3:9] = True
    >>> axis, squared = medial_axis_and_distance(street, cap=6)
    >>> np.unique(width_at(squared[axis])).astype(float).round(1).tolist()  # of a street of six pixels
    [5.8]
    """
    if not separation >= 0:
        raise ValueError(f"separation must be 0 pixels or more, not {separation}")
    if not 0 <= angle <= 180:
        raise ValueError(f"angle must lie in 0 .. 180 degrees, not {angle}")
    cap = distance.checked_cap(cap)
    foreground = distance.mask_bytes(mask)
    if foreground.size > _LARGEST_BLOCK:
        raise ValueError(f"mask of {foreground.size} pixels is too large for one block; cut it into tiles")
    squared, row_offset, column_offset = distance.nearest_background(foreground, cap)
    state = namespace(foreground).pad(foreground, 1)
    distances = np.sqrt(np.arange(cap * cap + 2))
    # one pixel more, because the offsets of neighbours are taken from two centres
    chord = 2 * math.sin(math.radians(angle) / 2) * distances + 1
    apart_squared = np.maximum(chord, separation) ** 2
    apart_squared[0] = separation**2
    layer_of = np.ceil(distances).astype(np.int32)
    parity = int(origin[0]) & 1, int(origin[1]) & 1
    if on_device(state):
        device_form(__name__).thin(state, squared, (row_offset, column_offset), apart_squared, layer_of, parity)
    else:
        _mark_anchors(squared, row_offset, column_offset, apart_squared, state)
        starts, pixels = _layers(state, squared, layer_of, *parity)
        _thin(state.reshape(-1), state.shape[1], starts, pixels, IS_SIMPLE, IS_REMOVABLE)
    return (state[1:-1, 1:-1] != 0) & (squared <= cap * cap), squared


def skeleton_links(skeleton: NDArray[Any]) -> NDArray[np.uint8]:
    """Neighbours that every skeleton pixel is linked to, in mixed adjacency.

    Two skeleton pixels are linked when they share a side, or when they touch at a corner and no skeleton
    pixel shares a side with both: so a bend is a path and not a triangle.  Links are symmetric.  The halo is
    1 pixel.

    Parameters
    ----------
    skeleton
        Shape (rows, columns), bool or integer.

    Returns
    -------
    ndarray of uint8, shape (rows, columns)
        Bit k is set for a link to ``network.neighbours.NEIGHBOURS[k]``; 0 on the background and on lone pixels.

    Examples
    --------
    A bend is a path: its first and its last pixel touch at a corner, but are not linked.

    >>> import numpy as np
    >>> from tilepipe_kernels.network.skeleton import skeleton_links
    >>> links = skeleton_links(np.array([[1, 1], [0, 1]]))
    >>> [int(each).bit_count() for each in links.ravel()]
    [1, 2, 0, 1]
    """
    xp = namespace(skeleton)
    state = xp.pad(distance.mask_bytes(skeleton), 1)
    links: NDArray[np.uint8] = xp.zeros((state.shape[0] - 2, state.shape[1] - 2), xp.uint8)
    if on_device(links):
        device_form(__name__).link(state, links)
        return links
    _link(state.reshape(-1), state.shape[1], LINKS, links)
    return links


def width_at(squared: NDArray[Any]) -> NDArray[np.float32]:
    """Width in pixels of the region around an axis pixel, from its squared distance to the background.

    The width is ``2 d - 0.2``, set by simulation so that it has next to no bias over straight streets of 5
    to 15 px in random directions and positions (mean error -0.06 px, standard deviation 0.2 px, one street
    0.7 px at most).  Along rows and columns it is 0.8 px too large for odd widths and 0.2 px too small for
    even ones, because the distance runs to the centre of a background pixel and the axis lies on pixel
    centres.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.network.skeleton import width_at
    >>> width_at(np.array([9, 16])).astype(float).round(1).tolist()
    [5.8, 7.8]
    """
    xp = namespace(squared)
    width: NDArray[np.float32] = 2 * xp.sqrt(xp.asarray(squared, xp.float32)) - _WIDTH_BIAS
    return width


@rule
def subfield(row: int, column: int) -> int:
    """Which of the four subfields a pixel is in, by the parity of its global row and column."""
    return (row & 1) * 2 + (column & 1)


@rule
def axis_side(p_row: int, p_column: int, q_row: int, q_column: int, down: int, right: int, apart_squared: float) -> int:
    """Which of p and q = p + (down, right) is on the integer medial axis: 1 for p, 2 for q, 0 for neither.

    Hesselink & Roerdink's rule: the one nearer to the bisector of the two nearest background pixels, given by
    their offsets from p and q.  Where they tie, they take both; we take p, so that even widths do not get a
    double axis.
    """
    row_step, column_step = q_row + down - p_row, q_column + right - p_column
    if row_step * row_step + column_step * column_step <= apart_squared:
        return 0
    row_sum, column_sum = q_row + p_row, q_column + p_column
    return 2 if row_step * row_sum + column_step * column_sum > 0 else 1


@loop
def _mark_anchors(
    squared: NDArray[np.int32],
    row_offset: NDArray[np.int16],
    column_offset: NDArray[np.int16],
    apart_squared: NDArray[np.float64],
    state: NDArray[np.uint8],
) -> None:
    """Mark anchors in the padded state; `apart_squared`: least distance² of features, by distance²."""
    rows, columns = squared.shape
    far = apart_squared.size - 1
    for i in range(rows):
        for j in range(columns):
            here = squared[i, j]
            if here == far:
                continue
            p_row, p_column = int(row_offset[i, j]), int(column_offset[i, j])
            for down in range(2):
                right = 1 - down
                if i + down == rows or j + right == columns:
                    continue
                there = squared[i + down, j + right]
                if here + there == 0 or there == far:
                    continue
                q_row = int(row_offset[i + down, j + right])
                q_column = int(column_offset[i + down, j + right])
                apart = apart_squared[min(here, there)]
                side = axis_side(p_row, p_column, q_row, q_column, down, right, apart)
                if side == 1 and here > 0:
                    state[i + 1, j + 1] = ANCHOR
                elif side == 2 and there > 0:
                    state[i + 1 + down, j + 1 + right] = ANCHOR


@loop
def _bucket(state: int, squared: int, row: int, column: int, layer_of: NDArray[np.int32]) -> int:
    """Bucket of a pixel by layer and subfield, layer 0 for anchors; -1 on background and beyond the cap."""
    if state == BACKGROUND or squared == layer_of.size - 1:
        return -1
    layer = 0 if state == ANCHOR else layer_of[squared]
    return layer * SUBFIELDS + subfield(row, column)


@loop
def _layers(
    state: NDArray[np.uint8],
    squared: NDArray[np.int32],
    layer_of: NDArray[np.int32],
    row_parity: int,
    column_parity: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Flat positions in the padded state sorted by bucket, and where each bucket starts (counting sort)."""
    rows, columns = squared.shape
    starts = np.zeros(layer_of.max() * SUBFIELDS + 1, np.int64)
    for i in range(rows):
        for j in range(columns):
            bucket = _bucket(state[i + 1, j + 1], squared[i, j], i + row_parity, j + column_parity, layer_of)
            if bucket >= 0:
                starts[bucket + 1] += 1
    starts = np.cumsum(starts)
    following = starts.copy()
    pixels = np.empty(starts[-1], np.int32)
    for i in range(rows):
        for j in range(columns):
            bucket = _bucket(state[i + 1, j + 1], squared[i, j], i + row_parity, j + column_parity, layer_of)
            if bucket >= 0:
                pixels[following[bucket]] = (i + 1) * state.shape[1] + j + 1
                following[bucket] += 1
    return starts, pixels


@loop
def _peel(
    state: NDArray[np.uint8],
    stride: int,
    pixels: NDArray[np.int32],
    deletable: NDArray[np.uint8],
    kept: NDArray[np.int32],
    kept_count: int,
) -> int:
    """Delete the pixels of one subfield that may go, append the others to `kept`, return its new length."""
    for p in pixels:
        if deletable[code_at(state, p, stride)]:
            state[p] = BACKGROUND
        else:
            kept[kept_count] = p
            kept_count += 1
    return kept_count


@loop
def _thin(
    state: NDArray[np.uint8],
    stride: int,
    starts: NDArray[np.int64],
    pixels: NDArray[np.int32],
    is_simple: NDArray[np.uint8],
    is_removable: NDArray[np.uint8],
) -> None:
    """Peel layer by layer, retry in later layers what was kept, then clean anchors and all that is left.

    Every layer is stepped through even when empty here, because another block may see it filled.
    """
    totals = np.zeros(SUBFIELDS, np.int64)
    for bucket in range(starts.size - 1):
        totals[bucket % SUBFIELDS] += starts[bucket + 1] - starts[bucket]
    kept = np.empty((SUBFIELDS, totals.max()), np.int32)
    counts = np.zeros(SUBFIELDS, np.int64)
    for bucket in range(SUBFIELDS, starts.size - 1):
        field = bucket % SUBFIELDS
        retried = _peel(state, stride, kept[field, : counts[field]], is_removable, kept[field], 0)
        layer = pixels[starts[bucket] : starts[bucket + 1]]
        counts[field] = _peel(state, stride, layer, is_simple, kept[field], retried)
    for field in range(SUBFIELDS):
        anchors = pixels[starts[field] : starts[field + 1]]
        kept[field, counts[field] : counts[field] + anchors.size] = anchors
        counts[field] += anchors.size
    for _ in range(CLEANING_SWEEPS):
        for field in range(SUBFIELDS):
            counts[field] = _peel(state, stride, kept[field, : counts[field]], is_removable, kept[field], 0)


@loop
def _link(state: NDArray[np.uint8], stride: int, table: NDArray[np.uint8], links: NDArray[np.uint8]) -> None:
    """Look up the links of every skeleton pixel."""
    rows, columns = links.shape
    for i in range(rows):
        for j in range(columns):
            p = (i + 1) * stride + j + 1
            if state[p] != 0:
                links[i, j] = table[code_at(state, p, stride)]
