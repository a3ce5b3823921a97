"""The functions that a procedural city is made of are what they say, whatever the window."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe_kernels.city.chart import chart, positions
from tilepipe_kernels.city.hashing import mixed
from tilepipe_kernels.city.intensity import speckle_table
from tilepipe_kernels.city.layout import city_layout
from tilepipe_kernels.city.noise import texture, white
from tilepipe_kernels.city.scene import scene
from tilepipe_kernels.city.voids import find_voids

CITY = city_layout(3, (300, 260), 0.5)
WHOLE = (0, 0, 300, 260)


def test_the_hash_is_splitmix64():
    # the first numbers of the reference implementation from the state 1234567
    state, golden = 1234567, 0x9E3779B97F4A7C15
    numbers = [int(mixed(np.uint64((state + n * golden) % 2**64))) for n in range(3)]
    assert numbers == [6457827717110365317, 3203168211198807973, 9817491932198370423]


def test_positions_have_the_coordinates_that_were_asked_for():
    coordinates = np.random.default_rng(0).uniform(-2000, 2000, (50, 2))
    found = [chart(CITY, x, y)[:2] for x, y in positions(CITY, coordinates)]
    np.testing.assert_allclose(found, coordinates, atol=1e-8)


@pytest.mark.parametrize("window", [(17, 31, 40, 50), (299, 0, 1, 260), (0, 259, 7, 1)])
def test_a_window_is_a_part_of_the_whole(window):
    row, column, rows, columns = window
    inside = np.s_[row : row + rows, column : column + columns]
    for function in (
        lambda window: texture(CITY, window, 3.5, 61),
        lambda window: white(CITY, window, 64),
        lambda window: find_voids(CITY, window),
        lambda window: scene(CITY, window).ground,
        lambda window: scene(CITY, window).top,
    ):
        np.testing.assert_array_equal(function(window), function(WHOLE)[inside])


def test_noise_and_speckle_have_their_moments():
    noise = white(CITY, WHOLE, 64)
    assert abs(noise.mean()) < 0.01 and abs(noise.std() - 1) < 0.01
    assert abs(texture(CITY, WHOLE, 3.5, 61)).max() <= 1
    assert np.all(speckle_table(0) == 1)
