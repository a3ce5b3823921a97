"""Contacts and extremes of regions on the device are those of the CPU and of the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.kernels.regions.test_adjacency import patches
from tests.naive.regions import adjacency as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.regions.adjacency import contacts
from tilepipe_kernels.regions.extremes import label_extremes

LABELS = st.builds(
    patches,
    st.integers(1, 14),
    st.integers(1, 14),
    st.integers(0, 9999),
    st.sampled_from([1, 2, 5, 300]),
    st.integers(1, 6),
    st.sampled_from([0.0, 0.05, 0.5, 1.0]),
)


@settings(max_examples=20)
@given(LABELS, st.integers(0, 3))
def test_contacts_are_those_of_the_oracle(labels: NDArray[np.int32], spare: int) -> None:
    count = int(labels.max()) + spare
    found = contacts(to_device(labels), count)
    assert on_device(*found)
    edges, length = to_host(found.edges), to_host(found.length)
    assert [(*edge, n) for edge, n in zip(edges.tolist(), length.tolist(), strict=True)] == naive.contacts(labels)
    for here, there in zip(contacts(labels, count), (edges, length), strict=True):
        assert here.dtype == there.dtype and here.shape == there.shape


def test_labels_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.\.2, not in -1\.\.3"):
        contacts(to_device(np.array([[-1, 3]], np.int32)), 2)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_extremes_are_those_of_the_cpu(dtype: type) -> None:
    random = np.random.default_rng(5)
    labels = random.integers(0, 6, (11, 13)).astype(np.int32)
    values = random.integers(-9000, 9000, labels.shape).astype(dtype)
    found = label_extremes(to_device(labels), to_device(values), 5)
    assert on_device(*found)
    for here, there in zip(label_extremes(labels, values, 5), found, strict=True):
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, to_host(there))


def test_floats_are_refused() -> None:
    with pytest.raises(ValueError, match="int32 or int64"):
        label_extremes(to_device(np.ones((2, 2), np.int32)), to_device(np.ones((2, 2))), 1)
