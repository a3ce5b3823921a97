"""Contacts of regions against counting pair by pair, for quadtrees and for any labels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.regions import adjacency as naive
from tilepipe_kernels.regions.adjacency import Contacts, contacts
from tilepipe_kernels.regions.quadtree import split
from tilepipe_kernels.regions.quadtree_sums import MISSING


def rows_of(found: Contacts) -> list[tuple[int, ...]]:
    assert found.edges.dtype == found.length.dtype == np.int32
    assert found.edges.shape == (len(found.length), 2) and found.edges.flags.c_contiguous
    return [(*edge, length) for edge, length in zip(found.edges.tolist(), found.length.tolist(), strict=True)]


def patches(rows: int, columns: int, seed: int, regions: int, size: int, missing: float) -> NDArray[np.int32]:
    """Random labels in squares of `size` pixels, so that regions have long cracks, many parts and ragged borders."""
    random = np.random.default_rng(seed)
    labels = random.integers(1, regions + 1, (rows // size + 1, columns // size + 1), dtype=np.int32)
    labels = labels.repeat(size, 0).repeat(size, 1)[:rows, :columns]
    labels[random.random(labels.shape) < missing] = 0
    return labels


LABELS = st.builds(
    patches,
    st.integers(1, 25),
    st.integers(1, 25),
    st.integers(0, 9999),
    st.sampled_from([1, 2, 5, 300]),
    st.integers(1, 6),
    st.sampled_from([0.0, 0.05, 0.5, 1.0]),
)


@settings(max_examples=200)
@given(LABELS, st.integers(0, 3))
def test_contacts_are_the_adjacent_pairs(labels: NDArray[np.int32], spare: int) -> None:
    assert rows_of(contacts(labels, int(labels.max()) + spare)) == naive.contacts(labels)


@settings(max_examples=50)
@given(st.integers(0, 9999), st.integers(1, 40), st.integers(1, 40), st.sampled_from([0.0, 0.1]))
def test_contacts_of_leaves_and_of_merged_leaves(seed: int, rows: int, columns: int, missing: float) -> None:
    random = np.random.default_rng(seed)
    ticks = random.integers(0, 2, (rows // 7 + 1, columns // 5 + 1), dtype=np.int32).repeat(7, 0).repeat(5, 1)
    ticks = np.ascontiguousarray(ticks[:rows, :columns])
    ticks[random.random(ticks.shape) < missing] = MISSING
    labels, leaves = split(ticks, threshold=0.1, smallest=1, largest=16)
    count = leaves.first.size
    assert rows_of(contacts(labels, count)) == naive.contacts(labels)
    merged = np.append(0, random.integers(1, max(count // 3, 1) + 1, count)).astype(np.int32)[labels]
    assert rows_of(contacts(merged, count)) == naive.contacts(merged)


@settings(max_examples=50)
@given(LABELS, st.integers(1, 24))
def test_contacts_of_two_blocks_and_their_seam_add_up(labels: NDArray[np.int32], row: int) -> None:
    row = min(row, labels.shape[0])
    count = int(labels.max())
    parts = [contacts(labels[:row], count), contacts(labels[row:], count)]
    cracks = np.zeros((count + 1, count + 1), np.int64)
    for part in parts:
        cracks[tuple(part.edges.T)] += part.length
    for seam in zip(labels[row - 1].tolist(), labels[row].tolist() if row < labels.shape[0] else [], strict=False):
        if seam[0] != seam[1] and min(seam) > 0:
            cracks[min(seam), max(seam)] += 1
    whole = contacts(labels, count)
    np.testing.assert_array_equal(np.argwhere(cracks), whole.edges.reshape(-1, 2))
    np.testing.assert_array_equal(cracks[cracks > 0], whole.length)


def test_one_region_that_touches_all_others() -> None:
    labels = np.ones((101, 401), np.int32)
    labels[1::2, 1::2] = np.arange(2, 2 + 50 * 200)[::-1].reshape(50, 200)
    edges, length = contacts(labels, int(labels.max()))
    np.testing.assert_array_equal(edges, np.stack([np.ones(10_000), np.arange(2, 10_002)], 1))
    assert (length == 4).all()


def test_small_and_empty_blocks() -> None:
    for shape in ((0, 3), (3, 0), (1, 1), (4, 4)):
        assert rows_of(contacts(np.ones(shape, np.int32), 1)) == []
    assert rows_of(contacts(np.zeros((3, 3), np.int32), 0)) == []
    assert rows_of(contacts(np.array([[2, 2, 1]], np.int32), 2)) == [(1, 2, 1)]
    assert rows_of(contacts(np.array([[2], [1]], np.int32), 2)) == [(1, 2, 1)]
    strided = np.array([[1, 9, 2], [9, 9, 9], [1, 9, 2]], np.int32)[::2, ::2]
    assert rows_of(contacts(strided, 2)) == [(1, 2, 2)]


def test_bad_input_is_refused() -> None:
    labels = np.ones((2, 2), np.int32)
    for wrong in (labels[0], labels.astype(np.int64), labels.astype(np.float32)):
        with pytest.raises(ValueError, match="two-dimensional int32"):
            contacts(wrong, 1)
    for label in (-1, 3):
        labels[1, 1] = label
        with pytest.raises(ValueError, match=r"0\.\.2"):
            contacts(labels, 2)
