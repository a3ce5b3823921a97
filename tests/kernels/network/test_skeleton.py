"""Distance, medial axis, links and morphology of masks: against oracles, and whole against sub-block."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage
from skimage import morphology as reference

from tests.naive.network import skeleton as naive
from tilepipe_kernels.image import distance, morphology
from tilepipe_kernels.network import skeleton
from tilepipe_kernels.network.neighbours import IS_SIMPLE, NEIGHBOURS

Mask = NDArray[np.bool_]


def random_mask(seed: int, shape: tuple[int, int], sigma: float = 1.5, level: float = 0.0) -> Mask:
    noise = np.random.default_rng(seed).normal(size=shape)
    field = ndimage.gaussian_filter(noise, sigma) if sigma else noise
    return np.asarray(field > level * field.std())


def street(shape: tuple[int, int], degrees: float, width: float, through: tuple[float, float]) -> Mask:
    row, column = np.indices(shape)
    turn = np.radians(degrees)
    across = (row - through[0]) * np.cos(turn) - (column - through[1]) * np.sin(turn)
    return np.asarray(np.abs(across) <= width / 2)


def ring(shape: tuple[int, int], centre: tuple[float, float], radius: float, width: float) -> Mask:
    row, column = np.indices(shape)
    return np.asarray(np.abs(np.hypot(row - centre[0], column - centre[1]) - radius) <= width / 2)


def town(size: int) -> Mask:
    """Streets in several directions, longer than three halos of cap 4, a ring, a yard and noisy edges."""
    shape = (size, size)
    mask = street(shape, 0, 7, (size * 0.3, 0)) | street(shape, 90, 6, (0, size * 0.45))
    mask |= street(shape, 45, 5, (size * 0.5, size * 0.5)) | street(shape, 17, 4, (size * 0.8, 0))
    mask |= ring(shape, (size * 0.7, size * 0.3), size * 0.15, 6)
    mask |= ring(shape, (size * 0.2, size * 0.8), 0, 34)
    mask[5, :] = mask[size - 30 : size - 28, :] = True
    return mask


MASKS: dict[str, Callable[[], Mask]] = {
    "town": lambda: town(150),
    "town with noise": lambda: town(150) ^ random_mask(1, (150, 150), 0.8, 2.0),
    "blobs": lambda: random_mask(2, (150, 150), 3.0),
    "speckle": lambda: random_mask(3, (150, 150), 0),
    "dense speckle": lambda: random_mask(4, (150, 150), 0, -1.2),
    "full": lambda: np.ones((150, 150), bool),
}


# --- distance


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 14), st.integers(1, 14), st.integers(1, 6), st.floats(-2, 1))
def test_nearest_background_is_brute_force_with_its_ties(
    seed: int, rows: int, columns: int, cap: int, level: float
) -> None:
    mask = random_mask(seed, (rows, columns), 0, level)
    expected = naive.nearest_background(mask, cap)
    for found, wanted in zip(distance.nearest_background(mask, cap), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(distance.distance_squared(mask, cap), expected[0])


def test_distance_agrees_with_scipy_and_opencv() -> None:
    mask = random_mask(0, (200, 260), 4.0)
    squared = distance.distance_squared(mask, 100)
    assert squared.max() <= 100**2
    scipy = ndimage.distance_transform_edt(mask)
    np.testing.assert_array_equal(squared, np.rint(scipy**2))
    opencv = cv2.distanceTransform(mask.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.testing.assert_allclose(np.sqrt(squared), opencv, rtol=1e-5)


def test_array_border_is_neither_foreground_nor_background() -> None:
    assert (distance.distance_squared(np.ones((5, 7), bool), 3) == 10).all()
    assert (distance.distance_squared(np.zeros((5, 7), bool), 3) == 0).all()


# --- medial axis


def test_tables_match_the_definition_on_all_neighbourhoods() -> None:
    for code in range(256):
        neighbours = tuple(code >> k & 1 for k in range(8))
        assert IS_SIMPLE[code] == naive.is_simple(neighbours), neighbours


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6), st.floats(0, 2.5), st.integers(1, 6), st.floats(0, 6), st.floats(0, 170),
    st.tuples(st.integers(-3, 3), st.integers(-3, 3)),
)  # fmt: skip
def test_medial_axis_is_the_literal_algorithm(
    seed: int, sigma: float, cap: int, separation: float, angle: float, origin: tuple[int, int]
) -> None:
    mask = random_mask(seed, (17, 20), sigma, -0.3)
    expected = naive.medial_axis(mask, cap, separation, angle, origin, skeleton.CLEANING_SWEEPS)
    found = skeleton.medial_axis(mask, cap=cap, separation=separation, angle=angle, origin=origin)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", MASKS)
def test_topology_is_that_of_the_mask(name: str) -> None:
    mask = MASKS[name]()
    mask[0, 0] = False
    axis, squared = skeleton.medial_axis_and_distance(mask, cap=250)
    assert squared.max() <= 250**2
    assert not (axis & ~mask).any()
    assert naive.components(axis) == naive.components(mask)


@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("cap", [4, 9])
def test_with_its_yards_the_axis_has_the_topology_of_the_mask(name: str, cap: int) -> None:
    mask = MASKS[name]()
    axis, squared = skeleton.medial_axis_and_distance(mask, cap=cap)
    yards = squared > cap * cap
    assert not (axis & yards).any()
    assert naive.components(axis | yards) == naive.components(mask)


@pytest.mark.parametrize("name", MASKS)
def test_axis_is_one_pixel_thin(name: str) -> None:
    axis, squared = skeleton.medial_axis_and_distance(MASKS[name](), cap=9)
    yards = squared > 81
    for i, j in np.argwhere(axis):
        window = naive.window_of(axis | yards, i, j)
        assert not naive.is_simple(window) or sum(window) == 1, (i, j)


@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("cap", [2, 4])
def test_tiling_is_invisible_to_the_medial_axis(name: str, cap: int) -> None:
    mask = MASKS[name]()
    for separation, angle in ((5.0, 110.0), (1.0, 0.0), (20.0, 180.0)):
        whole = skeleton.medial_axis(mask, cap=cap, separation=separation, angle=angle)
        for core in ((40, 43, 64, 80), (75, 90, 76, 77), (0, 33, 101, 150), (61, 150, 0, 47)):
            block, inner = padded(core, skeleton.halo(cap), mask.shape)
            origin = block[0].start, block[1].start
            part = skeleton.medial_axis(mask[block], cap=cap, separation=separation, angle=angle, origin=origin)
            np.testing.assert_array_equal(part[inner], whole[core[0] : core[1], core[2] : core[3]])


def padded(core: tuple[int, int, int, int], halo: int, shape: tuple[int, ...]) -> tuple[Any, Any]:
    """Slices of a core's padded block in the whole, and of the core in that block."""
    top, bottom, left, right = core
    first_row, first_column = max(0, top - halo), max(0, left - halo)
    block = (
        slice(first_row, min(shape[0], bottom + halo)),
        slice(first_column, min(shape[1], right + halo)),
    )
    inner = (
        slice(top - first_row, bottom - first_row),
        slice(left - first_column, right - first_column),
    )
    return block, inner


