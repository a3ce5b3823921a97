"""Means over regions: of the logarithm of a measure, and of the height above the ground."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe_kernels.heights.region_means import LEAST, MOST, mean_above, mean_logarithms


def test_mean_logarithms_are_those_of_the_limited_measure() -> None:
    random = np.random.default_rng(2)
    values = np.exp(random.normal(0, 3, (24, 31))).astype(np.float32)
    values[random.random(values.shape) < 0.2] = np.nan
    labels = random.integers(0, 5, values.shape).astype(np.int32)
    values[labels == 4] = np.nan
    found = mean_logarithms(labels, values, 4)
    assert found.dtype == np.float32 and np.isnan(found[3])
    for label in range(1, 4):
        limited = np.clip(values[labels == label], LEAST, MOST).astype(np.float64)
        power = np.floor(np.log2(limited))
        expected = np.nanmean(power + limited / 2**power - 1) * np.log(2)
        assert found[label - 1] == pytest.approx(expected, abs=1e-5)
        assert found[label - 1] == pytest.approx(np.nanmean(np.log(limited)), abs=0.06)
    np.testing.assert_array_equal(found, mean_logarithms(labels[::-1, ::-1], values[::-1, ::-1], 4))


def test_powers_of_two_are_exact_and_what_is_no_measure_is_left_out() -> None:
    values = np.array([[0.25, 1.0, -0.0, np.inf, np.nan]], np.float32)
    found = mean_logarithms(np.array([[1, 1, 2, 3, 3]], np.int32), values, 3)
    np.testing.assert_allclose(found[:2], [-np.log(2), np.log2(LEAST) * np.log(2)], atol=0.06)
    assert found[0] == np.float32(-np.log(2)) and np.isnan(found[2])


def test_mean_heights_above_the_ground() -> None:
    random = np.random.default_rng(3)
    labels = random.integers(0, 4, (20, 30)).astype(np.int32)
    ticks = random.integers(-9000, 90000, labels.shape).astype(np.int32)
    ground = random.normal(0, 5, labels.shape).astype(np.float32)
    ground[labels == 0] = np.nan
    pixels = np.bincount(labels.ravel())[1:]
    found = mean_above(labels, ticks, ground, pixels, 1000)
    expected = [(ticks / 1000 - ground)[labels == label].mean() for label in range(1, 4)]
    np.testing.assert_allclose(found, expected, atol=5e-4)


def test_bad_input_is_named() -> None:
    labels, values = np.full((4, 4), 3, np.int32), np.zeros((4, 4), np.float32)
    with pytest.raises(ValueError, match=r"0\.\.2"):
        mean_logarithms(labels, values, 2)
    with pytest.raises(ValueError, match="shape"):
        mean_logarithms(labels, values[1:], 3)
    with pytest.raises(ValueError, match="ticks"):
        mean_above(labels, labels[1:], values, np.ones(3), 1000)
