"""Lines that run side by side at the width of a street: what each of two borders sees across the street.

Lines are sampled at even steps.  From each sample one looks along the normal, to both sides, for the nearest sample
of a line that runs parallel and has the same of its sides towards the viewer: the darker or the brighter one.  Two
samples that see each other's lines are opposite each other.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop, rule
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import Int64, offsets_of

_CELL = 1.25
"""Side of the cells by which samples near a ray are found, in steps of the sampling."""

_AT_ONCE = 1 << 14
"""Samples that a thread looks from before it takes the next."""

_ACROSS = 0.75
"""How far beside the normal a sample may lie, in steps of the sampling."""

_SAME_WIDTH = 0.2
"""Largest difference of the widths that two opposite samples see, as a share."""

LEFT, RIGHT = 0, 1

Float64 = NDArray[np.float64]


class Samples(NamedTuple):
    """Points along lines.

    Attributes
    ----------
    points
        float64 (n, 2): row and column.
    directions
        float64 (n, 2): unit vectors along the line.
    line
        int64 (n,): the line of each.
    """

    points: Float64
    directions: Float64
    line: Int64


@loop
def _sample(
    offsets: Int64, vertices: Float64, step: float, points: Float64, directions: Float64, line: Int64, starts: Int64
) -> None:
    for i in range(offsets.size - 1):
        number = starts[i + 1] - starts[i]
        length = 0.0
        for k in range(offsets[i], offsets[i + 1] - 1):
            length += math.hypot(vertices[k + 1, 0] - vertices[k, 0], vertices[k + 1, 1] - vertices[k, 1])
        at, passed = starts[i], 0.0
        for k in range(offsets[i], offsets[i + 1] - 1):
            down, right = vertices[k + 1, 0] - vertices[k, 0], vertices[k + 1, 1] - vertices[k, 1]
            part = math.hypot(down, right)
            last = k == offsets[i + 1] - 2
            while at < starts[i + 1]:
                wanted = (at - starts[i] + 0.5) * length / number
                if (wanted > passed + part and not last) or part == 0.0:
                    break
                share = min(1.0, (wanted - passed) / part)
                points[at, 0], points[at, 1] = vertices[k, 0] + share * down, vertices[k, 1] + share * right
                directions[at, 0], directions[at, 1] = down / part, right / part
                line[at] = i
                at += 1
            passed += part


def sample_lines(lines: Polylines, step: float) -> Samples:
    """Points in the middle of even parts of each line, about `step` long.

    Parameters
    ----------
    lines
        With vertices (row, column) in whatever unit; no line has the length 0.
    step
        Length of a part, in that unit.

    Returns
    -------
    Samples

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.parallel_lines import sample_lines
    >>> samples = sample_lines(Polylines(np.array([0, 2]), np.array([[0.0, 0.0], [0.0, 4.0]])), step=2.0)
    >>> samples.points.tolist(), samples.directions[0].tolist()
    ([[0.0, 1.0], [0.0, 3.0]], [0.0, 1.0])
    """
    if not step > 0:
        raise ValueError(f"step must be more than 0, not {step}")
    starts = offsets_of(np.maximum(1, np.rint(lines.lengths() / step).astype(np.int64)))
    total = int(starts[-1])
    samples = Samples(np.empty((total, 2)), np.empty((total, 2)), np.zeros(total, np.int64))
    _sample(lines.offsets, np.ascontiguousarray(lines.vertices, np.float64), step, *samples, starts)
    return samples


@rule
def _cell(value: float, low: float, side: float) -> int:
    return int(math.floor((value - low) / side))


@loop
def _look(
    points: Float64, directions: Float64, line: Int64, darker: NDArray[np.int8], cell_starts: Int64, members: Int64,
    rows: int, columns: int, low_row: float, low_column: float, step: float, least: float, most: float, cosine: float,
    first: int, last: int, seen: Int64, width: Float64,
) -> None:  # fmt: skip
    """For samples `first` to `last` and each side the nearest sample they see, and how far that is along the normal."""
    cell = _CELL * step
    for a in range(first, last):
        for side in range(2):
            turn = 1.0 if side == LEFT else -1.0
            # left of a direction (down, right) is (-right, down)
            normal_row, normal_column = -turn * directions[a, 1], turn * directions[a, 0]
            nearest, best = np.int64(-1), most
            reach = 0.0
            while reach <= best + cell and darker[line[a]] >= 0:
                i = _cell(points[a, 0] + reach * normal_row, low_row, cell)
                j = _cell(points[a, 1] + reach * normal_column, low_column, cell)
                for y in range(max(0, i - 1), min(rows, i + 2)):
                    for x in range(max(0, j - 1), min(columns, j + 2)):
                        for m in range(cell_starts[y * columns + x], cell_starts[y * columns + x + 1]):
                            b = members[m]
                            down, right = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
                            along = down * normal_row + right * normal_column
                            across = abs(down * directions[a, 0] + right * directions[a, 1])
                            if along < least or along > best or across > _ACROSS * step or darker[line[b]] < 0:
                                continue
                            if along == best and nearest >= 0 and b >= nearest:
                                continue
                            parallel = directions[a, 0] * directions[b, 0] + directions[a, 1] * directions[b, 1]
                            if abs(parallel) < cosine:
                                continue
                            # a line that runs the other way has the viewer on its same side
                            facing = side if parallel < 0 else 1 - side
                            if (darker[line[a]] == side) == (darker[line[b]] == facing):
                                nearest, best = b, along
                reach += cell
            seen[a, side], width[a, side] = nearest, best


class Opposite(NamedTuple):
    """What samples see.

    Attributes
    ----------
    seen
        int64 (n, 2): the sample that each sees to its left and to its right, -1 = none; only mutual sights.
    width
        float64 (n, 2): its distance along the normal.
    """

    seen: Int64
    width: Float64


def opposite_samples(
    samples: Samples,
    darker: NDArray[np.int8],
    *,
    step: float,
    least: float,
    most: float,
    angle: float,
    workers: int = 1,
) -> Opposite:
    """Samples that lie opposite each other across a street.

    Parameters
    ----------
    samples
        Of `sample_lines`.
    darker
        int8, by line: `LEFT` or `RIGHT`, the side on which the image is darker; -1 = neither, such lines are left out.
    step
        Of the sampling.
    least, most
        Narrowest and widest street, in the unit of the points.
    angle
        Largest angle between the two borders, degrees.
    workers
        Threads; they do not change the result.

    Returns
    -------
    Opposite

    Raises
    ------
    ValueError
        When ``least`` is not more than 0 or exceeds ``most``.

    Examples
    --------
    Two borders 8 apart, the image dark between them.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.parallel_lines import LEFT, RIGHT, opposite_samples, sample_lines
    >>> vertices = np.array([[0.0, 0.0], [0.0, 20.0], [8.0, 0.0], [8.0, 20.0]])
    >>> samples = sample_lines(Polylines(np.array([0, 2, 4]), vertices), step=2.0)
    >>> darker = np.array([RIGHT, LEFT], np.int8)
    >>> found = opposite_samples(samples, darker, step=2.0, least=5.0, most=15.0, angle=20.0)
    >>> np.unique(found.width[found.seen >= 0]).tolist(), int((found.seen >= 0).sum())
    ([8.0], 20)
    """
    if not 0 < least <= most:
        raise ValueError(f"need 0 < least <= most, not {least} and {most}")
    count = samples.line.size
    seen, width = np.full((count, 2), -1, np.int64), np.full((count, 2), np.nan)
    if not count:
        return Opposite(seen, width)
    low = samples.points.min(axis=0)
    cells = np.floor((samples.points - low) / (_CELL * step)).astype(np.int64)
    rows, columns = (int(size) + 1 for size in cells.max(axis=0))
    flat = cells[:, 0] * columns + cells[:, 1]
    members = np.argsort(flat, kind="stable")
    starts = offsets_of(np.bincount(flat, minlength=rows * columns))
    sides, cosine = np.asarray(darker, np.int8), math.cos(math.radians(angle))

    def look(first: int) -> None:
        _look(
            *samples, sides, starts, members, rows, columns, low[0], low[1],
            step, least, most, cosine, first, min(first + _AT_ONCE, count), seen, width,
        )  # fmt: skip

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(look, range(0, count, _AT_ONCE)))
    _keep_mutual(samples, seen, width)
    return Opposite(seen, width)


def _keep_mutual(samples: Samples, seen: Int64, width: Float64) -> None:
    """Forget what is not seen back at about the same width."""
    own, other = np.where(seen >= 0, samples.line[:, None], -1), np.where(seen >= 0, samples.line[seen], -2)
    parallel = np.einsum("ik,ijk->ij", samples.directions, samples.directions[seen])
    facing = np.where(parallel < 0, [[LEFT, RIGHT]], [[RIGHT, LEFT]])
    back = seen[seen, facing]
    returned = np.where((seen >= 0) & (back >= 0), samples.line[back], -3)
    alike = np.abs(width[seen, facing] - width) <= _SAME_WIDTH * width
    lost = (returned != own) | (other < 0) | ~alike
    seen[lost], width[lost] = -1, np.nan
