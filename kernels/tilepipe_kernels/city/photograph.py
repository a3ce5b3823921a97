"""The aerial photograph of a scene: colours, sunlight, cast shadows, blur and noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.city.objects import CAR, FLAT, TALLEST, TREE
from tilepipe_kernels.city.scene import Scene
from tilepipe_kernels.core.compiled import loop, rule

#: Direction to the sun: its height above the horizon and its azimuth, clockwise from north, in degrees.
SUN_HEIGHT, SUN_AZIMUTH = 52.0, 152.0
AMBIENT = np.float32(0.42)
STEEPEST_SHADED = np.float32(1.2)
GRAIN = np.float32(3.0)
SHADOW_BIAS = np.float32(0.15)
ZERO, HALF, ONE, TWO, LARGEST = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2), np.float32(255)

#: Red, green and blue of grass, meadow, concrete, pavement, street and marking in full sun, and the gain of
#: texture.
GROUND_COLOURS = np.array(
    [[112, 124, 78], [104, 126, 66], [150, 146, 138], [166, 162, 154], [98, 98, 102], [205, 205, 198]],
    np.float32,
)
GROUND_GAIN = np.array([0.16, 0.2, 0.07, 0.05, 0.05, 0.03], np.float32)
PITCHED_COLOURS = np.array(
    [[176, 98, 74], [158, 82, 62], [136, 76, 62], [104, 106, 116], [188, 120, 88], [120, 100, 88]], np.float32
)
FLAT_COLOURS = np.array([[128, 126, 124], [168, 166, 162], [206, 204, 200], [110, 110, 112]], np.float32)
TREE_COLOURS = np.array([[62, 88, 44], [74, 98, 48], [84, 100, 56], [56, 78, 46]], np.float32)
CAR_COLOURS = np.array([[228, 228, 230], [40, 42, 46], [168, 172, 178], [168, 44, 40], [52, 76, 130]], np.float32)


def sun() -> tuple[float, float, float]:
    """Unit vector to the sun: right, down, up.

    Examples
    --------
    >>> import math
    >>> from tilepipe_kernels.city.photograph import sun
    >>> round(math.hypot(*sun()), 6), sun()[2] > 0  # a unit vector that points up
    (1.0, True)
    """
    height, azimuth = math.radians(SUN_HEIGHT), math.radians(SUN_AZIMUTH)
    return math.cos(height) * math.sin(azimuth), -math.cos(height) * math.cos(azimuth), math.sin(height)


def shadow_steps(resolution: float) -> int:
    """Pixels towards the sun, along its longer component, beyond which nothing casts a shadow."""
    right, down, up = sun()
    return math.ceil((TALLEST + 6.0) / up * max(abs(right), abs(down)) / resolution)


def margin(resolution: float) -> int:
    """Pixels around a window that its photograph needs: the longest shadow and the blur."""
    return shadow_steps(resolution) + 2


def photograph(
    resolution: float,
    found: Scene,
    surface: NDArray[np.float32],
    fine: NDArray[np.float32],
    coarse: NDArray[np.float32],
    noise: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """The photograph of a scene without its margin.

    Parameters
    ----------
    resolution
        Size of a pixel in metres.
    found, surface, fine, coarse
        Scene, heights in metres and textures of the window with ``margin`` around it, shape (rows, columns).
    noise
        White noise of the window without margin.

    Returns
    -------
    ndarray
        uint8, shape (3, rows - 2 margin, columns - 2 margin).
    """
    light = sunlight(surface, resolution, shadow_steps(resolution), sun())
    colours = coloured(found.ground, found.visible, object_colours(found), fine, coarse, light)
    return exposed(colours, noise, margin(resolution))


def object_colours(found: Scene) -> NDArray[np.float32]:
    """Colour (n, 3) of each object in full sun."""
    kind, hue, tone = found.objects["kind"], found.objects["hue"], found.objects["tone"]
    result = np.zeros((len(kind), 3), np.float32)
    roof = (kind != TREE) & (kind != CAR) & (kind != FLAT)
    for chosen, palette, swing in (
        (roof, PITCHED_COLOURS, 0.25),
        (kind == FLAT, FLAT_COLOURS, 0.2),
        (kind == TREE, TREE_COLOURS, 0.35),
        (kind == CAR, CAR_COLOURS, 0.2),
    ):
        picked = palette[(hue[chosen] * len(palette)).astype(int)]
        result[chosen] = picked * (1 + swing * (tone[chosen] - 0.5))[:, None].astype(np.float32)
    return result


@rule
def gentler(before: np.float32, after: np.float32) -> np.float32:
    """The smaller of two slopes if their signs agree, else 0, so that a wall does not tilt the roof."""
    slope = min(abs(before), abs(after))
    slope = min(slope, STEEPEST_SHADED)
    return ZERO if before * after <= ZERO else slope if before > ZERO else -slope


@loop
def sunlight(
    surface: NDArray[np.float32], resolution: float, steps: int, towards: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Light on each pixel: ambient, and unless a surface within ``steps`` pixels hides the sun, its cosine.

    Level ground in the sun has 1.  The outermost pixels of the window miss their neighbours.
    """
    rows, columns = surface.shape
    result = np.empty((rows, columns), np.float32)
    right, down, up = np.float32(towards[0]), np.float32(towards[1]), np.float32(towards[2])
    longer = max(abs(towards[0]), abs(towards[1]))
    rise = towards[2] / longer * resolution
    per_metre = np.float32(1.0 / resolution)
    horizon = np.empty(columns, np.float32)
    for r in range(rows):
        horizon[:] = np.float32(-1e9)
        for step in range(1, steps + 1):
            row = r + int(round(step * towards[1] / longer))
            shift = int(round(step * towards[0] / longer))
            if row < 0 or row >= rows:
                continue
            fall = np.float32(step * rise)
            line = surface[row]
            for c in range(max(0, -shift), min(columns, columns - shift)):
                horizon[c] = max(horizon[c], line[c + shift] - fall)
        above, here, below = surface[max(r - 1, 0)], surface[r], surface[min(r + 1, rows - 1)]
        for c in range(columns):
            left, beyond = here[max(c - 1, 0)], here[min(c + 1, columns - 1)]
            slope_x = gentler(here[c] - left, beyond - here[c]) * per_metre
            slope_y = gentler(here[c] - above[c], below[c] - here[c]) * per_metre
            cosine = (up - right * slope_x - down * slope_y) / math.sqrt(ONE + slope_x * slope_x + slope_y * slope_y)
            shade = max(cosine, ZERO) / up if horizon[c] < here[c] + SHADOW_BIAS else ZERO
            result[r, c] = AMBIENT + (ONE - AMBIENT) * shade
    return result


