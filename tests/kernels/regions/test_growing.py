"""Region growing, the region table, contour length and selection, against flood fill and plain counting."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.regions import growing as naive
from tilepipe_kernels.regions.growing import grow_regions, rectangle_centers
from tilepipe_kernels.regions.region_table import contour_length, region_contacts, region_table, select_labels


def scene(rows: int, columns: int, seed: int, levels: int, missing: float) -> NDArray[np.float32]:
    random = np.random.default_rng(seed)
    values = random.integers(0, levels, (rows, columns)).astype(np.float32)
    values[random.random(values.shape) < missing] = np.nan
    return values


SCENES = st.builds(
    scene,
    st.integers(1, 24),
    st.integers(1, 40),
    st.integers(0, 999),
    st.integers(1, 12),
    st.sampled_from([0.0, 0.1, 0.5, 1.0]),
)


@settings(max_examples=150, deadline=None)
@given(SCENES, st.sampled_from([0.0, 1.0, 2.0, 2.5, 100.0]), st.sampled_from([math.inf, 5.0, -1.0]))
def test_regions_are_those_of_a_flood_fill(values: NDArray[np.float32], tolerance: float, maximum: float) -> None:
    labels = grow_regions(values, tolerance, maximum=maximum)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, naive.grow_regions(values, tolerance, maximum))


def test_agrees_with_connected_components_3d() -> None:
    cc3d = pytest.importorskip("cc3d")
    random = np.random.default_rng(5)
    values = random.normal(100, 10, (301, 403)).astype(np.float32)
    ours, theirs = grow_regions(values, 6.0), cc3d.connected_components(values, delta=6.0, connectivity=4)
    pairs = np.unique(np.stack([ours.ravel(), theirs.ravel()]), axis=1)
    assert pairs.shape[1] == ours.max() == len(np.unique(theirs))
    firsts = np.unique(ours, return_index=True)[1]
    assert (np.diff(firsts) > 0).all()


def test_spirals_and_combs_are_one_region() -> None:
    comb = np.zeros((41, 60), np.float32)
    comb[:-1, 1::2] = 50
    assert set(np.unique(grow_regions(comb, 0.0)[comb == 0])) == {1}
    assert grow_regions(comb, 0.0).max() == 31
    ramp = np.add.outer(np.arange(30), np.arange(50)).astype(np.float32)
    assert grow_regions(ramp, 1.0).max() == 1
    assert grow_regions(ramp, 0.9).max() == ramp.size


def test_what_is_not_finite_belongs_to_nothing() -> None:
    values = np.array([[1, np.nan, 1, np.inf, np.inf, -np.inf, 2]], np.float32)
    np.testing.assert_array_equal(grow_regions(values, 5.0), [[1, 0, 2, 0, 0, 0, 3]])
    np.testing.assert_array_equal(grow_regions(values, 5.0, maximum=1.0), [[1, 0, 2, 0, 0, 0, 0]])
    assert grow_regions(np.empty((0, 5)), 1.0).shape == (0, 5)
    np.testing.assert_array_equal(grow_regions(np.array([[250, 3, 5]], np.uint8), 4), [[1, 2, 2]])


@pytest.mark.parametrize("size", [(1, 1), (3, 1), (1, 3), (5, 3), (7, 7)])
@pytest.mark.parametrize("shape", [(1, 1), (15, 21), (16, 22), (17, 23), (2, 50)])
def test_rectangle_centers(size: tuple[int, int], shape: tuple[int, int]) -> None:
    block = np.random.default_rng(0).random(shape)
    np.testing.assert_array_equal(rectangle_centers(block, *size), naive.rectangle_centers(block, *size))
    tile = rectangle_centers(block[size[0] :, size[1] :], *size, origin=size)
    np.testing.assert_array_equal(tile, rectangle_centers(block, *size)[1:, 1:])


def test_one_by_one_rectangles_copy_nothing() -> None:
    block = np.zeros((4, 5))
    assert rectangle_centers(block, 1, 1) is block


@settings(max_examples=80, deadline=None)
@given(SCENES, st.tuples(*[st.booleans()] * 4))
def test_table_counts(values: NDArray[np.float32], borders: tuple[bool, bool, bool, bool]) -> None:
    values = values * np.float32(1.37)
    labels = grow_regions(values, 1.5)
    table = region_table(labels, values, int(labels.max()), borders=borders)
    for label in range(1, int(labels.max()) + 1):
        for name, expected in naive.measures(labels, values, label, borders).items():
            column = getattr(table, name)
            assert column.dtype == np.int64 and column[label - 1] == expected, (label, name)


def test_tables_of_two_blocks_and_their_seam_add_up() -> None:
    random = np.random.default_rng(1)
    labels = random.integers(0, 4, (20, 31), dtype=np.int32)
    values = random.random(labels.shape).astype(np.float32) * 255
    whole = region_table(labels, values, 3)
    left = region_table(labels[:, :13], values[:, :13], 3, borders=(True, True, True, False))
    right = region_table(labels[:, 13:], values[:, 13:], 3, borders=(True, True, False, True))
    seam_left, seam_right = labels[:, 12], labels[:, 13]
    for label in (1, 2, 3):
        parted = (seam_left != seam_right) & ((seam_left == label) | (seam_right == label))
        k = label - 1
        assert whole.vertical_cracks[k] == left.vertical_cracks[k] + right.vertical_cracks[k] + parted.sum()
    for name in ("count", "horizontal_cracks", "grey_sum"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(left, name) + getattr(right, name))


def test_table_is_frozen() -> None:
    table = region_table(np.ones((2, 2), np.int32), np.ones((2, 2)), 1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        table.count = table.first  # type: ignore[misc]


def test_contour_length_of_discs_and_of_rectangular_pixels() -> None:
    i, j = np.indices((401, 401))
    disc = ((i - 200) ** 2 + (j - 200) ** 2 < 150**2).astype(np.int32)
    table = region_table(disc, np.zeros(disc.shape), 1)
    length = contour_length(table.horizontal_cracks, table.vertical_cracks, 0.5, 0.5)
    assert length == pytest.approx(2 * math.pi * 75, rel=0.01)
    ring = disc * ((i - 200) ** 2 + (j - 200) ** 2 >= 100**2).astype(np.int32)
    table = region_table(ring, np.zeros(disc.shape), 1)
    length = contour_length(table.horizontal_cracks, table.vertical_cracks, 1.0, 1.0)
    assert length == pytest.approx(2 * math.pi * 250, rel=0.01)
    assert contour_length(np.array(6), np.array(2), 10.0, 1.0) == pytest.approx(math.pi / 4 * 26)


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int32, np.float64])
def test_select_labels(dtype: type) -> None:
    random = np.random.default_rng(2)
    labels = random.integers(0, 9, (31, 47), dtype=np.int32)
    lookup: NDArray[Any] = random.integers(0, 2, 9).astype(dtype)
    result = select_labels(labels, lookup)
    assert result.dtype == dtype
    np.testing.assert_array_equal(result, lookup[labels])


def test_bad_input_is_refused() -> None:
    block, labels = np.zeros((4, 4)), np.zeros((4, 4), np.int32)
    for size in ((2, 1), (1, 4), (0, 1), (-1, 1)):
        with pytest.raises(ValueError, match="odd"):
            rectangle_centers(block, *size)
    with pytest.raises(ValueError, match="origin"):
        rectangle_centers(block, 3, 1, origin=(4, 0))
    for tolerance in (-1.0, math.nan):
        with pytest.raises(ValueError, match="tolerance"):
            grow_regions(block, tolerance)
    with pytest.raises(ValueError, match="maximum"):
        grow_regions(block, 1.0, maximum=math.nan)
    with pytest.raises(ValueError, match="two-dimensional real"):
        grow_regions(block[0], 1.0)
    with pytest.raises(ValueError, match="one shape"):
        region_table(labels, block[1:], 1)
    with pytest.raises(ValueError, match=r"0\.\.1"):
        region_table(labels + 2, block, 1)
    for label in (-1, 5):
        labels[3, 3] = label
        with pytest.raises(ValueError, match="no entry"):
            select_labels(labels, np.zeros(5))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**20), rows=st.integers(1, 15), columns=st.integers(1, 15))
def test_contacts_are_the_cracks_between_flagged_regions(seed: int, rows: int, columns: int) -> None:
    random = np.random.default_rng(seed)
    labels = random.integers(0, 5, (rows, columns)).astype(np.int32)
    flagged = random.random(5) < 0.7
    expected: dict[tuple[int, int], list[int]] = {}
    for side, (a, b) in enumerate(((labels[:-1], labels[1:]), (labels[:, :-1], labels[:, 1:]))):
        for x, y in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
            if x and y and x != y and flagged[x] and flagged[y]:
                expected.setdefault((min(x, y), max(x, y)), [0, 0])[side] += 1
    found = region_contacts(labels, flagged)
    assert [tuple(row) for row in found.tolist()] == [(*pair, *sides) for pair, sides in sorted(expected.items())]
