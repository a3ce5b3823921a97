"""Regularised borders: right angles, shared, a coverage with the same neighbours, and the same for any tiling."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from tests.kernels.polylines.test_arcs import label_images, tiled_fragments
from tests.kernels.polylines.test_polygons import IDENTITY, arcs_of, blobs
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe_kernels.polylines.join import Arcs, join_arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons
from tilepipe_kernels.polylines.regularise.regularise import regularise_arcs
from tilepipe_kernels.polylines.simplify import simplify_polylines


def houses(angle: float, size: int = 90, walls: tuple[int, ...] = (-30, -8, 9, 30), seed: int = 0) -> np.ndarray:
    """A row of houses between walls in one direction, turned by an angle in degrees, with ragged borders."""
    random = np.random.default_rng(seed)
    row, column = np.mgrid[:size, :size] + 0.5 - size / 2
    turn = np.radians(angle)
    along, across = column * np.cos(turn) + row * np.sin(turn), row * np.cos(turn) - column * np.sin(turn)
    along, across = (at + 6 * gaussian_filter(random.normal(0, 0.4, row.shape), 1.5) for at in (along, across))
    labels = np.where(abs(across) < 14, np.digitize(along, walls), 0) % len(walls) + 1
    return labels.astype(np.int32)


def edges_of(arcs: Arcs, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions in degrees and lengths of the edges of some arcs."""
    steps = [np.diff(arcs.vertices[arcs.offsets[k] : arcs.offsets[k + 1]], axis=0) for k in np.flatnonzero(wanted)]
    row, column = np.concatenate(steps).T
    return np.degrees(np.arctan2(row, column)), np.hypot(row, column)


def check_regularised(labels: np.ndarray, tolerance: float, regions: np.ndarray | None = None) -> Arcs:
    exact = arcs_of(labels)
    rings = assemble_polygons(exact)
    regular = regularise_arcs(exact, tolerance, labels.shape, simplification=0.75, regions=regions)
    ids, geometries = region_polygons(rings, regular, IDENTITY)
    assert shapely.is_valid(geometries).all() and shapely.coverage_is_valid(geometries)
    assert np.array_equal(ids, np.unique(labels[labels != 0]))
    _, before = region_polygons(rings, simplify_polylines(exact, tolerance), IDENTITY)
    assert np.array_equal(shapely.get_num_geometries(geometries), shapely.get_num_geometries(before))
    # what is moved lies near to where it was
    moved = shapely.hausdorff_distance(shapely.boundary(geometries), shapely.boundary(before))
    assert (moved <= 4 * tolerance + 0.01).all()
    assert np.array_equal(regular.left, exact.left) and np.array_equal(regular.right, exact.right)
    assert regular.vertices.min(initial=0) >= 0 and (regular.vertices.max(axis=0, initial=0) <= labels.shape).all()
    return regular


@settings(max_examples=100, deadline=None)
@given(label_images(), st.sampled_from([0.5, 1.0, 2.0, 5.0]))
def test_any_regions_stay_a_valid_coverage_of_the_same_regions(labels: np.ndarray, tolerance: float) -> None:
    if labels.any():
        check_regularised(labels, tolerance, np.ones(labels.max() + 1, np.bool_))


@pytest.mark.parametrize("tolerance", [1.0, 3.0])
def test_ragged_cells_with_islands_stay_a_coverage(tolerance: float) -> None:
    for seed in range(3):
        labels = blobs(seed, 60, 8)
        arcs = check_regularised(labels, tolerance, np.ones(labels.max() + 1, np.bool_))
        exact = arcs_of(labels)
        area, before = (
            shapely.area(region_polygons(assemble_polygons(exact), of, IDENTITY)[1])
            for of in (arcs, simplify_polylines(exact, tolerance))
        )
        assert (area > 0.49 * before).all()


@pytest.mark.parametrize("angle", [0, 10, 33, 45, 71])
def test_a_row_of_houses_gets_right_angles_and_keeps_its_area(angle: float) -> None:
    labels = houses(angle)
    arcs = check_regularised(labels, 2.8)
    walls = ((arcs.left > 1) & (arcs.left < 5)) | ((arcs.right > 1) & (arcs.right < 5))
    directions, lengths = edges_of(arcs, walls)
    main = directions[np.argmax(lengths)]
    assert abs((main - angle + 45) % 90 - 45) < 1.5
    along = abs((directions - main + 45) % 90 - 45) < 0.2
    assert lengths[along].sum() > 0.9 * lengths.sum()
    _, geometries = region_polygons(assemble_polygons(arcs_of(labels)), arcs, IDENTITY)
    for one, width in zip(geometries[1:4], (22, 17, 21), strict=True):
        assert one.area == pytest.approx(28 * width, rel=0.05)


def test_fronts_of_a_row_are_one_line() -> None:
    arcs = check_regularised(houses(10), 2.8)
    fronts = [k for k in range(len(arcs)) if {1} < {int(arcs.left[k]), int(arcs.right[k])}]
    middle = [k for k in fronts if 3 in (arcs.left[k], arcs.right[k])]
    assert len(middle) == 2 and all(arcs.offsets[k + 1] - arcs.offsets[k] == 2 for k in middle)


def test_round_regions_are_left_alone() -> None:
    row, column = np.mgrid[:60, :60] - 29.5
    labels = (np.hypot(row, column) < 20).astype(np.int32) + 1
    exact = arcs_of(labels)
    arcs = regularise_arcs(exact, 1.0, labels.shape, simplification=1.0)
    assert np.array_equal(arcs.vertices, simplify_polylines(exact, 1.0).vertices)


def test_only_wanted_regions_are_regularised() -> None:
    labels = houses(20)
    exact = arcs_of(labels)
    none = regularise_arcs(exact, 2.0, labels.shape, simplification=0.75, regions=np.zeros(6, np.bool_))
    assert np.array_equal(none.vertices, simplify_polylines(exact, 0.75).vertices)


def test_off_changes_nothing() -> None:
    exact = arcs_of(houses(20))
    off, simple = regularise_arcs(exact, 0, (90, 90), simplification=0.75), simplify_polylines(exact, 0.75)
    for name in ("offsets", "vertices", "left", "right"):
        assert getattr(off, name).tobytes() == getattr(simple, name).tobytes()
    with pytest.raises(ValueError, match="tolerance"):
        regularise_arcs(exact, -1, (90, 90))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 3), st.integers(5, 60), st.integers(5, 60))
def test_tiling_does_not_show(seed: int, rows: int, columns: int) -> None:
    labels = houses(30 + seed, seed=seed)
    whole = regularise_arcs(arcs_of(labels), 2.0, labels.shape)
    tiled = regularise_arcs(join_arcs(tiled_fragments(labels, (rows, columns))), 2.0, labels.shape)
    assert whole.vertices.tobytes() == tiled.vertices.tobytes() and whole.offsets.tobytes() == tiled.offsets.tobytes()


def test_metres_are_metres() -> None:
    exact = arcs_of(houses(30))
    one = regularise_arcs(exact, 2.0, (90, 90), simplification=0.75)
    half = regularise_arcs(exact, 1.0, (90, 90), simplification=0.375, pixel_height=0.5, pixel_width=0.5)
    assert np.array_equal(one.vertices, half.vertices)
