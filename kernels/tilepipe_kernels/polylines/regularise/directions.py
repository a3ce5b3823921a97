"""Main directions of regions whose borders run along two perpendicular directions, as those of buildings do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Vertices
from tilepipe_kernels.core.ragged import Int64
from tilepipe_kernels.core.union_find import flatten, root_of
from tilepipe_kernels.polylines.join import Arcs
from tilepipe_kernels.polylines.regularise.points import doubled_areas

LEAST_AREA = 12.0
"""Area (m²) from which the border of a region tells a direction."""
LEAST_SHARE = 0.75
"""Share of its border's length that must run along the main directions of a building-like region."""

_NEAR = float(np.cos(4 * np.radians(15)))
_ALONG = float(np.cos(4 * np.radians(20)))
_AGREE = float(np.cos(4 * np.radians(8)))

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Directions:
    """Main directions of the regions of arcs.

    Attributes
    ----------
    left, right
        int64, shape (n,): row in the other arrays of the region on each side of an arc; row 0 = nodata or outside.
    frame
        int64, shape (r,): number shared by the regions that share a direction, -1 = region without one.
    quarter
        complex128, shape (r,): ``exp(4 i φ)`` of the angle φ between columns and a main direction, towards rows.
    """

    left: Int64
    right: Int64
    frame: Int64
    quarter: Complex


def main_directions(
    arcs: Arcs,
    shape: tuple[int, int],
    pixel_height: float,
    pixel_width: float,
    regions: NDArray[np.bool_] | None = None,
) -> Directions:
    """Find the main direction of each building-like region; neighbours that agree share theirs.

    The direction is the mean of the edges' directions on the circle of right angles, where longer edges count by the
    square of their length, since theirs is known the better; twice repeated with the edges near it. The raster's outer
    border does not count.

    Parameters
    ----------
    arcs
        Simplified arcs of a raster.
    shape
        Rows and columns of the raster.
    pixel_height, pixel_width
        Size of a pixel in m.
    regions
        bool, indexed by region id: which regions count. Default: those of `LEAST_AREA` whose border runs with
        `LEAST_SHARE` of its length within 20° of the main directions.

    Returns
    -------
    Directions

    Examples
    --------
    A building whose longer walls run at 30° from columns towards rows.

    >>> import numpy as np
    >>> from tilepipe_kernels.polylines.arcs import trace_arcs
    >>> from tilepipe_kernels.polylines.join import join_arcs
    >>> from tilepipe_kernels.polylines.regularise.directions import main_directions
    >>> from tilepipe_kernels.polylines.simplify import simplify_polylines
    >>> y, x = np.mgrid[-60:60, -60:60]
    >>> labels = 1 + ((abs(0.87 * x + 0.5 * y) < 30) & (abs(0.87 * y - 0.5 * x) < 20)).astype(np.int32)
    >>> arcs = simplify_polylines(join_arcs([trace_arcs(labels)]), tolerance=1.0)
    >>> building = np.array([False, False, True])
    >>> quarter = main_directions(arcs, labels.shape, 1.0, 1.0, building).quarter
    >>> round(np.degrees(np.angle(quarter[-1])).item() / 4)
    30
    """
    ids, left, right = _numbered(arcs.left.astype(np.int64), arcs.right.astype(np.int64))
    if regions is None:
        area = doubled_areas(arcs.offsets, arcs.vertices, left, right) / 2
        wanted = area * pixel_height * pixel_width >= LEAST_AREA
    else:
        wanted = np.asarray(regions, bool)[np.minimum(ids, len(regions) - 1)] & (ids < len(regions))
    wanted[0] = False
    sizes = pixel_height, pixel_width
    least, sums = -1.0, np.zeros(ids.size, np.complex128)
    for _ in range(3):
        quarter = _units(sums)
        sums, _, _ = _votes(arcs.offsets, arcs.vertices, left, right, wanted, quarter, least, shape, sizes)
        least = _NEAR
    quarter = _units(sums)
    if regions is None:
        _, length, along = _votes(arcs.offsets, arcs.vertices, left, right, wanted, quarter, _ALONG, shape, sizes)
        wanted &= along >= LEAST_SHARE * length
    wanted &= sums != 0
    frame = _shared(*_neighbours(arcs, left, right, wanted, sizes), sums, wanted)
    return Directions(left, right, frame, np.where(frame >= 0, _units(sums)[frame], 0))


