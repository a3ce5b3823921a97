"""Bare earth under a surface of heights: what remains when everything narrower than a largest object is taken off.

The surface is reduced to the lowest heights of coarse cells, which are opened by squares of growing size
(Zhang et al. 2003, "A progressive morphological filter for removing nonground measurements from airborne lidar
data", IEEE TGRS 41(4), eqs 2-6).  A cell whose height drops by more than terrain can at one size is an object;
its ground is interpolated from the cells around by pull-push (Gortler et al. 1996, "The lumigraph", section 3.4),
at the top of which the opened surface stands in.  Cells are anchored to the global grid and every step has a
bounded reach, so the ground does not depend on the tiling.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form
from tilepipe_kernels.heights import ground_loops
from tilepipe_kernels.heights.ground_loops import MISSING, Floats

CELL = 2.0
"""Side of a coarse cell in metres, rounded to whole pixels: less than the width of an alley between houses."""

_LEVELS = 3
_PIT_HALF_WIDTH = 2
_LEAST_STEP = 0.1
_STEP_GROWTH = 0.05


def cell_side(resolution: float) -> int:
    """Side of a coarse cell in pixels of `resolution` metres.

    Examples
    --------
    >>> from tilepipe_kernels.heights.ground import cell_side
    >>> cell_side(0.5), cell_side(0.1)
    (4, 20)
    """
    if not (math.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres per pixel, not {resolution}")
    return max(1, round(CELL / resolution))


def half_widths(resolution: float, largest_object: float) -> list[int]:
    """Half widths in cells of the squares that open the surface: by ones first, then by an eighth more each.

    Examples
    --------
    >>> from tilepipe_kernels.heights.ground import half_widths
    >>> half_widths(0.5, largest_object=40)
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    """
    if not (math.isfinite(largest_object) and largest_object > 0):
        raise ValueError(f"largest_object must be a positive number of metres, not {largest_object}")
    last = math.ceil(largest_object / (2 * cell_side(resolution) * resolution))
    widths = [1]
    while widths[-1] < last:
        widths.append(min(last, widths[-1] + max(1, widths[-1] // 8)))
    return widths


def halo(resolution: float, largest_object: float = 80.0) -> int:
    """Pixels around a block that `ground_height` can depend on.

    In cells: an opening reaches two half widths and a closing of the pits likewise; pull-push reaches less than
    three squares of its coarsest level; one more each for the fall across a cell, the interpolation to pixels and
    a cell cut by the end of the block.

    Examples
    --------
    >>> from tilepipe_kernels.heights.ground import halo
    >>> halo(0.5, largest_object=40)
    204
    >>> halo(1.0, largest_object=40)  # pixels twice as large
    102
    """
    cells = 2 * half_widths(resolution, largest_object)[-1] + 2 * _PIT_HALF_WIDTH + 3 * 2**_LEVELS + 3
    return int(cells * cell_side(resolution))


# ------------------------------------------------------------------------------------------ where steps run


class Steps(NamedTuple):
    """The steps that walk pixels or cells, as loops of the host or grids of a device; see `ground_loops`."""

    window_lowest: Callable[[Floats, int], Floats]
    lowest_of_cells: Callable[..., None]
    mean_of_cells: Callable[..., None]
    pull: Callable[[Floats, Floats], None]
    spread: Callable[..., None]


_STEPS = Steps(
    ground_loops.window_lowest, ground_loops.lowest_of_cells, ground_loops.mean_of_cells, ground_loops.pull,
    ground_loops.spread,
)  # fmt: skip


def _steps(block: Floats) -> Steps:
    """The steps for blocks of one kind."""
    if on_device(block):
        return device_form(__name__).STEPS
    return _STEPS


def window_lowest(values: Floats, half_width: int) -> Floats:
    """Minimum over the square of 2 half_width + 1 pixels; what lies beyond the block, and infinity, counts for nothing.

    `values` is a float32 block without NaN, shape (rows, columns); on the host the cost does not grow with the square.
    Arrays of a device stay there.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.heights.ground import window_lowest
    >>> window_lowest(np.float32([[5, 9, 9, 9, 7, 8]]), half_width=1).tolist()
    [[5.0, 5.0, 9.0, 7.0, 7.0, 7.0]]
    """
    return _steps(values).window_lowest(values, half_width)


def window_highest(values: Floats, half_width: int) -> Floats:
    """Maximum over the square of 2 half_width + 1 pixels; see :func:`window_lowest`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.heights.ground import window_highest
    >>> window_highest(np.float32([[5, 9, 4, 3, 7, 8]]), half_width=1).tolist()
    [[9.0, 9.0, 9.0, 7.0, 8.0, 8.0]]
    """
    return -window_lowest(-values, half_width)


# ------------------------------------------------------------------------------------------ terrain


def allowed_loss(before: int, width: int, metres: float, slope: float, step: float) -> float:
    """Height in metres that terrain may lose between the openings by two half widths, given in cells.

    A ridge with `slope` on both sides loses slope times the difference of the half widths, a diagonal one sqrt(2)
    times as much.  Onto that comes a terrace, quay or embankment, up to `step`, the lower the narrower it is.

    Examples
    --------
    From squares of half width 4 to those of 5 cells, each 2 m: terrain may lose more where it is steeper.

    >>> from tilepipe_kernels.heights.ground import allowed_loss
    >>> round(allowed_loss(4, 5, metres=2.0, slope=0.3, step=1.5), 2)
    1.45
    >>> round(allowed_loss(4, 5, metres=2.0, slope=0.6, step=1.5), 2)
    2.3
    """
    return min(step, _LEAST_STEP + _STEP_GROWTH * metres * width) + math.sqrt(2) * slope * metres * (width - before)


def _terrain(
    low: Floats, widths: list[int], metres: float, slope: float, step: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """The lowest surface with objects cut down to the last opening, and which cells are no ground."""
    xp = namespace(low)
    objects = low == MISSING
    eroded = opened = low
    before = 0
    for width in widths:
        eroded = window_lowest(eroded, width - before)
        after = window_highest(xp.where(eroded == MISSING, -MISSING, eroded), width)
        objects |= opened > after + np.float32(allowed_loss(before, width, metres, slope, step))
        opened, before = after, width
    surface = xp.where(objects, opened, low)
    # A pit is the dual of an object: what a small closing of the ground fills by more than a step.
    closed = window_lowest(window_highest(surface, _PIT_HALF_WIDTH), _PIT_HALF_WIDTH)
    return surface, objects | (surface + np.float32(step) < closed)


def _filled(values: Floats, stand_in: Floats) -> Floats:
    """Pull-push: what is missing comes from the mean of the next coarser level, at the top from `stand_in`."""
    xp, steps = namespace(values, stand_in), _steps(values)
    levels, spare = [values], stand_in
    for _ in range(_LEVELS):
        shape = (levels[-1].shape[0] // 2, levels[-1].shape[1] // 2)
        coarse, spare_coarse = xp.empty(shape, np.float32), xp.empty(shape, np.float32)
        steps.pull(coarse, levels[-1])
        steps.pull(spare_coarse, spare)
        levels.append(coarse)
        spare = spare_coarse
    filled = xp.where(levels[-1] == MISSING, spare, levels[-1])
    for fine in reversed(levels[:-1]):
        steps.spread(fine, fine == MISSING, filled, 2, 0, 0)
        filled = fine
    return filled


def ground_height(
    dsm: NDArray[Any],
    *,
    resolution: float,
    largest_object: float = 80.0,
    slope: float = 0.3,
    step: float = 1.5,
    origin: tuple[int, int] = (0, 0),
) -> NDArray[np.float32]:
    """Height of the bare earth, estimated from a surface model alone.

    Parameters
    ----------
    dsm
        Heights in metres, shape (rows, columns), any real dtype; computed in float32.  What is not finite is nodata
        and takes no part.
    resolution
        Side of a pixel in metres.
    largest_object
        Metres.  Objects whose narrower side is less than this are taken off; wider ones are ground.
    slope
        Steepest slope of terrain on both sides of a ridge, metres per metre.  A plane slope is never cut, however
        steep.
    step
        Highest terrace, quay or embankment that is terrain, in metres; less than the lowest roof.
    origin
        Global row and column of ``dsm[0, 0]``; the coarse cells are anchored to the global grid.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Height of the ground in metres; NaN where `dsm` is nodata.  ``dsm - ground`` is the height above ground.
        Arrays of a device stay there.

    Raises
    ------
    ValueError
        For a block that is not two-dimensional and real, or a parameter out of its range.

    Notes
    -----
    Between two opening sizes terrain may lose `allowed_loss`; that is eq. 5 of Zhang et al. (2003) with the
    openings grown in steps so small that the slope's share of it stays below the height of a roof.

    Examples
    --------
    A house of 20 m × 20 m and 8 m in height on a slope of 5 %, in pixels of 1 m.

    >>> import numpy as np
    >>> from tilepipe_kernels.heights.ground import ground_height
    >>> terrain = np.tile(100 + 0.05 * np.arange(120), (120, 1))
    >>> surface = terrain.copy()
    >>> surface[50:70, 50:70] += 8
    >>> above = surface - ground_height(surface, resolution=1.0, largest_object=40)
    >>> round(float(above[60, 60]), 1), round(abs(float(above[60, 20])), 1)
    (8.0, 0.0)
    """
    array = dsm if on_device(dsm) else np.asarray(dsm)
    if array.ndim != 2 or array.dtype.kind not in "buif":
        raise ValueError(f"dsm must be a two-dimensional real array, not {array.dtype} of shape {array.shape}")
    if not (math.isfinite(slope) and slope >= 0 and math.isfinite(step) and step >= 0):
        raise ValueError(f"slope and step must be 0 or more, not {slope} and {step}")
    side, widths = cell_side(resolution), half_widths(resolution, largest_object)
    xp, steps = namespace(array), _steps(array)
    block = xp.ascontiguousarray(array, dtype=np.float32)
    if block.size == 0:
        return block.copy()
    # Cells start at the coarsest level of the pyramid, so that the levels are halves of each other.
    square = side << _LEVELS
    row_shift, column_shift = origin[0] % square, origin[1] % square
    shape = (
        -(-(block.shape[0] + row_shift) // square) << _LEVELS,
        -(-(block.shape[1] + column_shift) // square) << _LEVELS,
    )
    low = xp.empty(shape, np.float32)
    steps.lowest_of_cells(low, block, side, row_shift, column_shift)
    surface, objects = _terrain(low, widths, side * resolution, slope, step)
    mean = xp.where(objects, MISSING, low)
    steps.mean_of_cells(mean, low, surface, block, np.float32(step), side, row_shift, column_shift)
    filled = _filled(mean, surface)
    # Cells of nodata and beyond the raster would only blur what is known at its border.
    filled[low == MISSING] = MISSING
    ground = xp.full(block.shape, np.nan, np.float32)
    steps.spread(ground, xp.isfinite(block), filled, side, row_shift, column_shift)
    return ground
