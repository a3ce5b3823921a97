"""Nevatia & Babu's edge elements and their links on the device: the very bits of the CPU, and those of brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.nevatia_babu import nevatia_babu as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.nevatia_babu.elements import count_magnitudes, thin_edges
from tilepipe_kernels.nevatia_babu.links import EdgeElements, find_elements, link_elements
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION, edge_responses

COLUMNS = ("pixel", "direction", "magnitude", "links")


def scene(rows: int, columns: int, seed: int, levels: int, missing: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    blobs = np.kron(random.integers(0, levels, (rows // 5 + 1, columns // 5 + 1)), np.ones((5, 5)))[:rows, :columns]
    image = (blobs + random.random((rows, columns))).astype(np.float32)
    image[random.random(image.shape) < missing] = np.nan
    return image


SCENES = st.builds(
    scene,
    st.integers(1, 13),
    st.integers(1, 14),
    st.integers(0, 9999),
    st.sampled_from([2, 256]),
    st.sampled_from([0.0, 0.01]),
)


def assert_same_table(found: EdgeElements, expected: EdgeElements) -> None:
    assert found.width == expected.width
    for name in COLUMNS:
        here, there = getattr(found, name), getattr(expected, name)
        assert on_device(here)
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(to_host(here), there, name)


@settings(max_examples=12)
@given(SCENES, st.sampled_from([0.0, 300.0]))
def test_responses_elements_and_counts_are_the_bits_of_the_cpu(image: np.ndarray, threshold: float) -> None:
    magnitude, direction = edge_responses(image)
    found_magnitude, found_direction = edge_responses(to_device(image))
    assert on_device(found_magnitude, found_direction)
    np.testing.assert_array_equal(to_host(found_magnitude).view(np.uint32), magnitude.view(np.uint32))
    np.testing.assert_array_equal(to_host(found_direction), direction)
    elements = thin_edges(magnitude, direction, threshold)
    found = thin_edges(found_magnitude, found_direction, threshold)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), elements)
    counts = count_magnitudes(found_magnitude, found)
    assert on_device(counts)
    np.testing.assert_array_equal(to_host(counts), count_magnitudes(magnitude, elements))


@settings(max_examples=15)
@given(SCENES)
def test_elements_of_whole_numbers_are_those_of_brute_force(image: np.ndarray) -> None:
    image = np.floor(image)
    magnitude, direction = edge_responses(to_device(image))
    expected = naive.thin(naive.responses(image), 0.0)
    elements = to_host(thin_edges(magnitude, direction))
    assert [tuple(p) for p in np.argwhere(elements != NO_DIRECTION)] == list(expected)
    assert all(elements[pixel] == k for pixel, (_, k) in expected.items())


@settings(max_examples=12)
@given(st.integers(0, 9999), st.sampled_from([0.3, 0.9]), st.sampled_from([1, 2, 12]))
def test_links_are_those_of_the_cpu(seed: int, part: float, spread: int) -> None:
    """Also of elements as dense as none are: all candidates, forks and ties."""
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 12, 2))
    elements = ((random.integers(12) + random.integers(0, spread, shape)) % 12).astype(np.uint8)
    elements[random.random(shape) >= part] = NO_DIRECTION
    magnitude = random.integers(1, 4, shape).astype(np.float32)
    core = (*sorted(random.integers(0, shape[0] + 1, 2)), *sorted(random.integers(0, shape[1] + 1, 2)))
    core = tuple(int(bound) for bound in core)
    place = core, (int(random.integers(50)), int(random.integers(50))), 1000
    found = link_elements(to_device(magnitude), to_device(elements), *place)
    assert_same_table(found, link_elements(magnitude, elements, *place))


@pytest.mark.parametrize("shape", [(20, 22), (4, 30)])
def test_the_table_of_an_image_is_that_of_the_cpu(shape: tuple[int, int]) -> None:
    image = scene(*shape, 7, 256, 0.002)
    core = (1, shape[0] - 1, 2, shape[1])
    expected = find_elements(image, 500.0, core, (30, 40), 100)
    assert (len(expected) > 10) == (shape[0] > 4)
    assert_same_table(find_elements(to_device(image), 500.0, core, (30, 40), 100), expected)


def test_arrays_of_host_and_device_do_not_mix() -> None:
    magnitude, direction = edge_responses(scene(9, 9, 0, 2, 0.0))
    with pytest.raises(TypeError, match="mixed"):
        thin_edges(to_device(magnitude), direction)
    with pytest.raises(TypeError, match="mixed"):
        link_elements(magnitude, to_device(direction))
