"""What tiles count adds up to what the whole raster counts, whatever the tiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilepipe.tiling.grid import TileGrid
from tilepipe.tiling.histograms import added, as_facts
from tilepipe.tiling.noise import count_differences, noise
from tilepipe.tiling.numbering import Numbering
from tilepipe_kernels.image.histogram import histogram

sides = st.integers(1, 23)


@given(rows=sides, columns=sides, halo=st.integers(1, 3), seed=st.integers(0, 99))
def test_differences_of_every_fourth_row(rows, columns, halo, seed):
    image = np.random.default_rng(seed).normal(0, 50, (21, 22)).astype(np.float32)
    image[3:6, 4:7] = np.nan
    expected = histogram(np.abs(np.diff(image[::4], axis=1)))
    grid = TileGrid(image.shape, (rows, columns))
    total = sum(count_differences(image[tile.padded.slices], tile) for tile in grid.tiles(halo))
    assert np.array_equal(total, expected)


def test_noise_is_that_of_a_normal_distribution():
    image = np.random.default_rng(0).normal(100, 7, (400, 400)).astype(np.float32)
    counts = count_differences(image, TileGrid(image.shape, image.shape).tile(0, halo=1))
    assert noise(counts) == pytest.approx(7, rel=0.02)
    assert noise(counts * 0) == 0


@given(rows=sides, columns=sides, seed=st.integers(0, 99))
def test_histograms(rows, columns, seed):
    image = np.random.default_rng(seed).integers(-9, 99, (21, 22)).astype(np.float32)
    facts = [
        as_facts({"a": histogram(image[tile.core.slices]), "b": histogram(-image[tile.core.slices])})
        for tile in TileGrid(image.shape, (rows, columns)).tiles()
    ]
    assert np.array_equal(added(facts, "a"), histogram(image))
    assert np.array_equal(added(reversed(facts), "b"), histogram(-image))
    assert all((each["a:counts"] > 0).all() for each in facts)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=9))
def test_numbers_of_tiles_are_laid_end_to_end(counts):
    numbering = Numbering.of_counts(np.array(counts))
    found = [numbering.globalise(tile, np.arange(1, count + 1)) for tile, count in enumerate(counts)]
    assert np.concatenate(found).tolist() == list(range(sum(counts)))
    assert numbering.total == sum(counts)
    assert numbering.globalise(0, np.array([0, 0])).tolist() == [-1, -1]
