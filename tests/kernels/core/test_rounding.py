"""Rounding agrees with numpy's, halves and ends of the range included."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tilepipe_kernels.core.rounding import nearest_integer, nearest_whole


@given(st.floats(-(2.0**22) + 1, 2.0**22 - 1, width=32) | st.integers(-9, 9).map(lambda n: n + 0.5))
def test_whole_numbers_are_numpys(value: float) -> None:
    assert nearest_whole(np.float32(value)) == np.rint(np.float32(value))


@given(st.floats(-(2.0**51) + 1, 2.0**51 - 1) | st.integers(-9, 9).map(lambda n: n + 0.5))
def test_integers_are_numpys(value: float) -> None:
    assert nearest_integer(np.float64(value)) == int(np.rint(value))


def test_nan_stays() -> None:
    assert np.isnan(nearest_whole(np.float32(np.nan)))
