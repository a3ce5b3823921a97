"""Borders on the device are those of the CPU, to the bit."""

from __future__ import annotations

import numpy as np

from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.image.borders import with_borders
from tilepipe_kernels.image.grey_levels import store


def test_borders_are_the_same() -> None:
    rng = np.random.default_rng(0)
    mask = np.zeros((17, 22), bool)
    mask[5:9, 2:], mask[9:15, 12:15] = True, True
    grey = np.where(mask, 50, 120).astype(np.float32)
    grey[4:10] = 55
    grey += rng.normal(0, 20, grey.shape).astype(np.float32)
    grey[rng.random(grey.shape) < 0.05] = np.nan
    ids = np.where(mask & (rng.random(mask.shape) < 0.9), np.uint32(7), np.uint32(0))
    image = np.where(mask, np.float32(50), np.float32(150))
    arrays = mask, image, ids, store(grey, np.zeros(mask.shape, bool))
    expected = with_borders(*arrays, dark=45.0, bright=150.0, reach=2, noise=6.0)
    found = with_borders(*(to_device(each) for each in arrays), dark=45.0, bright=150.0, reach=2, noise=6.0)
    assert on_device(*found) and (expected[0] & ~mask).sum() > 5
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(to_host(ours), theirs)
