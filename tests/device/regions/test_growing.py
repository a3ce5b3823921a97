"""Region growing on the device gives the very labels of the CPU and of the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.regions import growing as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.regions.growing import grow_regions


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 12), columns=st.integers(1, 12), tolerance=st.integers(0, 3))
def test_labels_are_those_of_the_oracle(seed: int, rows: int, columns: int, tolerance: int) -> None:
    values = np.random.default_rng(seed).integers(0, 8, (rows, columns)).astype(np.float32)
    values[np.random.default_rng(seed + 1).random(values.shape) < 0.1] = np.nan
    found = grow_regions(to_device(values), tolerance, maximum=6)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), naive.grow_regions(values, tolerance, 6))
    np.testing.assert_array_equal(to_host(found), grow_regions(values, tolerance, maximum=6))


def test_long_winding_region_is_one() -> None:
    values = np.ones((9, 9), np.float32)
    values[1::4, :-1] = values[3::4, 1:] = np.nan
    assert to_host(grow_regions(to_device(values), 0)).max() == 1


def test_host_and_device_do_not_mix() -> None:
    from tilepipe_kernels.core.arrays import namespace

    with pytest.raises(TypeError, match="mixed"):
        namespace(np.zeros(3), to_device(np.zeros(3)))
