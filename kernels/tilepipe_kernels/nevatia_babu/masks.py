"""Nevatia & Babu's six oriented 5 × 5 masks: magnitude and direction of an edge at every pixel.

Nevatia and Babu, "Linear Feature Extraction and Description", Computer Graphics and Image Processing 13, 1980,
Section 2.1.

Directions are numbered 0 … 11 in units of 30°, counterclockwise from the row axis (columns rightward): direction k
says that the bright side of the edge lies at 30° k.  An edge runs with its bright side on its left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule
from tilepipe_kernels.image.gaussian import as_block

Floats = NDArray[np.float32]
Directions = NDArray[np.uint8]
Five = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]

NO_DIRECTION = 255
"""Direction of a pixel without an edge: nodata near, a flat neighbourhood, or thinned away."""

MASK_RADIUS = 2
MASKS = np.array(
    [
        [[-100, -100, 0, 100, 100]] * 5,
        [
            [-100, 32, 100, 100, 100],
            [-100, -78, 92, 100, 100],
            [-100, -100, 0, 100, 100],
            [-100, -100, -92, 78, 100],
            [-100, -100, -100, -32, 100],
        ],
        [
            [100, 100, 100, 100, 100],
            [-32, 78, 100, 100, 100],
            [-100, -92, 0, 92, 100],
            [-100, -100, -100, -78, 32],
            [-100, -100, -100, -100, -100],
        ],
        [[100] * 5, [100] * 5, [0] * 5, [-100] * 5, [-100] * 5],
        [
            [100, 100, 100, 100, 100],
            [100, 100, 100, 78, -32],
            [100, 92, 0, -92, -100],
            [32, -78, -100, -100, -100],
            [-100, -100, -100, -100, -100],
        ],
        [
            [100, 100, 100, 32, -100],
            [100, 100, 92, -78, -100],
            [100, 100, 0, -100, -100],
            [100, 78, -92, -100, -100],
            [100, -32, -100, -100, -100],
        ],
    ],
    np.int32,
)
"""Weights of the masks of 0°, 30°, …, 150°, shape (6, 5, 5); each the negative of itself turned by 180°."""

STEP_RESPONSE = 1000
"""Magnitude at a vertical or horizontal edge between two flat sides that differ by one grey level."""

ZERO, ONE, INFINITY = np.float32(0), np.float32(1), np.float32(np.inf)
FULL, NEAR_FULL, OPPOSITE = np.float32(100), np.float32(92), np.float32(6)
# Half sum and half difference of the weights 100 and 78, 100 and -78, 100 and 32, 100 and -32.
SUM_78, DIFFERENCE_78 = np.float32(89), np.float32(11)
SUM_32, DIFFERENCE_32 = np.float32(66), np.float32(34)
NONE = np.float32(NO_DIRECTION)


@rule
def _stronger(
    magnitude: np.float32, direction: np.float32, response: np.float32, index: np.float32
) -> tuple[np.float32, np.float32]:
    """Of the best mask so far and the next one that which answers more strongly, the former if equal."""
    size = abs(response)
    turned = index if response > ZERO else index + OPPOSITE
    return (size if size > magnitude else magnitude), (turned if size > magnitude else direction)


@inlined_rule
def edge_at(top: Five, upper: Five, middle: Five, lower: Five, bottom: Five) -> tuple[np.float32, np.float32]:
    """Magnitude and direction at the centre of 5 × 5 pixels; (NaN, 255) where one of them is not finite.

    By antisymmetry a mask weighs the differences of opposite pixels only. The masks of 30° and 150°, and those of 60°
    and 120°, mirror each other: their responses are sum and difference of what they share.  All weights are integers,
    so integer images up to 15 000 grey levels have exact responses.
    """
    a2, a1, a0, b1, b2 = (
        top[0] - bottom[4], top[1] - bottom[3], top[2] - bottom[2], top[3] - bottom[1], top[4] - bottom[0],
    )  # fmt: skip
    c2, c1, c0, d1, d2 = (
        upper[0] - lower[4], upper[1] - lower[3], upper[2] - lower[2], upper[3] - lower[1], upper[4] - lower[0],
    )  # fmt: skip
    side1, side2 = middle[3] - middle[1], middle[4] - middle[0]
    top_even, top_odd = b1 + a1, b1 - a1
    upper_even, upper_odd = d1 + c1, d1 - c1
    corners, outer, outer_odd = b2 - a2, d2 + c2, d2 - c2
    sides = side1 + side2
    top_sum = a0 + top_even + (b2 + a2)
    flat_even = FULL * a0 + NEAR_FULL * c0 + SUM_32 * top_even + DIFFERENCE_78 * upper_even
    flat_odd = FULL * (corners + outer_odd + sides) + DIFFERENCE_32 * top_odd + SUM_78 * upper_odd
    steep_even = FULL * (top_sum + c0) + SUM_78 * upper_even + DIFFERENCE_32 * outer
    steep_odd = FULL * side2 + NEAR_FULL * side1 + DIFFERENCE_78 * upper_odd + SUM_32 * outer_odd
    across = FULL * (corners + top_odd + upper_odd + outer_odd + sides)
    along = FULL * (top_sum + c0 + upper_even + outer)
    magnitude, direction = abs(across), ZERO if across > ZERO else OPPOSITE
    magnitude, direction = _stronger(magnitude, direction, flat_even + flat_odd, ONE)
    magnitude, direction = _stronger(magnitude, direction, steep_even + steep_odd, np.float32(2))
    magnitude, direction = _stronger(magnitude, direction, along, np.float32(3))
    magnitude, direction = _stronger(magnitude, direction, steep_even - steep_odd, np.float32(4))
    magnitude, direction = _stronger(magnitude, direction, flat_even - flat_odd, np.float32(5))
    # Every pixel has a part in it, so that nodata anywhere under the masks shows.
    known = abs((across + along) + middle[2]) < INFINITY
    return (magnitude if known else np.float32(np.nan)), (direction if known and magnitude > ZERO else NONE)


@loop
def _respond_row(
    top: Floats, upper: Floats, middle: Floats, lower: Floats, bottom: Floats, magnitude: Floats, direction: Directions
) -> None:
    for j in range(magnitude.size):
        size, turned = edge_at(
            (top[j], top[j + 1], top[j + 2], top[j + 3], top[j + 4]),
            (upper[j], upper[j + 1], upper[j + 2], upper[j + 3], upper[j + 4]),
            (middle[j], middle[j + 1], middle[j + 2], middle[j + 3], middle[j + 4]),
            (lower[j], lower[j + 1], lower[j + 2], lower[j + 3], lower[j + 4]),
            (bottom[j], bottom[j + 1], bottom[j + 2], bottom[j + 3], bottom[j + 4]),
        )
        magnitude[j] = size
        direction[j] = np.uint8(turned)


@loop
def _respond(image: Floats, magnitude: Floats, direction: Directions) -> None:
    rows, columns = image.shape
    for i in range(rows):
        if i < 2 or i >= rows - 2 or columns < 5:
            magnitude[i] = np.nan
            direction[i] = NO_DIRECTION
            continue
        for j in (0, 1, columns - 2, columns - 1):
            magnitude[i, j], direction[i, j] = np.nan, NO_DIRECTION
        _respond_row(
            image[i - 2], image[i - 1], image[i], image[i + 1], image[i + 2], magnitude[i, 2:-2], direction[i, 2:-2]
        )


def edge_responses(block: NDArray[Any]) -> tuple[Floats, Directions]:
    """Strongest response of the six masks at each pixel, and its direction (Nevatia & Babu 1980, Section 2.1).

    Parameters
    ----------
    block
        Image (rows, columns) of real numbers; values that are not finite are nodata, and so is all outside the block.
        Arrays of a device stay there, and the results are the same bits.

    Returns
    -------
    magnitude
        float32, (rows, columns): largest absolute response, in grey levels times the weights of `MASKS`; see
        `STEP_RESPONSE`. NaN where nodata lies under the masks.
    direction
        uint8, (rows, columns): 0 … 11, the side that is brighter; of equal responses the mask of the lowest angle.
        `NO_DIRECTION` where the magnitude is zero or NaN.

    Raises
    ------
    ValueError
        If the block is not a two-dimensional array of real numbers.

    Examples
    --------
    A step of 50 grey levels between columns 3 and 4: the bright side lies to the right, direction 0.

    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.masks import edge_responses
    >>> image = np.tile(np.repeat([100, 150], 4), (7, 1))
    >>> magnitude, direction = edge_responses(image)
    >>> magnitude[3].tolist()
    [nan, nan, 25000.0, 50000.0, 50000.0, 25000.0, nan, nan]
    >>> direction[3].tolist()
    [255, 255, 0, 0, 0, 0, 255, 255]
    """
    image = as_block(block)
    if on_device(image):
        return device_form(__name__).respond(image)
    magnitude, direction = np.empty(image.shape, np.float32), np.empty(image.shape, np.uint8)
    _respond(image, magnitude, direction)
    return magnitude, direction
