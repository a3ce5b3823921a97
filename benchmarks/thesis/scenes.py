"""Two drawn scenes whose edges are known, of the size and kind of the photographs in Barbosa (1994).

The photographs of the thesis are not to be had.  Its image 1 is well contrasted and shows a road that forks, its image
2 is of low contrast and shows a motorway junction among fields and houses; both are 190 × 150 pixels of 256 grey
levels.  The drawn scenes follow these words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 150, 190
SPACING = 0.25
"""Pixels between the points that stand for a true edge."""

MARGIN = 4
"""Pixels along the image's border in which nothing is scored: no method sees both sides of an edge there."""

_FINE = 8
_BLUR = 0.6
_TEXTURE_SIZE = 5.0

Points = NDArray[np.float64]
Grey = NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """An image and what is known of its edges.

    Attributes
    ----------
    key, title
        For file names, and for people.
    grey
        float32 (rows, columns), 0–255.
    roads, edges
        Borders of roads, and all edges of objects, these among them: each line as points (n, 2) `SPACING` apart,
        (row, column) with pixel corners at whole numbers.  Empty where the truth is unknown.
    """

    key: str
    title: str
    grey: Grey
    roads: Sequence[Points] = ()
    edges: Sequence[Points] = ()


@dataclass(frozen=True)
class Drawing:
    """Polygons (x rightward, y downward, pixels) with their grey, later ones above earlier ones.

    Attributes
    ----------
    ground
        Grey where nothing is painted.
    below, roads, above
        What the roads cover, the roads, and what stands on them.
    noise, texture
        Standard deviations of the white noise and of the smooth one, grey levels.
    """

    key: str
    title: str
    ground: float
    below: Sequence[tuple[Any, float]]
    roads: tuple[Any, float]
    above: Sequence[tuple[Any, float]]
    noise: float
    texture: float

    @property
    def painted(self) -> list[tuple[Any, float]]:
        """All polygons in the order of painting."""
        return [*self.below, self.roads, *self.above]


# ------------------------------------------------------------------------------------------------- drawings


def _road(points: Sequence[tuple[float, float]], width: float) -> Any:
    """A road of constant width along a smooth curve through points."""
    import shapely
    from scipy.interpolate import CubicSpline

    through = np.array(points, np.float64)
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(through, axis=0).T))])
    curve = CubicSpline(along, through)(np.linspace(0, along[-1], 200))
    return shapely.LineString(curve).buffer(width / 2, cap_style="flat", quad_segs=32)


def _box(x: float, y: float, wide: float, high: float, degrees: float = 0.0) -> Any:
    import shapely
    from shapely import affinity

    return affinity.rotate(shapely.box(x - wide / 2, y - high / 2, x + wide / 2, y + high / 2), degrees)


def _disc(x: float, y: float, radius: float) -> Any:
    import shapely

    return shapely.Point(x, y).buffer(radius, quad_segs=16)


def fork() -> Drawing:
    """A bright road that forks, on dark fields; a track, a farm and a few trees: after image 1."""
    import shapely

    trunk = _road([(-10, 118), (30, 104), (66, 90), (92, 80)], 11)
    upper = _road([(60, 92.5), (92, 80), (128, 56), (152, 26), (164, -12)], 10)
    lower = _road([(60, 92.5), (92, 80), (126, 82), (160, 98), (202, 128)], 9)
    fields = [
        (shapely.Polygon([(-5, -5), (84, -5), (52, 60), (-5, 76)]), 72.0),
        (shapely.Polygon([(150, 60), (200, 40), (200, 112), (172, 90)]), 104.0),
    ]
    farm = [(_box(112, 118, 18, 10, 20), 168.0), (_box(126, 130, 8, 8, 20), 150.0)]
    trees = [(_disc(x, y, r), 48.0) for x, y, r in ((88, 30, 6), (97, 38, 4.5), (30, 138, 5), (178, 20, 6.5))]
    return Drawing(
        key="fork",
        title="scene 1, a forking road of high contrast",
        ground=90.0,
        below=[*fields, *farm, *trees],
        roads=(shapely.union_all([trunk, upper, lower]), 195.0),
        above=[(_box(110, 68.3, 4, 2.2, -34), 60.0)],
        noise=7.0,
        texture=4.0,
    )


