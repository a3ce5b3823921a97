"""Grey levels, the region table, its contacts and the lookup of labels on the device, beside the CPU."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.image import grey_levels
from tilepipe_kernels.image.histogram import histogram
from tilepipe_kernels.regions import region_table
from tilepipe_kernels.regions.growing import grow_regions

RNG = np.random.default_rng(7)
VALUES = RNG.integers(0, 6, (19, 41)).astype(np.float32) * np.float32(1.3)
VALUES[RNG.random(VALUES.shape) < 0.05] = np.nan
LABELS = grow_regions(VALUES, 2.7, maximum=5)
COUNT = int(LABELS.max())


@pytest.mark.parametrize("borders", [(True, True, True, True), (False, True, False, True), (False,) * 4])
def test_region_table_is_the_same(borders: tuple[bool, bool, bool, bool]) -> None:
    expected = region_table.region_table(LABELS, np.nan_to_num(VALUES), COUNT, borders=borders)
    found = region_table.region_table(to_device(LABELS), to_device(np.nan_to_num(VALUES)), COUNT, borders=borders)
    for column in fields(expected):
        assert on_device(getattr(found, column.name))
        np.testing.assert_array_equal(to_host(getattr(found, column.name)), getattr(expected, column.name), column.name)


def test_contacts_are_the_same() -> None:
    flagged = np.arange(COUNT + 1) % 3 != 0
    expected = region_table.region_contacts(LABELS, flagged)
    assert len(expected) > 3
    found = region_table.region_contacts(to_device(LABELS), to_device(flagged))
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), expected)


def test_labels_are_looked_up_and_checked() -> None:
    lookup = RNG.permutation(COUNT + 1).astype(np.uint32)
    found = region_table.select_labels(to_device(LABELS), to_device(lookup))
    np.testing.assert_array_equal(to_host(found), lookup[LABELS])
    with pytest.raises(ValueError, match="no entry"):
        region_table.select_labels(to_device(LABELS), to_device(lookup[:-1]))


def test_grey_levels_are_the_same() -> None:
    stretched = grey_levels.stretch(VALUES, 1.0, 5.0)
    on_gpu = grey_levels.stretch(to_device(VALUES), 1.0, 5.0)
    np.testing.assert_array_equal(to_host(on_gpu), stretched)
    means = np.array([10.0, 60.0, 200.0])
    np.testing.assert_array_equal(
        to_host(grey_levels.to_levels(on_gpu, means)), grey_levels.to_levels(stretched, means)
    )
    mask, missing = LABELS > 0, np.isnan(VALUES)
    packed = grey_levels.store(stretched, missing)
    packed_there = grey_levels.store(on_gpu, to_device(missing))
    np.testing.assert_array_equal(to_host(packed_there), packed)
    ids = LABELS.astype(np.uint32)
    levels = {"dark": 20.0, "bright": 180.0, "threshold": 90.0}
    expected = grey_levels.street_image(mask, ids, packed, **levels)
    found = grey_levels.street_image(to_device(mask), to_device(ids), packed_there, **levels)
    np.testing.assert_array_equal(to_host(found), expected)


def test_histogram_is_the_same() -> None:
    values = np.concatenate([VALUES.ravel(), -VALUES.ravel(), np.zeros(3, np.float32), -np.zeros(2, np.float32)])
    found = histogram(to_device(values))
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), histogram(values))