def test_thinning_reaches_farther_than_the_distance_but_not_than_the_halo() -> None:
    cap, turn = 8, np.radians(-3)
    row, column = np.indices((120, 120)) - np.array([60, 20])[:, None, None]
    along, across = column * np.cos(turn) + row * np.sin(turn), row * np.cos(turn) - column * np.sin(turn)
    wedge = (np.abs(across) <= 1 + along / 2) & (along >= 0) & (along < 14)
    wedge |= np.hypot(along - 30, across) < 17.6
    # a wedge is peeled from its tip up to the yard at its base, unless the tip is held by another yard
    held = wedge | (np.hypot(along + 16, across) < 17.6)
    free_axis, held_axis = (skeleton.medial_axis(mask, cap=cap, separation=99) for mask in (wedge, held))
    changed = np.argwhere(wedge != held)
    reach = max(np.abs(changed - pixel).max(1).min() for pixel in np.argwhere(free_axis != held_axis))
    assert distance.halo(cap) + 1 < reach <= skeleton.halo(cap)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 10**6), st.sampled_from([0, 1.0, 2.0, 4.0]), st.floats(-1.5, 1), st.integers(1, 4),
    st.integers(0, 109), st.integers(0, 109), st.integers(1, 40), st.integers(1, 40),
)  # fmt: skip
def test_tiling_is_invisible_anywhere(
    seed: int, sigma: float, level: float, cap: int, top: int, left: int, rows: int, columns: int
) -> None:
    mask = random_mask(seed, (110, 110), sigma, level)
    core = top, min(110, top + rows), left, min(110, left + columns)
    here = (slice(core[0], core[1]), slice(core[2], core[3]))
    block, inner = padded(core, skeleton.halo(cap), mask.shape)
    axis = skeleton.medial_axis(mask[block], cap=cap, origin=(block[0].start, block[1].start))
    np.testing.assert_array_equal(axis[inner], skeleton.medial_axis(mask, cap=cap)[here])
    block, inner = padded(core, distance.halo(cap), mask.shape)
    for part, whole in zip(
        distance.nearest_background(mask[block], cap), distance.nearest_background(mask, cap), strict=True
    ):
        np.testing.assert_array_equal(part[inner], whole[here])
    block, inner = padded(core, morphology.halo(cap), mask.shape)
    for clean in (morphology.open_mask, morphology.close_mask):
        np.testing.assert_array_equal(clean(mask[block], cap)[inner], clean(mask, cap)[here])
    block, inner = padded(core, morphology.speck_halo(cap), mask.shape)
    np.testing.assert_array_equal(
        morphology.fill_specks(mask[block], cap)[inner], morphology.fill_specks(mask, cap)[here]
    )


