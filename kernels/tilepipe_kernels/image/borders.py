"""The borders of streets put back: pixels beside a mask whose grey is that of the street and not that of its side.

Diffusion keeps an edge because it stops there, so the noise stays there too, and regions that grow by small
differences leave noisy pixels out.  Each of them is told by the two levels that lie beside it, which noise does not
shift: the nearer one is the likelier under noise of any symmetric distribution that falls off, such as the normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.image.grey_levels import NO_GREY, STEPS
from tilepipe_kernels.image.morphology import dilate_mask

SIDE, BORDER, STREET = (np.uint8(value) for value in (1, 2, 3))
"""What a pixel with a grey level may be; 0 is none of them."""

_APART = 2.0
"""Two normal distributions of the same deviation show as two only when they are more than two deviations apart
(Behboodian 1970, "On the modes of a mixture of two normal distributions", Technometrics 12)."""


def halo(reach: int) -> int:
    """Pixels around a block that `with_borders` can depend on: growth, window, and what the window's pixels are.

    Examples
    --------
    >>> from tilepipe_kernels.image.borders import halo
    >>> halo(4)
    16
    """
    return reach + window(reach) + reach


def window(reach: int) -> int:
    """Half the side of the window of the two levels: as far beyond the border as the border reaches."""
    return 2 * reach


@rule
def street_level(
    grey: np.int64, street: np.int64, streets: np.int64, side: np.int64, sides: np.int64, apart: float
) -> float:
    """Level of the street where a pixel is nearer to it than to the side's, else -1; levels as sums and counts."""
    if streets == 0 or sides == 0:
        return -1.0
    inside, outside = street / streets, side / sides
    if not abs(outside - inside) > apart:
        return -1.0
    return inside if abs(grey - inside) < abs(grey - outside) else -1.0


@loop
def _levels(
    kind: NDArray[np.uint8], packed: NDArray[np.uint16], half: int, apart: float, levels: NDArray[np.float32]
) -> None:
    rows, columns = kind.shape
    for i in range(rows):
        for j in range(columns):
            if kind[i, j] != BORDER:
                continue
            # whole steps, whose sums do not depend on an order
            street, streets, side, sides = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
            for y in range(max(0, i - half), min(rows, i + half + 1)):
                for x in range(max(0, j - half), min(columns, j + half + 1)):
                    if kind[y, x] == STREET:
                        street, streets = street + (np.int64(packed[y, x]) >> 1), streets + 1
                    elif kind[y, x] == SIDE:
                        side, sides = side + (np.int64(packed[y, x]) >> 1), sides + 1
            grey = np.int64(packed[i, j]) >> 1
            levels[i, j] = street_level(grey, street, streets, side, sides, apart)


def with_borders(
    mask: NDArray[np.bool_],
    image: NDArray[np.float32],
    ids: NDArray[np.uint32],
    packed: NDArray[np.uint16],
    *,
    dark: float,
    bright: float,
    reach: int,
    noise: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Streets with the pixels beside them that are street by their grey, as mask and as grey image.

    A pixel is, when a path of such pixels joins it to the mask and its grey is nearer to the mean of the street than
    to the mean of what lies beyond ``reach``, both within a window, and these two are told apart in spite of the noise.

    Parameters
    ----------
    mask, image
        Street mask, bool, and its grey image (see `street_image`), float32, shape (rows, columns).
    ids, packed
        Region ids (0 = none) and stored grey levels (see `store`), same shape; of the mask only what belongs to a
        region counts as grey of the street.
    dark, bright
        Mean grey levels of the two classes, between which the levels of the image lie.
    reach
        Pixels that a border may be off the mask, 1 or more.
    noise
        Standard deviation of the noise in grey levels.

    Returns
    -------
    mask, image
        With the borders; they have the mean grey of the street beside them.

    Raises
    ------
    ValueError
        For a reach below 1.

    Examples
    --------
    Of a street of four rows, noise has left one out of the mask.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.borders import with_borders
    >>> from tilepipe_kernels.image.grey_levels import store
    >>> grey = np.full((9, 20), 150, np.float32)
    >>> grey[2:6] = 50
    >>> grey[2] = 62
    >>> mask = np.zeros(grey.shape, bool)
    >>> mask[3:6] = True
    >>> packed = store(grey, missing=np.zeros(grey.shape, bool))
    >>> levels = {"dark": 40, "bright": 150}
    >>> street, image = with_borders(mask, grey, mask.astype(np.uint32), packed, **levels, reach=2, noise=10)
    >>> street[:, 0].nonzero()[0].tolist(), image[:4, 0].tolist()
    ([2, 3, 4, 5], [150.0, 150.0, 50.0, 50.0])
    """
    if reach < 1:
        raise ValueError(f"reach must be 1 pixel or more, not {reach}")
    xp = namespace(mask, image, ids, packed)
    kind = xp.full(mask.shape, SIDE, xp.uint8)
    kind[dilate_mask(mask, reach)] = BORDER
    kind[mask] = 0
    kind[mask & (ids > 0)] = STREET
    kind[packed >= NO_GREY] = 0
    levels = xp.full(mask.shape, -1, xp.float32)
    apart, half = _APART * noise * STEPS, window(reach)
    if on_device(kind):
        device_form(__name__).levels(kind, packed, half, apart, levels)
    else:
        _levels(kind, packed, half, apart, levels)
    street = mask.copy()
    for _ in range(reach):
        street |= _beside(street) & (levels >= 0)
    levels = xp.clip(levels * np.float32(1 / STEPS), np.float32(dark), np.float32(bright))
    return street, xp.where(street & ~mask, levels, image)


def _beside(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels that share a side with one of the mask."""
    beside = namespace(mask).zeros_like(mask)
    beside[1:] |= mask[:-1]
    beside[:-1] |= mask[1:]
    beside[:, 1:] |= mask[:, :-1]
    beside[:, :-1] |= mask[:, 1:]
    return beside
