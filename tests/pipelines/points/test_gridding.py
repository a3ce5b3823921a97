"""The gridding kernel against brute force, and its laws: order of points and tiling are invisible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.points import gridding as naive
from tilepipe_kernels.points import gridding, point_tiles

CASES = [(method, reach) for method in gridding.METHODS for reach in (0.0, 1.0, 2.75, 40.0)]


def cloud(seed: int, shape: tuple[int, int], count: int, coarse: int = 1):
    """Random points; ``coarse`` > 1 puts them on few positions, so that distances and positions tie."""
    random = np.random.default_rng(seed)
    rows = random.integers(0, shape[0] * point_tiles.SUBCELLS // coarse, count) * coarse
    columns = random.integers(0, shape[1] * point_tiles.SUBCELLS // coarse, count) * coarse
    return rows, columns, random.integers(-(2**31), 2**31, count).astype(np.int32)


def grid(points, shape, method, reach, radius, side=16, order=None):
    """The raster put together from tiles of ``side`` cells."""
    rows, columns, values = (a if order is None else a[order] for a in points)
    tiles = -(-shape[0] // side), -(-shape[1] // side)
    margin = gridding.halo(method, reach, radius)
    records, starts = point_tiles.sort_by_tile(
        rows, columns, values, origin=(0, 0), tiles=tiles, side=side, margin=margin
    )
    blocks = [
        gridding.grid_points(
            records[starts[t] : starts[t + 1]], (side, side), method=method, reach=reach, radius=radius
        )
        for t in range(tiles[0] * tiles[1])
    ]
    bands = [np.hstack(blocks[t * tiles[1] : (t + 1) * tiles[1]]) for t in range(tiles[0])]
    return np.vstack(bands)[: shape[0], : shape[1]]


@pytest.mark.parametrize(("method", "reach"), CASES)
@pytest.mark.parametrize(("count", "coarse"), [(12, 1), (60, 1), (60, 16384)])
def test_equals_brute_force(method: str, reach: float, count: int, coarse: int) -> None:
    shape = 9, 7
    points = cloud(count, shape, count, coarse)
    expected = naive.grid(*points, shape, method, reach, 1.25)
    result = grid(points, shape, method, reach, 1.25)
    if method == "idw":
        np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1.0)
    else:
        np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize(("method", "reach"), [case for case in CASES if case[1] < 40])
@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    count=st.sampled_from([0, 10, 40, 150, 700]),
    side=st.sampled_from([1, 4, 16]),
    coarse=st.sampled_from([1, 16384]),
)
def test_tiles_and_point_order_are_invisible(method, reach, seed, count, side, coarse) -> None:
    shape = 21, 26
    points = cloud(seed, shape, count, coarse)
    order = np.random.default_rng(seed).permutation(count)
    whole = grid(points, shape, method, reach, 1.75, side=32)
    np.testing.assert_array_equal(grid(points, shape, method, reach, 1.75, side=side, order=order), whole)


def test_equally_near_points_of_two_cells_tie_by_row_major_cell() -> None:
    """5² + 5² = 7² + 1²: a point in the cell and one in the row above, equally far from the centre."""
    offsets = 10_001 * np.array([[5, 5], [-7, 1]])
    centre = 3 * point_tiles.SUBCELLS // 2
    rows, columns = (centre + (offsets - 1) // 2).T
    for values in ([1, 2], [2, 1]):
        result = grid((rows, columns, np.array(values, np.int32)), (3, 3), "nearest", 0.0, 0.0)
        assert result[1, 1] == values[1]


def test_void_reach_is_inclusive_and_stops() -> None:
    half = point_tiles.SUBCELLS // 2
    points = (np.array([half]), np.array([half]), np.array([7], np.int32))
    for method in ("max", "min", "mean"):
        assert np.isfinite(grid(points, (1, 8), method, 3.0, 0.0)).sum() == 4
    # The point stands half a subcell east of the centre, so three cells on it is a little nearer than 3.
    assert np.isfinite(grid(points, (1, 8), "nearest", 3.0, 0.0)).sum() == 4
    assert np.isfinite(grid(points, (1, 8), "nearest", 2.9999, 0.0)).sum() == 3


def test_mean_of_great_values_is_exact() -> None:
    values = np.array([2**31 - 1, 2**31 - 1, -(2**31)], np.int32)
    points = (np.zeros(3, np.int64), np.zeros(3, np.int64), values)
    assert grid(points, (1, 1), "mean", 0.0, 0.0)[0, 0] == (2**31 - 2) / 3


def test_subcells_are_anchored_to_the_crs_origin() -> None:
    raw = np.array([0, 50, 99, 100, -1], np.int32)
    cells = point_tiles.subcells(raw, 0.01, 500000.0, 0.5) >> 16
    np.testing.assert_array_equal(cells - 1000000, [0, 1, 1, 2, -1])
    np.testing.assert_array_equal(point_tiles.subcells(raw, 0.01, 0.0, -0.5) >> 16, [0, -1, -2, -2, 0])


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"method": "median"}, "nearest, max"),
        ({"method": "max", "reach": np.inf}, "finite"),
        ({"method": "max", "reach": -1.0}, "reach"),
        ({"method": "idw"}, "radius"),
    ],
)
def test_bad_options_are_refused(options, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        gridding.grid_points(np.empty(0, point_tiles.POINT), (4, 4), **options)


def test_points_outside_the_tile_are_refused() -> None:
    points = np.zeros(1, point_tiles.POINT)
    points["row"] = 5
    with pytest.raises(ValueError, match="outside"):
        gridding.grid_points(points, (4, 4), method="max")
    with pytest.raises(ValueError, match="records"):
        gridding.grid_points(np.zeros(3), (4, 4), method="max")