@pytest.mark.parametrize("degrees", [0, 17, 45, 63, 90, 141])
@pytest.mark.parametrize("width", [6, 9.5, 13])
def test_axis_of_a_street_is_centred_and_runs_off_the_raster(degrees: float, width: float) -> None:
    shape, through = (120, 130), (60.3, 64.8)
    axis, squared = skeleton.medial_axis_and_distance(street(shape, degrees, width, through), cap=12)
    inside = np.zeros(shape, bool)
    inside[15:-15, 15:-15] = True
    row, column = np.nonzero(axis & inside)
    turn = np.radians(degrees)
    assert np.abs((row - through[0]) * np.cos(turn) - (column - through[1]) * np.sin(turn)).max() < 1.1
    assert len(row) <= 1.06 * (max(np.ptp(row), np.ptp(column)) + 1)
    border = axis & street(shape, degrees, 3, through)
    border[1:-1, 1:-1] = False
    assert np.ptp(np.argwhere(border), axis=0).max() >= 100
    assert abs(skeleton.width_at(squared[axis & inside]).mean() - width) < 1.1


def test_width_has_no_bias_over_directions() -> None:
    random = np.random.default_rng(0)
    errors = []
    for width in np.linspace(5.2, 14.8, 40):
        mask = street((90, 90), random.uniform(0, 180), width, tuple(44 + random.uniform(0, 1, 2)))
        axis, squared = skeleton.medial_axis_and_distance(mask, cap=10)
        inside = axis.copy()
        inside[:15] = inside[-15:] = inside[:, :15] = inside[:, -15:] = False
        errors.append(skeleton.width_at(squared[inside]).mean() - width)
    assert abs(np.mean(errors)) < 0.15
    assert np.abs(errors).max() < 1.1


@pytest.mark.parametrize(
    "mask",
    [
        street((100, 100), 30, 11, (50, 50)),
        street((100, 100), 30, 11, (50, 50)) | street((100, 100), 105, 9, (50, 50)),
        ring((100, 100), (50, 50), 30, 9),
        np.pad(np.ones((60, 9), bool), 20),
    ],
    ids=["street", "crossing", "ring", "bar"],
)
def test_axis_is_near_the_medial_axis_of_scikit_image(mask: Mask) -> None:
    ours = skeleton.medial_axis(mask, cap=20)
    theirs = reference.medial_axis(mask, rng=0)
    for _ in range(12):  # short branches
        window = ndimage.convolve(theirs.astype(int), np.ones((3, 3), int), mode="constant")
        theirs &= window > 2
    inside = np.zeros(mask.shape, bool)
    inside[15:-15, 15:-15] = True
    assert ndimage.distance_transform_edt(~reference.medial_axis(mask, rng=0))[ours & inside].max() <= 1.5
    assert ndimage.distance_transform_edt(~ours)[theirs & inside].max() <= 1.5


def test_square_corners_and_ragged_edges_make_no_branches() -> None:
    bar = np.pad(np.ones((60, 9), bool), 20)
    ragged = bar.copy()
    ragged[22:78:6, 19] = ragged[25:78:9, 28] = True
    for mask in (bar, ragged):
        degrees = np.bitwise_count(skeleton.skeleton_links(skeleton.medial_axis(mask, cap=10)))
        assert (degrees == 1).sum() == 2
        assert degrees.max() == 2


