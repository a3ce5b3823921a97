"""Random numbers of the device are the very numbers of the host."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.core.random import normals, uniforms
from tilepipe_kernels.core.sums import BLOCK, LANES, ordered_sum

SITES = np.array([[0, 1, 2, 3], [9, 2**31, 2**32 + 1, 2**62]])


@pytest.mark.parametrize("draw", [uniforms, normals])
def test_draws_are_the_same_bits(draw) -> None:
    for seed, sweep, stream in ((0, 0, 0), (2**64 - 1, 2**32 - 1, 5), (17, 3, 2**31 - 1)):
        found = draw(to_device(SITES), seed, sweep, stream)
        assert on_device(found)
        np.testing.assert_array_equal(to_host(found), draw(SITES, seed, sweep, stream))
    with pytest.raises(ValueError, match="sweep must be"):
        draw(to_device(SITES), 0, -1)


@pytest.mark.parametrize("size", [0, 1, LANES + 3, BLOCK + LANES + 1])
def test_sums_are_the_same_bits(size: int) -> None:
    values = np.random.default_rng(size).normal(0, 1e6, size) ** 3
    assert ordered_sum(to_device(values)) == ordered_sum(values)
    assert ordered_sum(values) == pytest.approx(values.sum(), rel=1e-12)
