"""Borders put back beside a mask: by the nearer of two levels, joined to the mask, bounded in reach."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tilepipe_kernels.image.borders import halo, with_borders
from tilepipe_kernels.image.grey_levels import store

LEVELS = {"dark": 40.0, "bright": 160.0}


def bordered(
    grey: NDArray[np.float32], mask: NDArray[np.bool_], reach: int = 3, noise: float = 5.0
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    packed = store(grey, np.zeros(grey.shape, bool))
    image = np.where(mask, np.float32(50), np.float32(160))
    return with_borders(mask, image, mask.astype(np.uint32), packed, **LEVELS, reach=reach, noise=noise)


def street(side: float = 150.0) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A street in rows 10 to 19, of which noise has left out the two rows at each side."""
    grey = np.full((30, 40), side, np.float32)
    grey[10:20] = 50
    mask = np.zeros(grey.shape, bool)
    mask[12:18] = True
    return grey, mask


@pytest.mark.parametrize("side", [150.0, 90.0, 10.0])
def test_a_street_gets_its_borders_beside_brighter_and_darker_sides(side):
    grey, mask = street(side)
    found, image = bordered(grey + np.random.default_rng(0).normal(0, 5, grey.shape).astype(np.float32), mask)
    np.testing.assert_array_equal(found, (grey == 50))
    np.testing.assert_allclose(image[10:12], 50, atol=1)


def test_levels_that_the_noise_does_not_part_tell_nothing():
    grey, mask = street(side=58.0)
    found, image = bordered(grey, mask, noise=5.0)
    np.testing.assert_array_equal(found, mask)
    assert set(np.unique(image)) == {50.0, 160.0}


def test_a_pavement_stays_outside():
    grey, mask = street()
    grey[7:10] = grey[20:23] = 110
    np.testing.assert_array_equal(bordered(grey, mask)[0], grey == 50)


def test_what_is_not_joined_to_the_mask_or_has_no_grey_stays_outside():
    grey, mask = street()
    grey[11, 10:20] = 150  # what lies behind is not reached
    grey[10, 9:21] = 150
    grey[10, 15] = 50
    grey[19, 5] = np.nan
    found, _ = bordered(grey, mask)
    assert not found[10, 15] and not found[19, 5]
    assert found[10, 5] and found[19, 6]


def test_the_halo_is_enough():
    rng = np.random.default_rng(3)
    grey = np.where(rng.random((70, 70)) < 0.5, 50, 150).astype(np.float32)
    mask = np.kron(rng.random((10, 10)) < 0.4, np.ones((7, 7))) > 0
    reach, inner = 2, slice(20, 50)
    near = slice(inner.start - halo(reach), inner.stop + halo(reach))
    for whole, part in zip(
        bordered(grey, mask, reach), bordered(grey[near, near], mask[near, near], reach), strict=True
    ):
        np.testing.assert_array_equal(part[halo(reach) : -halo(reach), halo(reach) : -halo(reach)], whole[inner, inner])


def test_no_reach_is_refused():
    grey, mask = street()
    with pytest.raises(ValueError, match="reach must be 1"):
        bordered(grey, mask, reach=0)