def test_narrow_street_keeps_its_length() -> None:
    mask = np.zeros((30, 80), bool)
    mask[14:17, 5:75] = True
    axis = skeleton.medial_axis(mask, cap=10, separation=7)
    assert 60 <= axis.sum() <= 70
    assert set(np.nonzero(axis)[0]) == {15}


def test_yard_is_dropped_and_streets_end_at_it() -> None:
    mask = ring((81, 121), (40, 40), 0, 61)
    mask[38:43, 40:] = True
    axis = skeleton.medial_axis(mask, cap=10)
    assert ndimage.label(axis, naive.EIGHT)[1] == 1
    row, column = np.nonzero(axis)
    assert column.max() == 120
    assert abs(column.min() - (40 + 31 - 10)) <= 2
    assert np.abs(row - 40).max() <= 1


# --- links


@pytest.mark.parametrize("name", MASKS)
def test_links_are_mixed_adjacency(name: str) -> None:
    axis = skeleton.medial_axis(MASKS[name](), cap=9)
    links = skeleton.skeleton_links(axis)
    np.testing.assert_array_equal(links, naive.links(axis))
    for k, (row, column) in enumerate(NEIGHBOURS):
        there = np.roll(links, (-row, -column), (0, 1))
        assert not ((links >> k & 1) & ~(there >> (k + 4) % 8 & 1)).any()


def test_links_of_a_bend_make_no_triangle() -> None:
    bend = np.array([[1, 1], [0, 1]], bool)
    np.testing.assert_array_equal(skeleton.skeleton_links(bend), [[1 << 3, 1 << 7 | 1 << 5], [0, 1 << 1]])
    assert naive.links(bend).tolist() == [[8, 160], [0, 2]]


# --- morphology


@pytest.mark.parametrize("radius", [0, 1, 1.5, 2, 3.7, 5])
def test_open_and_close_are_those_of_scipy(radius: float) -> None:
    mask = random_mask(5, (70, 80), 1.5)
    reach = 2 * int(np.ceil(radius))
    inside = (slice(reach, -reach or None), slice(reach, -reach or None))
    disc = naive.disc(radius)
    opened = ndimage.binary_opening(mask, disc)
    closed = ndimage.binary_closing(mask, disc)
    np.testing.assert_array_equal(morphology.open_mask(mask, radius)[inside], opened[inside])
    np.testing.assert_array_equal(morphology.close_mask(mask, radius)[inside], closed[inside])
    np.testing.assert_array_equal(morphology.close_mask(mask, radius), ~morphology.open_mask(~mask, radius))


@pytest.mark.parametrize("size", [1, 2, 4, 9])
def test_fill_specks_fills_holes_by_their_box(size: int) -> None:
    mask = random_mask(6, (60, 70), 0.7, -0.5)
    filled = morphology.fill_specks(mask, size)
    np.testing.assert_array_equal(filled, naive.fill_specks(mask, size))
    assert (filled != mask).any()


# --- inputs


def test_bad_input_is_refused_in_one_line() -> None:
    mask = np.ones((4, 4), bool)
    for call in (
        lambda: distance.distance_squared(mask[0], 3),
        lambda: distance.distance_squared(mask.astype(float), 3),
        lambda: distance.distance_squared(mask, 0),
        lambda: distance.distance_squared(mask, 2.5),  # type: ignore[arg-type]
        lambda: skeleton.medial_axis(mask, cap=3, separation=-1),
        lambda: skeleton.medial_axis(mask, cap=3, angle=200),
        lambda: morphology.open_mask(mask, -1),
        lambda: morphology.open_mask(mask, float("nan")),
        lambda: morphology.fill_specks(mask, 0),
    ):
        with pytest.raises(ValueError, match=r"^[^\n]+$"):
            call()


def test_any_integer_mask_is_taken_and_left_alone() -> None:
    mask = (town(60) * 7).astype(np.int16)[:, ::2]
    before = mask.copy()
    np.testing.assert_array_equal(skeleton.medial_axis(mask, cap=9), skeleton.medial_axis(mask != 0, cap=9))
    np.testing.assert_array_equal(mask, before)
    assert skeleton.medial_axis(np.zeros((0, 5), bool), cap=3).shape == (0, 5)
