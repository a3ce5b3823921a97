"""Means over regions on the device are the CPU's, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.heights.region_means import mean_above, mean_logarithms

SIDES = st.integers(1, 20)


@settings(max_examples=10)
@given(SIDES, SIDES, st.integers(0, 9999))
def test_mean_logarithms_are_those_of_the_cpu(rows: int, columns: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    values = np.exp(random.normal(0, 3, (rows, columns))).astype(np.float32)
    labels = random.integers(0, 5, values.shape).astype(np.int32)
    values[random.random(values.shape) < 0.2] = np.nan
    values[random.random(values.shape) < 0.1] = -0.0
    values[random.random(values.shape) < 0.1] = np.inf
    values[labels == 4] = np.nan
    found = mean_logarithms(to_device(labels), to_device(values), 4)
    assert on_device(found) and found.dtype == np.float32
    np.testing.assert_array_equal(to_host(found), mean_logarithms(labels, values, 4))


@settings(max_examples=10)
@given(SIDES, SIDES, st.integers(0, 9999))
def test_mean_heights_are_those_of_the_cpu(rows: int, columns: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    labels = random.integers(0, 4, (rows, columns)).astype(np.int32)
    labels[0, : min(columns, 3)] = range(1, min(columns, 3) + 1)
    ticks = random.integers(-9000, 90000, labels.shape).astype(np.int32)
    ground = random.normal(0, 5, labels.shape).astype(np.float32)
    ground[labels == 0] = np.nan
    pixels = np.bincount(labels.ravel())[1:].astype(np.int32)
    found = mean_above(to_device(labels), to_device(ticks), to_device(ground), to_device(pixels), 1000)
    assert on_device(found) and found.dtype == np.float32
    np.testing.assert_array_equal(to_host(found), mean_above(labels, ticks, ground, pixels, 1000))


def test_labels_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.\.2"):
        mean_logarithms(to_device(np.full((2, 2), 3, np.int32)), to_device(np.zeros((2, 2), np.float32)), 2)