def _numbered(left: Int64, right: Int64) -> tuple[Int64, Int64, Int64]:
    """Ids of regions, ascending from 0, and their places on both sides of the arcs."""
    largest = max(int(left.max(initial=0)), int(right.max(initial=0)))
    if largest > 8 * left.size + 1024:
        ids, place = np.unique(np.concatenate([[0], left, right]), return_inverse=True)
        return ids, place[1 : left.size + 1], place[left.size + 1 :]
    present = np.zeros(largest + 1, np.bool_)
    present[0] = present[left] = present[right] = True
    place = np.cumsum(present) - 1
    return np.flatnonzero(present), place[left], place[right]


def _units(vectors: Complex) -> Complex:
    size = np.abs(vectors)
    units: Complex = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)
    return units


def _neighbours(
    arcs: Arcs, left: Int64, right: Int64, wanted: NDArray[np.bool_], sizes: tuple[float, float]
) -> tuple[Int64, Int64]:
    """Pairs of wanted regions that share a border, the longest borders first."""
    both = np.flatnonzero(wanted[left] & wanted[right])
    low, high = np.minimum(left, right)[both], np.maximum(left, right)[both]
    keys, pair = np.unique(low << 32 | high, return_inverse=True)
    length = np.bincount(pair, weights=arcs.lengths(*sizes)[both], minlength=keys.size)
    keys = keys[np.argsort(-length, kind="stable")]
    return keys >> 32, keys & (2**32 - 1)


@rule
def quarter_turns(right: float, down: float) -> complex:
    """``exp(4 i φ)`` of the direction φ of a vector that is not zero."""
    unit = complex(right, down)
    square = unit * unit / (right * right + down * down)
    return square * square


@rule
def closeness(one: complex, other: complex) -> float:
    """Cosine of four times the angle between two directions of length one; more, the nearer they are."""
    return one.real * other.real + one.imag * other.imag


@rule
def on_one_side(one: Vertices, other: Vertices, shape: tuple[int, int]) -> bool:
    """Whether two vertices lie on one side of the raster."""
    level = one[0] == other[0] and (one[0] == 0 or one[0] == shape[0])
    return bool(level or (one[1] == other[1] and (one[1] == 0 or one[1] == shape[1])))


@loop
def _votes(
    offsets: Int64,
    vertices: Vertices,
    left: Int64,
    right: Int64,
    wanted: NDArray[np.bool_],
    quarter: Complex,
    least: float,
    shape: tuple[int, int],
    sizes: tuple[float, float],
) -> tuple[Complex, Float, Float]:
    """Sums over a region's edges: directions of those near ``quarter``, the length of all, and of those near."""
    sums, length, near = np.zeros(len(wanted), np.complex128), np.zeros(len(wanted)), np.zeros(len(wanted))
    for arc in range(len(left)):
        for region in (left[arc], right[arc]):
            if not wanted[region]:
                continue
            for k in range(offsets[arc] + 1, offsets[arc + 1]):
                if on_one_side(vertices[k - 1], vertices[k], shape):
                    continue
                down = (vertices[k, 0] - vertices[k - 1, 0]) * sizes[0]
                across = (vertices[k, 1] - vertices[k - 1, 1]) * sizes[1]
                square = down * down + across * across
                direction = quarter_turns(across, down)
                length[region] += np.sqrt(square)
                if closeness(direction, quarter[region]) >= least:
                    near[region] += np.sqrt(square)
                    sums[region] += square * direction
    return sums, length, near


@loop
def _shared(one: Int64, other: Int64, sums: Complex, wanted: NDArray[np.bool_]) -> Int64:
    """Join neighbours that agree, in the given order; ``sums`` becomes the sum of all that share a frame."""
    root = np.arange(len(wanted))
    for k in range(len(one)):
        a, b = root_of(root, one[k]), root_of(root, other[k])
        if a != b and closeness(sums[a], sums[b]) >= _AGREE * abs(sums[a]) * abs(sums[b]):
            a, b = min(a, b), max(a, b)
            root[b] = a
            sums[a] += sums[b]
    flatten(root)
    return np.where(wanted, root, -1)