@loop
def coloured(
    ground: NDArray[np.uint8], visible: NDArray[np.int32], colours: NDArray[np.float32],
    fine: NDArray[np.float32], coarse: NDArray[np.float32], light: NDArray[np.float32],
) -> NDArray[np.float32]:  # fmt: skip
    """Colour (3, rows, columns) of what is seen, with its texture, in its light."""
    rows, columns = ground.shape
    result = np.empty((3, rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            item, kind = visible[r, c], ground[r, c]
            gain = np.float32(0.05) if item >= 0 else GROUND_GAIN[kind]
            factor = light[r, c] * (ONE + gain * (fine[r, c] + coarse[r, c]))
            for band in range(3):
                colour = colours[item, band] if item >= 0 else GROUND_COLOURS[kind, band]
                result[band, r, c] = colour * factor
    return result


@loop
def exposed(colours: NDArray[np.float32], noise: NDArray[np.float32], border: int) -> NDArray[np.uint8]:
    """Blur by the 3x3 binomial, add grain and round, without the border."""
    bands, rows, columns = colours.shape[0], noise.shape[0], noise.shape[1]
    result = np.empty((bands, rows, columns), np.uint8)
    sixteenth = np.float32(1 / 16)
    for band in range(bands):
        for r in range(rows):
            above, here = colours[band, r + border - 1], colours[band, r + border]
            below = colours[band, r + border + 1]
            for c in range(columns):
                p, q, s = c + border - 1, c + border, c + border + 1
                left, middle = above[p] + TWO * here[p] + below[p], above[q] + TWO * here[q] + below[q]
                blurred = (left + TWO * middle + above[s] + TWO * here[s] + below[s]) * sixteenth
                value = blurred + GRAIN * noise[r, c] + HALF
                result[band, r, c] = np.uint8(min(max(value, ZERO), LARGEST))
    return result
