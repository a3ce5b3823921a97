"""Polygons of label images: exact, valid, a coverage, and the same for any tiling."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.features import rasterize
from scipy.ndimage import gaussian_filter
from scipy.ndimage import label as components

from tests.kernels.polylines.test_arcs import drawing, label_images, tiled_fragments
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe_kernels.polylines.arcs import trace_arcs
from tilepipe_kernels.polylines.join import Arcs, join_arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons
from tilepipe_kernels.polylines.simplify import simplify_polylines

IDENTITY = (1, 0, 0, 0, 1, 0)


def arcs_of(labels: np.ndarray) -> Arcs:
    return join_arcs([trace_arcs(labels)])


def polygons_of(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    arcs = arcs_of(labels)
    return region_polygons(assemble_polygons(arcs), arcs, IDENTITY)


def check_exact(labels: np.ndarray) -> None:
    ids, geometries = polygons_of(labels)
    present, count = np.unique(labels[labels != 0], return_counts=True)
    assert np.array_equal(ids, present)
    assert np.array_equal(shapely.area(geometries), count)
    assert shapely.is_valid(geometries).all() and shapely.coverage_is_valid(geometries)
    parts = [components(labels == one)[1] for one in present]
    assert np.array_equal(shapely.get_num_geometries(geometries), parts)
    if ids.size:
        back = rasterize(zip(geometries, ids.tolist(), strict=True), labels.shape, dtype=np.int32)
        assert np.array_equal(back, labels)


@settings(max_examples=200, deadline=None)
@given(label_images())
def test_polygons_are_the_regions_exactly(labels: np.ndarray) -> None:
    check_exact(labels)


@pytest.mark.parametrize(
    ("picture", "parts", "holes"),
    [
        ("AAAAA ABBBA ABABA ABBBA AAAAA", 2, 1),  # a part within its own hole
        ("AAAAAAA ABBBBBA ABAAABA ABA.ABA ABAAABA ABBBBBA AAAAAAA", 2, 2),  # and a hole within that part
        ("AA. A.A AAA", 1, 1),  # a hole that touches the outside
        ("AAAA A.AA AA.A AAAA", 1, 2),  # two holes that touch
        ("A. .A", 2, 0),  # a saddle
        ("AAAAA A.A.A AAAAA BBBBB AAAAA AA.AA AAAAA", 2, 3),  # holes side by side, two parts
    ],
)
def test_parts_and_holes(picture: str, parts: int, holes: int) -> None:
    labels = drawing(picture)
    check_exact(labels)
    shape = polygons_of(labels)[1][0]
    assert shapely.get_num_geometries(shape) == parts
    assert sum(len(part.interiors) for part in getattr(shape, "geoms", [shape])) == holes


def test_shells_are_counter_clockwise_with_north_up_and_borders_are_shared() -> None:
    arcs = arcs_of(drawing("AAA A.B AAA"))
    _, geometries = region_polygons(assemble_polygons(arcs), arcs, (0.5, 0, 100, 0, -0.5, 200))
    assert [shape.exterior.is_ccw for shape in geometries] == [True, True]
    assert geometries[1].equals(shapely.box(101, 199, 101.5, 199.5))
    assert set(geometries[1].exterior.coords) <= {*geometries[0].exterior.coords, (101.5, 199.0), (101.5, 199.5)} | {
        point for ring in geometries[0].interiors for point in ring.coords
    }


@settings(max_examples=50, deadline=None)
@given(label_images(), st.integers(1, 6), st.integers(1, 6))
def test_tiling_does_not_show(labels: np.ndarray, rows: int, columns: int) -> None:
    tiled = join_arcs(tiled_fragments(labels, (rows, columns)))
    ids, geometries = region_polygons(assemble_polygons(tiled), tiled, IDENTITY)
    expected_ids, expected = polygons_of(labels)
    assert np.array_equal(ids, expected_ids)
    assert shapely.to_wkb(geometries).tolist() == shapely.to_wkb(expected).tolist()


def test_arcs_of_a_part_of_the_raster_are_refused() -> None:
    arcs = arcs_of(drawing("AB CD"))
    part = Arcs(arcs.offsets[:-1], arcs.vertices[: arcs.offsets[-2]], arcs.left[:-1], arcs.right[:-1])
    with pytest.raises(ValueError, match="do not close"):
        assemble_polygons(part)


def test_simplified_arcs_are_refused() -> None:
    with pytest.raises(ValueError, match="simplify them afterwards"):
        assemble_polygons(simplify_polylines(arcs_of(np.tri(5, dtype=np.int32)), 1))


# ------------------------------------------------------------------------------------------- simplification


def blobs(seed: int, size: int, regions: int) -> np.ndarray:
    """Voronoi cells with ragged borders, islands and gaps."""
    random = np.random.default_rng(seed)
    seeds = random.random((regions, 2)) * size
    row, column = np.mgrid[:size, :size]
    jitter = random.normal(0, 1.0, (2, size, size))
    distance = np.hypot(*(np.stack([row, column])[:, None] + jitter[:, None] - seeds.T[:, :, None, None]))
    labels = distance.argmin(0).astype(np.int32)
    labels[random.random(labels.shape) < 0.02] = regions
    return labels


def check_simplified(labels: np.ndarray, tolerance: float) -> tuple[Arcs, Arcs]:
    arcs = arcs_of(labels)
    rings = assemble_polygons(arcs)
    simple = simplify_polylines(arcs, tolerance)
    _, geometries = region_polygons(rings, simple, IDENTITY)
    assert shapely.is_valid(geometries).all() and shapely.coverage_is_valid(geometries)
    assert (shapely.area(geometries) > 0).all()
    for end in (simple.offsets[:-1], simple.offsets[1:] - 1):
        before = arcs.offsets[:-1] if end[0] == 0 else arcs.offsets[1:] - 1
        assert np.array_equal(simple.vertices[end], arcs.vertices[before])
    _, bounds = rings.coordinates(simple, IDENTITY)
    assert np.diff(bounds).min() >= 4
    return arcs, simple


@settings(max_examples=100, deadline=None)
@given(label_images(), st.sampled_from([0.5, 0.75, 1.5, 4.0]))
def test_simplified_polygons_are_a_valid_coverage_with_the_same_junctions(labels: np.ndarray, tolerance: float) -> None:
    if labels.any():
        check_simplified(labels, tolerance)


@pytest.mark.parametrize("tolerance", [0.75, 2.0, 5.0])
def test_ragged_cells_with_islands_stay_a_coverage(tolerance: float) -> None:
    for seed in range(3):
        arcs, simple = check_simplified(blobs(seed, 60, 8), tolerance)
        assert len(simple.vertices) < 0.9 * len(arcs.vertices)


def terraces(seed: int, size: int, levels: int) -> np.ndarray:
    field = gaussian_filter(np.random.default_rng(seed).random((size, size)), 0.6)
    return np.digitize(field, np.quantile(field, np.linspace(0, 1, levels)[1:-1])).astype(np.int32)


@pytest.mark.parametrize("tolerance", [1.0, 8.0])
def test_holes_that_hang_on_a_corner_stay_inside(tolerance: float) -> None:
    for seed in range(12):
        check_simplified(terraces(seed, 60, 3 + seed % 3), tolerance)


def test_stairs_become_a_line_and_right_angles_stay() -> None:
    size = 12
    stairs = arcs_of(np.tri(size, dtype=np.int32) + 1)
    simple = simplify_polylines(stairs, 0.75)
    inner = (stairs.left != 0) & (stairs.right != 0)
    assert np.diff(stairs.offsets)[inner] == 2 * size - 1 and np.diff(simple.offsets)[inner] == 2
    square = np.zeros((6, 6), np.int32)
    square[1:5, 2:4] = 1
    assert len(simplify_polylines(arcs_of(square), 0.75).vertices) == 5
    assert len(simplify_polylines(arcs_of(np.ones((1, 1), np.int32)), 5).vertices) == 5


def test_tolerance_is_in_the_unit_of_the_pixel_sizes() -> None:
    arcs = arcs_of(blobs(0, 40, 5))
    one = simplify_polylines(arcs, 0.75)
    half = simplify_polylines(arcs, 0.375, pixel_height=0.5, pixel_width=0.5)
    assert np.array_equal(one.vertices, half.vertices)
    assert np.array_equal(simplify_polylines(arcs, 0).vertices, arcs.vertices)
    with pytest.raises(ValueError, match="tolerance"):
        simplify_polylines(arcs, -1)


def test_a_thin_region_does_not_collapse() -> None:
    check_simplified(drawing("AAAAAAAA AAABBAAA CCCCCCCC CCCCCCCC"), 3)  # two arcs between the same junctions
    check_simplified(drawing("AAAAAAA ABBBBBA AB...BA AB.C.BA AB...BA A.....A AAAAAAA"), 6)


def test_an_island_in_a_notch_is_not_passed() -> None:
    labels = np.ones((20, 20), np.int32)
    labels[:4, 8:13] = 0
    _, simple = check_simplified(labels, 4.5)
    assert len(simple.vertices) == 5
    labels[1:3, 10] = 2
    _, simple = check_simplified(labels, 4.5)
    assert len(simple.vertices) > 10