def junction() -> Drawing:
    """A grey motorway with ramps and a road across it, among fields, houses and trees: after image 2."""
    import shapely

    motorway = [_road([(-10, 84 + d), (50, 74 + d), (110, 66 + d), (200, 62 + d)], 8) for d in (-6.5, 6.5)]
    across = _road([(78, -10), (92, 40), (102, 80), (104, 160)], 7)
    ramps = [
        _road([(20, 71.5), (52, 62), (78, 40), (84, 12)], 5),
        _road([(105, 117), (118, 92), (150, 76), (186, 69.5)], 5),
        _road([(99.5, 62), (120, 50), (138, 36), (130, 20), (112, 22), (98, 44)], 5),
    ]
    fields = [
        (shapely.Polygon([(-5, -5), (60, -5), (40, 44), (-5, 56)]), 118.0),
        (shapely.Polygon([(-5, 104), (60, 94), (76, 160), (-5, 160)]), 84.0),
        (shapely.Polygon([(140, 100), (200, 88), (200, 160), (150, 160)]), 112.0),
        (shapely.Polygon([(150, -5), (200, -5), (200, 34), (160, 40)]), 132.0),
    ]
    houses = [
        (_box(x, y, 9, 7, a), grey)
        for x, y, a, grey in (
            (18, 20, 15, 165.0), (34, 14, 15, 158.0), (14, 36, 15, 70.0), (30, 30, 15, 172.0), (124, 128, -8, 160.0),
            (126, 142, -8, 72.0), (84, 132, 5, 164.0), (172, 14, 30, 75.0), (178, 120, 0, 168.0), (164, 136, 0, 66.0),
        )
    ]  # fmt: skip
    trees = [
        (_disc(x, y, r), 68.0)
        for x, y, r in (
            (56, 22, 4), (62, 30, 3), (60, 116, 5), (42, 130, 4), (30, 118, 3), (186, 46, 4.5), (150, 52, 3.5),
            (138, 118, 4), (112, 108, 3), (118, 34, 3),
        )
    ]  # fmt: skip
    cars = [
        (_box(x, y, 4, 2, a), grey)
        for x, y, a, grey in ((30, 70.5, -9, 180.0), (70, 78, -7, 60.0), (128, 58.5, -3, 185.0), (160, 70, -2, 62.0))
    ]
    return Drawing(
        key="junction",
        title="scene 2, a motorway junction of low contrast",
        ground=100.0,
        below=[*fields, *houses, *trees],
        roads=(shapely.union_all([*motorway, across, *ramps]), 138.0),
        above=cars,
        noise=6.0,
        texture=4.0,
    )


DRAWINGS = (fork, junction)


# ------------------------------------------------------------------------------------------------- truth and image


def _sampled(lines: Any) -> list[Points]:
    """Points along lines within the part of the image that is scored."""
    import shapely

    window = shapely.box(MARGIN, MARGIN, COLUMNS - MARGIN, ROWS - MARGIN)
    merged = shapely.line_merge(shapely.unary_union(shapely.intersection(lines, window)))
    parts = shapely.get_parts(merged)
    parts = parts[shapely.length(parts) > 0]
    return [_points_along(part) for part in parts]


def _points_along(line: Any) -> Points:
    import shapely

    count = max(2, round(line.length / SPACING))
    middles = (np.arange(count) + 0.5) * line.length / count
    return np.ascontiguousarray(shapely.get_coordinates(shapely.line_interpolate_point(line, middles))[:, ::-1])


def visible_outlines(polygons: Sequence[Any]) -> Any:
    """Outlines of polygons, as far as no later one covers them."""
    import shapely

    outlines = []
    for place, polygon in enumerate(polygons):
        cover = shapely.union_all(list(polygons[place + 1 :]))
        outlines.append(shapely.difference(shapely.boundary(polygon), cover))
    return shapely.union_all(outlines)


def _painted(drawing: Drawing) -> NDArray[np.float64]:
    """The drawing without noise: mean grey of each pixel, slightly blurred."""
    from rasterio.features import rasterize
    from scipy.ndimage import gaussian_filter
    from shapely import affinity

    enlarged = ((affinity.scale(polygon, _FINE, _FINE, origin=(0, 0)), grey) for polygon, grey in drawing.painted)
    fine = rasterize(enlarged, (ROWS * _FINE, COLUMNS * _FINE), fill=drawing.ground, dtype="float64")
    mean = fine.reshape(ROWS, _FINE, COLUMNS, _FINE).mean(axis=(1, 3))
    return np.asarray(gaussian_filter(mean, _BLUR))


def render(drawing: Drawing, seed: int = 0) -> Scene:
    """The image of a drawing under one draw of the noise, in whole grey levels, with its true edges.

    Parameters
    ----------
    drawing
        For example `fork()`.
    seed
        Of the noise and the texture.
    """
    import shapely
    from scipy.ndimage import gaussian_filter

    generator = np.random.default_rng([seed, len(drawing.key)])
    texture = gaussian_filter(generator.standard_normal((ROWS, COLUMNS)), _TEXTURE_SIZE)
    grey = _painted(drawing) + drawing.texture * texture / texture.std()
    grey += drawing.noise * generator.standard_normal(grey.shape)
    roads = shapely.boundary(drawing.roads[0])
    edges = visible_outlines([polygon for polygon, _ in drawing.painted])
    whole = np.clip(np.rint(grey), 0, 255).astype(np.float32)
    return Scene(drawing.key, drawing.title, whole, _sampled(roads), _sampled(edges))
