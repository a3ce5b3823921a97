"""The true map of a city as vectors, from the functions that define it and not from pixels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.synthetic.city import City, layout_of
from tilepipe_kernels.city.blocks import blocks_near, populate
from tilepipe_kernels.city.chart import (
    BOULEVARD_U,
    BOULEVARD_V,
    DEAD_END_WIDTH,
    SPACING,
    block_levels,
    dead_end,
    has_dead_end,
    positions,
    street_level,
    street_width,
)
from tilepipe_kernels.city.layout import Layout
from tilepipe_kernels.city.objects import ROOFS

if TYPE_CHECKING:
    import geopandas as gpd

#: Distance of the vertices of a centerline in metres of its coordinate, and of a vertex from a junction at
#: least.
VERTEX_SPACING, JUNCTION_CLEARANCE = 2.0, 0.3
#: Blocks whose buildings are held as objects at a time.
BLOCKS_AT_ONCE = 512
STRIDE_METRES = 16.0

Curve = tuple[str, float, NDArray[np.float64]]


def truth_centerlines(city: City) -> gpd.GeoDataFrame:
    """The centerlines of all streets, also where trees, cars or voids hide them.

    A street is one line from border to border of the city; where it leaves the city and comes back, several.
    Vertices lie on the street's level set to within 1e-9 m, about every 2 m, and streets that cross share a
    vertex exactly.

    Parameters
    ----------
    city
        The city.

    Returns
    -------
    geopandas.GeoDataFrame
        Columns ``street`` (number), ``family`` (street, cross street, boulevard or dead end), ``width`` (m)
        and ``geometry`` (LineString in the city's coordinate reference system).

    Examples
    --------
    >>> from tilepipe.synthetic import City
    >>> from tilepipe.synthetic.truth import truth_centerlines
    >>> streets = truth_centerlines(City(rows=512, columns=512))
    >>> streets.columns.tolist(), streets.crs.to_epsg(), bool(streets.length.sum() > 500)
    (['street', 'family', 'width', 'geometry'], 32633, True)
    """
    import geopandas as gpd
    import shapely

    layout, box = layout_of(city), shapely.box(*city.bounds)
    rows: list[tuple[int, str, float, Any]] = []
    for family, width, coordinates in _curves(layout):
        places = positions(layout, coordinates)
        line = shapely.linestrings(np.column_stack([city.west + places[:, 0], city.north - places[:, 1]]))
        parts = shapely.get_parts(shapely.intersection(line, box))
        parts = [part for part in parts if part.geom_type == "LineString" and part.length > 0]
        number = rows[-1][0] + 1 if rows else 1
        rows += [(number, family, width, part) for part in parts]
    return gpd.GeoDataFrame(
        {
            "street": np.array([row[0] for row in rows], np.int64),
            "family": [row[1] for row in rows],
            "width": np.array([row[2] for row in rows], np.float64),
        },
        geometry=[row[3] for row in rows],
        crs=city.crs,
    )


def _curves(layout: Layout) -> Iterator[Curve]:
    """Family, width and coordinates (n, 2) of every centerline that may meet the city."""
    i = np.arange(layout.first_block, layout.first_block + layout.blocks_along)
    j = np.arange(layout.first_block_across, layout.first_block_across + layout.blocks_across)
    levels_u = np.array([street_level(layout, 0, int(n)) for n in i])
    levels_v = np.array([street_level(layout, 1, int(n)) for n in j])
    corners = [BOULEVARD_U * u + BOULEVARD_V * v for u in levels_u[[0, -1]] for v in levels_v[[0, -1]]]
    k = range(int(min(corners) // SPACING[2]) - 1, int(max(corners) // SPACING[2]) + 2)
    levels_w = np.array([street_level(layout, 2, n) for n in k])
    stubs = {(a, b): _dead_end(layout, a, b) for a in i.tolist() for b in j.tolist() if has_dead_end(layout, a, b)}
    for n, u in zip(i.tolist(), levels_u, strict=True):
        junctions = np.concatenate([levels_v, (levels_w - BOULEVARD_U * u) / BOULEVARD_V])
        along = _with_vertices(junctions, levels_v[0], levels_v[-1])
        yield "street", street_width(layout, 0, n), np.column_stack([np.full_like(along, u), along])
    for n, v in zip(j.tolist(), levels_v, strict=True):
        starts = [stub[0, 0] for (_, b), stub in stubs.items() if b == n]
        junctions = np.concatenate([levels_u, (levels_w - BOULEVARD_V * v) / BOULEVARD_U, starts])
        along = _with_vertices(junctions, levels_u[0], levels_u[-1])
        yield "cross street", street_width(layout, 1, n), np.column_stack([along, np.full_like(along, v)])
    for n, w in zip(k, levels_w, strict=True):
        yield "boulevard", street_width(layout, 2, n), _boulevard(w, levels_u, levels_v)
    for stub in stubs.values():
        yield "dead end", DEAD_END_WIDTH, stub


def _with_vertices(junctions: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """Coordinates of the junctions and, between them, of regular vertices."""
    junctions = np.unique(junctions[(junctions >= low) & (junctions <= high)])
    regular = np.arange(np.ceil(low / VERTEX_SPACING), np.floor(high / VERTEX_SPACING) + 1) * VERTEX_SPACING
    after = np.searchsorted(junctions, regular)
    gap = np.minimum(
        np.abs(regular - junctions[np.maximum(after - 1, 0)]),
        np.abs(regular - junctions[np.minimum(after, len(junctions) - 1)]),
    )
    return np.union1d(junctions, regular[gap > JUNCTION_CLEARANCE])


def _boulevard(w: float, levels_u: NDArray[np.float64], levels_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates (n, 2) along a boulevard; its junctions have the very coordinates that the streets have."""
    crossings = np.concatenate(
        [
            np.column_stack([levels_u, (w - BOULEVARD_U * levels_u) / BOULEVARD_V]),
            np.column_stack([(w - BOULEVARD_V * levels_v) / BOULEVARD_U, levels_v]),
        ]
    )
    places = crossings @ (-BOULEVARD_V, BOULEVARD_U)
    along = _with_vertices(places, places.min(), places.max())
    along = np.setdiff1d(along, places)
    between = np.column_stack([BOULEVARD_U * w - BOULEVARD_V * along, BOULEVARD_V * w + BOULEVARD_U * along])
    order = np.argsort(np.concatenate([places, along]), kind="stable")
    return np.concatenate([crossings, between])[order]


def _dead_end(layout: Layout, i: int, j: int) -> NDArray[np.float64]:
    """Coordinates (n, 2) of a block's dead end from its junction to its end."""
    low_u, high_u, low_v, high_v = block_levels(layout, i, j)
    middle, end = dead_end(low_u, high_u, low_v, high_v)
    along = _with_vertices(np.array([low_v, end]), low_v, end)
    return np.column_stack([np.full_like(along, middle), along])


def truth_buildings(city: City) -> gpd.GeoDataFrame:
    """The footprints of all buildings, clipped to the city.

    Parameters
    ----------
    city
        The city.

    Returns
    -------
    geopandas.GeoDataFrame
        Columns ``building`` (the id in layer ``buildings``), ``roof`` (flat, gabled or hipped), ``height``
        (of the ridge above the foot, m) and ``geometry`` (Polygon), sorted by id.

    Examples
    --------
    >>> from tilepipe.synthetic import City
    >>> from tilepipe.synthetic.truth import truth_buildings
    >>> buildings = truth_buildings(City(rows=512, columns=512))
    >>> set(buildings["roof"]) <= {"flat", "gabled", "hipped"}, bool(buildings.is_valid.all())
    (True, True)
    """
    import geopandas as gpd
    import shapely

    layout = layout_of(city)
    blocks = blocks_near(layout, 0, 0, city.rows, city.columns, max(1, int(STRIDE_METRES / city.resolution)))
    chunks = range(0, len(blocks), BLOCKS_AT_ONCE)
    found = [populate(layout, blocks[n : n + BLOCKS_AT_ONCE], True).copy() for n in chunks]
    objects = np.concatenate(found)
    outlines, box = shapely.polygons(_corners(city, objects)), shapely.box(*city.bounds)
    shapely.prepare(box)
    crossing = ~shapely.contains_properly(box, outlines)
    outlines[crossing] = shapely.intersection(outlines[crossing], box)
    kept = shapely.area(outlines) > 0
    kept[kept] = shapely.get_type_id(outlines[kept]) == shapely.GeometryType.POLYGON
    objects, outlines = objects[kept], outlines[kept]
    order = np.argsort(objects["building"])
    return gpd.GeoDataFrame(
        {
            "building": objects["building"][order],
            "roof": np.array(ROOFS)[objects["kind"][order]],
            "height": (objects["eaves"] + objects["rise"])[order],
        },
        geometry=outlines[order],
        crs=city.crs,
    )


def _corners(city: City, objects: NDArray[Any]) -> NDArray[np.float64]:
    """Corners (n, 4, 2) of rectangles in the coordinate reference system, counter-clockwise."""
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)], np.float64)
    along = signs[:, 0] * objects["half_length"][:, None]
    across = signs[:, 1] * objects["half_width"][:, None]
    cos, sin = objects["cos"][:, None], objects["sin"][:, None]
    x = objects["x"][:, None] + along * cos - across * sin
    y = objects["y"][:, None] + along * sin + across * cos
    return np.stack([city.west + x, city.north - y], axis=-1)
