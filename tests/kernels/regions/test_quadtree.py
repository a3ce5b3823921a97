"""Quadtree split against recursion in exact fractions; the tiling is invisible; what is refused."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.regions import quadtree as naive
from tilepipe_kernels.regions.quadtree import LeafTable, exceeds, split
from tilepipe_kernels.regions.quadtree_sums import LARGEST_SIDE, MISSING

COLUMNS = ("first", "level", "count", "total", "squares")
TYPES = (np.int64, np.uint8, np.int32, np.int64, np.int64)


def scene(
    rows: int, columns: int, seed: int, *, height: int, step: int, noise: int, missing: float
) -> NDArray[np.int32]:
    """Boxes on a plane at `height`, with noise and nodata in single pixels and in one rectangle."""
    random = np.random.default_rng(seed)
    ticks = np.full((rows, columns), height, np.int32)
    for _ in range(4):
        i, j = random.integers(0, rows), random.integers(0, columns)
        ticks[i : i + random.integers(1, 20), j : j + random.integers(1, 20)] += step
    ticks += random.integers(-noise, noise + 1, ticks.shape, dtype=np.int32)
    ticks[random.random(ticks.shape) < missing] = MISSING
    if missing:
        i, j = random.integers(0, rows), random.integers(0, columns)
        ticks[i : i + 9, j : j + 17] = MISSING
    return ticks


def scenes(longest: int) -> st.SearchStrategy[NDArray[np.int32]]:
    return st.builds(
        scene,
        st.integers(1, longest),
        st.integers(1, longest),
        st.integers(0, 9999),
        height=st.sampled_from([0, 30_000, -2_000_000]),
        step=st.sampled_from([1, 3_000]),
        noise=st.sampled_from([0, 1, 40]),
        missing=st.sampled_from([0.0, 0.1, 0.7, 1.0]),
    )


SIDES = st.sampled_from([(1, 1), (1, 8), (2, 2), (2, 16), (4, 8), (2, 64), (16, 32)])
THRESHOLDS = st.sampled_from([0.0, 0.25, 0.5, 3.75, 400.0, 122_500.0])


def rows_of(leaves: LeafTable) -> list[tuple[int, ...]]:
    return list(zip(*(getattr(leaves, name).tolist() for name in COLUMNS), strict=True))


@settings(max_examples=150)
@given(scenes(40), THRESHOLDS, SIDES)
def test_leaves_are_those_of_the_recursion(ticks: NDArray[np.int32], threshold: float, sides: tuple[int, int]) -> None:
    labels, leaves = split(ticks, threshold=threshold, smallest=sides[0], largest=sides[1])
    expected_labels, expected = naive.split(ticks, Fraction(threshold), *sides)
    assert labels.dtype == np.int32
    assert tuple(getattr(leaves, name).dtype for name in COLUMNS) == TYPES
    assert rows_of(leaves) == expected
    np.testing.assert_array_equal(labels, expected_labels)


@settings(max_examples=60)
@given(scenes(90), THRESHOLDS, SIDES, st.integers(1, 4), st.integers(1, 4), st.sampled_from([0, 1, 5]))
def test_leaves_of_tiles_are_those_of_the_whole(
    ticks: NDArray[np.int32], threshold: float, sides: tuple[int, int], down: int, across: int, start: int
) -> None:
    smallest, largest = sides
    columns = ticks.shape[1]
    labels, leaves = split(ticks, threshold=threshold, smallest=smallest, largest=largest)
    together = []
    joined = np.zeros_like(labels)
    for top in range(0, ticks.shape[0], down * largest):
        for left in range(0, columns, across * largest):
            tile = ticks[top : top + down * largest, left : left + across * largest]
            origin = (start * largest + top, left - start * largest)
            own, table = split(tile, threshold=threshold, smallest=smallest, largest=largest, origin=origin)
            into = joined[top : top + down * largest, left : left + across * largest]
            into[own > 0] = own[own > 0] + len(together)
            for first, *rest in rows_of(table):
                i, j = divmod(first, tile.shape[1])
                together.append(((top + i) * columns + left + j, *rest))
    assert sorted(together) == rows_of(leaves)
    # The number that the whole gives to each leaf of the tiles.
    lookup = np.append(0, np.argsort(np.argsort([row[0] for row in together])) + 1).astype(np.int32)
    np.testing.assert_array_equal(lookup[joined], labels)


@settings(max_examples=300)
@given(st.lists(st.integers(-(2**20), 2**20), min_size=1, max_size=20), st.integers(-3, 3), st.integers(-3, 3))
def test_decision_is_exact_at_the_threshold(values: list[int], shift: int, far: int) -> None:
    values = [value + far * 2**22 for value in values]
    sums = len(values), sum(values), sum(value**2 for value in values)
    variance = naive.variance(values)
    units = max(int(variance * 2**20) + shift, 0)
    assert exceeds(*sums, *divmod(units, 2**20)) == (variance > Fraction(units, 2**20))


@pytest.mark.parametrize("largest", [1, 2, 64, LARGEST_SIDE])
@pytest.mark.parametrize("sign", [-1, 1])
def test_largest_magnitudes_do_not_overflow(largest: int, sign: int) -> None:
    reach = min(2**31 // largest, 2**31 - 1)
    ticks = np.full((largest, largest), sign * reach, np.int32)
    _, leaves = split(ticks, threshold=0.0, smallest=1, largest=largest)
    assert rows_of(leaves) == [
        (0, largest.bit_length() - 1, ticks.size, sign * reach * ticks.size, reach**2 * ticks.size)
    ]
    ticks[::2] *= -1
    assert split(ticks, threshold=np.inf, smallest=1, largest=largest)[0].max() == 1
    if largest > 1:
        assert split(ticks, threshold=float(reach) ** 2, smallest=1, largest=largest)[0].max() == 1
        assert split(ticks, threshold=float(reach) ** 2 * 0.999, smallest=1, largest=largest)[0].max() == ticks.size
        ticks[0, 0] = sign * (reach + 1)
        with pytest.raises(ValueError, match="subtract a reference"):
            split(ticks, threshold=1.0, smallest=1, largest=largest)


def test_threshold_itself_does_not_split() -> None:
    ticks = np.array([[0, 2], [2, 0]], np.int32) + 30_000
    assert split(ticks, threshold=1.0, smallest=1, largest=2)[0].max() == 1
    assert split(ticks, threshold=1.0 - 2.0**-20, smallest=1, largest=2)[0].max() == 4
    assert split(ticks, threshold=0.0, smallest=2, largest=2)[0].max() == 1


def test_blocks_of_nothing() -> None:
    for shape in ((0, 5), (5, 0), (3, 3)):
        labels, leaves = split(np.full(shape, MISSING), threshold=1.0, smallest=2, largest=8)
        assert labels.shape == shape and not labels.any() and leaves.first.size == 0


def test_real_heights(shared_data: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(shared_data / "autzen_north" / "dsm_max_2ft.tif") as file:
        feet = file.read(1, window=((200, 300), (900, 1060))).astype(np.float64)
        missing = feet == file.nodata
    ticks = np.where(missing, float(MISSING), np.rint(feet * 304.8)).astype(np.int32)
    labels, leaves = split(ticks, threshold=350.0**2, smallest=2, largest=64)
    expected_labels, expected = naive.split(ticks, Fraction(350**2), 2, 64)
    assert rows_of(leaves) == expected and len(set(leaves.level.tolist())) > 3
    np.testing.assert_array_equal(labels, expected_labels)


def test_bad_input_is_refused() -> None:
    ticks = np.zeros((8, 8), np.int32)
    for wrong in (ticks[0], ticks.astype(np.float32), ticks.astype(np.int64)):
        with pytest.raises(ValueError, match="two-dimensional int32"):
            split(wrong, threshold=1.0, smallest=2, largest=4)
    for sides in ((0, 4), (2, 6), (3, 4), (-2, 4), (2, 2 * LARGEST_SIDE)):
        with pytest.raises(ValueError, match="powers of two"):
            split(ticks, threshold=1.0, smallest=sides[0], largest=sides[1])
    with pytest.raises(ValueError, match="must not exceed"):
        split(ticks, threshold=1.0, smallest=8, largest=4)
    with pytest.raises(ValueError, match="no multiple of 4"):
        split(ticks, threshold=1.0, smallest=2, largest=4, origin=(4, 2))
    for threshold in (-1.0, float("nan")):
        with pytest.raises(ValueError, match="threshold"):
            split(ticks, threshold=threshold, smallest=2, largest=4)
