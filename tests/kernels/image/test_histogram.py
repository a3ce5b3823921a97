"""Histograms add up over tiles, order floats of both signs, and give the percentiles and classes of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from skimage.filters import threshold_otsu

from tilepipe_kernels.image.histogram import BINS, bin_values, histogram, otsu_classes, percentile


def bin_of(value: float) -> int:
    """The one bin that a value is counted in."""
    (number,) = np.flatnonzero(histogram(np.array([[value]], np.float32)))
    return int(number)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float32, np.float64])
def test_every_dtype_is_counted_in_the_same_bins(dtype):
    values = np.array([[0, 1, 1, 100], [100, 100, 7, 3]], dtype)
    counts = histogram(values)
    bins = np.flatnonzero(counts)
    assert counts.shape == (BINS,)
    assert bin_values(bins).tolist() == [0, 1, 3, 7, 100]
    assert counts[bins].tolist() == [1, 2, 1, 1, 3]


def test_nan_is_not_counted():
    assert histogram(np.array([[np.nan, 2.0, np.nan]], np.float32)).sum() == 1
    assert histogram(np.full((3, 3), np.nan)).sum() == 0
    assert histogram(np.empty((0, 4))).sum() == 0


def test_a_strided_block_is_counted_like_its_copy():
    values = np.arange(60, dtype=np.float32).reshape(6, 10)
    strided = values[::2, ::-3]
    assert np.array_equal(histogram(strided), histogram(strided.copy()))


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=2, max_size=30))
def test_bins_are_ordered_like_values(values):
    values = sorted(values)
    bins = [bin_of(value) for value in values]
    assert bins == sorted(bins)
    edges = bin_values(np.array(bins))
    assert np.all(edges <= np.array(values, np.float32))
    above = bin_values(np.array(bins) + 1)
    assert np.all(np.array(values, np.float32) < above)


@given(st.floats(2.0**-100, 2.0**100, width=32), st.booleans())
def test_bins_are_a_thousandth_wide(size, negative):
    value = -size if negative else size
    edge = float(bin_values(np.array([bin_of(value)]))[0])
    assert abs(value - edge) <= 2**-10 * abs(value)


@given(
    arrays.arrays(np.float32, (23, 31), elements=st.floats(-1000, 1000, width=32) | st.just(np.nan)),
    st.integers(1, 22),
    st.integers(1, 30),
)
def test_tiles_add_up_to_the_whole(values, row, column):
    parts = [values[:row, :column], values[:row, column:], values[row:, :column], values[row:, column:]]
    assert np.array_equal(sum(histogram(part) for part in parts), histogram(values))


@given(
    arrays.arrays(np.int64, st.integers(1, 200), elements=st.integers(0, 1023)),
    st.integers(0, 1000).map(lambda tenths: tenths / 10),
)
def test_percentiles_of_integers_are_numpys(values, percent):
    # below or at which so many lie: NumPy's inverted distribution function, with the rank in whole numbers
    rank = max(1, -(-values.size * round(percent * 10) // 1000))
    expected = np.sort(values)[rank - 1]
    assert percentile(histogram(values), percent) == expected


@pytest.mark.parametrize("percent", range(101))
def test_percentiles_of_a_hundred_values_are_those_values(percent):
    counts = histogram(np.arange(1, 101))
    assert percentile(counts, percent) == max(1, percent)


def test_percentiles_agree_with_numpy_on_a_sample():
    values = np.random.default_rng(3).integers(0, 256, 997)
    for percent in (0, 2.5, 25, 50, 99.5, 100):
        expected = np.percentile(values, percent, method="inverted_cdf")
        assert percentile(histogram(values), percent) == expected


def test_percentiles_of_negative_floats_stay_within_a_thousandth():
    values = np.random.default_rng(4).normal(-50, 30, 2001).astype(np.float32)
    for percent in (1, 50, 99):
        expected = np.percentile(values, percent, method="inverted_cdf")
        assert percentile(histogram(values), percent) == pytest.approx(expected, rel=2**-10)


def test_percentiles_refuse_nonsense():
    with pytest.raises(ValueError, match="empty"):
        percentile(np.zeros(BINS, np.int64), 50)
    for percent in (-1, 101, float("nan")):
        with pytest.raises(ValueError, match=r"0 \.\. 100"):
            percentile(histogram(np.arange(5)), percent)


@given(st.integers(0, 2**32 - 1))
def test_otsu_is_that_of_scikit_image(seed):
    rng = np.random.default_rng(seed)
    means, spreads = np.sort(rng.uniform(20, 235, 2)), rng.uniform(8, 40, 2)
    values = np.concatenate([rng.normal(m, s, 4000) for m, s in zip(means, spreads, strict=True)])
    counts = np.bincount(np.clip(np.rint(values), 0, 255).astype(np.int64), minlength=256) + 1
    split, dark, bright = otsu_classes(counts)
    assert split == threshold_otsu(hist=(counts, np.arange(256)))
    bins = np.arange(256)
    assert dark == pytest.approx(np.average(bins[: split + 1], weights=counts[: split + 1]))
    assert bright == pytest.approx(np.average(bins[split + 1 :], weights=counts[split + 1 :]))


def test_otsu_parts_two_spikes_and_refuses_one():
    counts = np.zeros(256, np.int64)
    counts[[40, 160]] = 1000, 3000
    split, dark, bright = otsu_classes(counts)
    assert 40 <= split < 160
    assert (dark, bright) == (40, 160)
    counts[160] = 0
    with pytest.raises(ValueError, match="single"):
        otsu_classes(counts)
