"""Nevatia & Babu: masks, edge elements, links and chains against brute force, and on drawn shapes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.nevatia_babu import nevatia_babu as naive
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.network.tracing import COLUMN_STEP, ROW_STEP
from tilepipe_kernels.nevatia_babu.elements import count_magnitudes, thin_edges, threshold_from_histogram
from tilepipe_kernels.nevatia_babu.links import (
    NO_LINK,
    PREDECESSOR,
    SECOND_PREDECESSOR,
    SECOND_SUCCESSOR,
    SUCCESSOR,
    EdgeElements,
    find_elements,
    halo,
    join_elements,
    link_elements,
)
from tilepipe_kernels.nevatia_babu.masks import MASKS, NO_DIRECTION, STEP_RESPONSE, edge_responses
from tilepipe_kernels.nevatia_babu.tracing import trace_chains
from tilepipe_kernels.polylines.end_point_fit import fit_polylines


def scene(rows: int, columns: int, seed: int, levels: int, missing: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    blobs = np.kron(random.integers(0, levels, (rows // 5 + 1, columns // 5 + 1)), np.ones((5, 5)))[:rows, :columns]
    image = (blobs + (random.random((rows, columns)) < 0.1) * random.integers(0, levels, (rows, columns))).astype("f4")
    image[random.random(image.shape) < missing] = np.nan
    return image


SCENES = st.builds(
    scene,
    st.integers(1, 30),
    st.integers(1, 40),
    st.integers(0, 9999),
    st.sampled_from([2, 3, 256]),
    st.sampled_from([0.0, 0.003, 0.5]),
)


def half_plane(angle: float, size: int = 31) -> np.ndarray:
    """Edge through the middle, 100 brighter in the direction of the angle, its border pixels in proportion."""
    rows, columns = np.mgrid[:size, :size] - size // 2
    across = columns * np.cos(np.radians(angle)) - rows * np.sin(np.radians(angle))
    return (100 * np.clip(across + 0.3, 0, 1)).astype(np.float32)


def tiles(image: np.ndarray, size: int, threshold: float) -> list[EdgeElements]:
    padded = np.pad(image, halo(), constant_values=np.nan)
    tables = []
    for top in range(0, image.shape[0], size):
        for left in range(0, image.shape[1], size):
            height, width = min(size, image.shape[0] - top), min(size, image.shape[1] - left)
            block = padded[top : top + height + 2 * halo(), left : left + width + 2 * halo()]
            core = halo(), halo() + height, halo(), halo() + width
            tables.append(
                find_elements(block, threshold, core, (top - halo(), left - halo()), image.shape[1]),
            )
    return tables


# ------------------------------------------------------------------------------------------------- elements


def test_masks_are_what_the_paper_says_of_them() -> None:
    assert not MASKS.sum(axis=(1, 2)).any()
    np.testing.assert_array_equal(MASKS[:, ::-1, ::-1], -MASKS)
    assert set(np.unique(np.abs(MASKS))) == {0, 32, 78, 92, 100}
    np.testing.assert_array_equal(MASKS[3], np.rot90(MASKS[0]))
    for k in range(1, 6):
        # Mirrored left to right 30° k becomes 180° - 30° k; turned by 90° counterclockwise it becomes 30° (k + 3).
        np.testing.assert_array_equal(MASKS[6 - k], MASKS[k][:, ::-1])
        np.testing.assert_array_equal(np.rot90(MASKS[k]), MASKS[k + 3] if k < 3 else -MASKS[k - 3])


@settings(max_examples=100, deadline=None)
@given(SCENES, st.sampled_from([0.0, 900.0]))
def test_elements_are_those_of_brute_force(image: np.ndarray, threshold: float) -> None:
    magnitude, direction = edge_responses(image)
    expected = naive.responses(image)
    assert {tuple(p) for p in np.argwhere(np.isfinite(magnitude))} == set(expected)
    for pixel, (size, k) in expected.items():
        assert magnitude[pixel] == size
        assert direction[pixel] == (NO_DIRECTION if k is None else k)
    assert (direction[np.isnan(magnitude)] == NO_DIRECTION).all()
    elements = thin_edges(magnitude, direction, threshold)
    expected_elements = naive.thin(expected, threshold)
    assert [tuple(p) for p in np.argwhere(elements != NO_DIRECTION)] == list(expected_elements)
    assert all(elements[pixel] == k for pixel, (_, k) in expected_elements.items())


@pytest.mark.parametrize("k", range(12))
def test_a_step_edge_answers_in_its_direction(k: int) -> None:
    image = half_plane(30 * k)
    magnitude, direction = edge_responses(image)
    elements = thin_edges(magnitude, direction)
    assert set(np.unique(elements)) == {k, NO_DIRECTION}
    rows, columns = np.nonzero(elements == k)
    offset = (columns - 15) * np.cos(np.radians(30 * k)) - (rows - 15) * np.sin(np.radians(30 * k))
    assert abs(offset).max() < 1.2
    assert len(rows) >= 23
    np.testing.assert_allclose(magnitude[rows, columns], 100 * STEP_RESPONSE, rtol=0.15)


def test_a_plain_edge_of_two_levels_is_one_pixel_wide() -> None:
    image = np.repeat(np.repeat([[0, 1]], 12, axis=1), 24, axis=0)
    for turned in (image, image[:, ::-1], image.T, image.T[::-1]):
        magnitude, direction = edge_responses(turned)
        elements = thin_edges(magnitude, direction)
        assert np.nanmax(magnitude) == STEP_RESPONSE
        assert (elements != NO_DIRECTION).sum() == 20


def test_no_edge_where_nodata_lies_under_the_masks() -> None:
    image = half_plane(30)
    image[15, 15] = np.nan
    image[3, 3] = np.inf
    magnitude, direction = edge_responses(image)
    for row, column in ((15, 15), (3, 3)):
        near = np.s_[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        assert np.isnan(magnitude[near]).all()
        assert (direction[near] == NO_DIRECTION).all()
    assert np.isfinite(magnitude[2:-2, 2:-2]).sum() == 27 * 27 - 25 - 16


# ------------------------------------------------------------------------------------------------- links, chains


def links_by_pixel(table: EdgeElements) -> dict[tuple[int, int], tuple[list[Any], list[Any]]]:
    found = {}
    for pixel, links in zip(table.pixel, table.links, strict=True):
        row, column = (int(part) for part in divmod(pixel, table.width))
        ends = [(row + int(ROW_STEP[k]), column + int(COLUMN_STEP[k])) if k != NO_LINK else None for k in links]
        before, after = ends[PREDECESSOR : SECOND_PREDECESSOR + 1], ends[SUCCESSOR : SECOND_SUCCESSOR + 1]
        found[row, column] = [p for p in before if p], [p for p in after if p]
    return found


def assert_linked_and_traced_as_by_brute_force(magnitude: np.ndarray, elements: np.ndarray) -> None:
    table = link_elements(magnitude, elements)
    expected = {
        (int(r), int(c)): (float(magnitude[r, c]), int(elements[r, c]))
        for r, c in np.argwhere(elements != NO_DIRECTION)
    }
    links = naive.link(expected)
    assert links_by_pixel(table) == links
    chains = trace_chains(table)
    lines = chains.polylines(table)
    found = [(int(k), [(int(r), int(c)) for r, c in line]) for k, line in zip(chains.stage, lines, strict=True)]
    assert found == naive.trace(links)


def swirl(rows: int, columns: int) -> np.ndarray:
    """Directions outward from the middle, so that elements run round it."""
    i, j = np.mgrid[:rows, :columns]
    return np.arctan2(rows / 2 - i, j - columns / 2) * 6 / np.pi


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 9999), st.sampled_from([0.2, 0.5, 0.9]), st.sampled_from([1, 2, 12]), st.booleans())
def test_links_and_chains_are_those_of_brute_force(seed: int, part: float, spread: int, rings: bool) -> None:
    random = np.random.default_rng(seed)
    shape = random.integers(1, 13, 2)
    turn = swirl(*shape) if rings else np.full(shape, random.integers(12))
    elements = ((turn + random.integers(0, spread, turn.shape)) % 12).astype(np.uint8)
    elements[random.random(turn.shape) >= part] = NO_DIRECTION
    assert_linked_and_traced_as_by_brute_force(random.integers(1, 4, turn.shape).astype(np.float32), elements)


@pytest.mark.parametrize("rows", range(6, 13))
def test_rings_are_traced_before_what_leads_into_them(rows: int) -> None:
    random = np.random.default_rng(rows)
    for columns in range(3, 13):
        magnitude = random.integers(1, 4, (rows, columns)).astype(np.float32)
        assert_linked_and_traced_as_by_brute_force(magnitude, (swirl(rows, columns) % 12).astype(np.uint8))


@settings(max_examples=40, deadline=None)
@given(SCENES, st.integers(1, 17), st.booleans())
def test_tiles_give_the_table_of_the_whole_raster(image: np.ndarray, size: int, fractions: bool) -> None:
    if fractions:
        image = image * np.float32(0.1)
    parts = tiles(image, size, 50.0)
    joined, whole = join_elements(parts[::-1]), find_elements(image, 50.0)
    for name in ("pixel", "direction", "magnitude", "links"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    one, other = trace_chains(joined), trace_chains(whole)
    np.testing.assert_array_equal(one.members, other.members)
    np.testing.assert_array_equal(one.offsets, other.offsets)


@settings(max_examples=40, deadline=None)
@given(SCENES)
def test_the_negative_image_has_the_same_elements_run_backward(image: np.ndarray) -> None:
    table, negative = find_elements(image, 50.0), find_elements(-image, 50.0)
    np.testing.assert_array_equal(table.pixel, negative.pixel)
    np.testing.assert_array_equal(table.direction, (negative.direction + 6) % 12)
    np.testing.assert_array_equal(table.links, negative.links[:, [2, 3, 0, 1]])


def disc(radius: float, size: int) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size] - size / 2 + 0.25
    return (200 * np.clip(radius - np.hypot(rows, columns) + 0.5, 0, 1)).astype(np.float32)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_disc_is_one_closed_ring(sign: int) -> None:
    table = find_elements(sign * disc(20, 60), 20000)
    chains = trace_chains(table)
    assert len(chains) == 1
    assert chains.stage[0] == 3
    assert chains.members[0] == chains.members[-1]
    assert len(chains.members) == len(table) + 1
    assert abs(np.diff(chains.polylines(table).vertices, axis=0)).max() == 1
    rows, columns = (chains.polylines(table).vertices - 29.75).T
    area = (rows[:-1] * columns[1:] - rows[1:] * columns[:-1]).sum() / 2
    # Bright side on the left: counterclockwise round a bright disc, that is negative with rows downward.
    assert area * sign > 0.9 * np.pi * 400
    line = fit_polylines(chains.polylines(table), 1.0)
    assert line.closed.tolist() == [True]
    assert 8 <= line.sizes[0] <= 20
    assert line.lengths()[0] == pytest.approx(2 * np.pi * 20, rel=0.05)
    assert chains.mean_magnitudes(table)[0] == pytest.approx(table.magnitude.mean(), rel=0.01)


@pytest.mark.parametrize("turn", [5, 17, 40])
def test_the_sides_of_a_square_become_straight_lines(turn: int) -> None:
    rows, columns = np.mgrid[:120, :120] - 60
    sides = [columns * np.cos(a) - rows * np.sin(a) for a in np.radians(turn + np.arange(0, 360, 90))]
    image = (100 * np.clip(40.25 - np.max(sides, axis=0), 0, 1)).astype(np.float32)
    table = find_elements(image, 50000)
    chains = trace_chains(table)
    lines = [np.hypot(*np.diff(line, axis=0).T) for line in fit_polylines(chains.polylines(table), 1.5)]
    long = [length for line in lines for length in line if length > 15]
    # The masks cut the corners of a square off.
    assert len(long) == 4
    assert all(68 <= length <= 81 for length in long), long


def test_lone_elements_form_no_chain_and_a_lost_neighbour_is_named() -> None:
    elements = np.full((4, 4), NO_DIRECTION, np.uint8)
    elements[1, 1] = 3
    magnitude = np.ones((4, 4), np.float32)
    chains = trace_chains(link_elements(magnitude, elements))
    assert (len(chains), chains.members.size) == (0, 0)
    assert chains.mean_magnitudes(link_elements(magnitude, elements)).size == 0
    assert len(fit_polylines(chains.polylines(link_elements(magnitude, elements)), 1)) == 0
    elements[1, 2] = 3
    left = link_elements(magnitude, elements, (0, 4, 0, 2), width=4)
    assert len(left) == 1
    with pytest.raises(ValueError, match=r"pixel \(1, 1\) leads to no edge element"):
        trace_chains(left)


# ------------------------------------------------------------------------------------------------- threshold, fit


def test_histograms_of_tiles_add_up_and_give_thresholds() -> None:
    random = np.random.default_rng(3)
    image = random.normal(0, 2, (90, 110)) + np.where(np.mgrid[:90, :110][1] > 50, 100, 0)
    magnitude, direction = edge_responses(image)
    elements = thin_edges(magnitude, direction)
    halves = [count_magnitudes(magnitude[part], elements[part]) for part in (np.s_[:40], np.s_[40:])]
    counts = count_magnitudes(magnitude, elements)
    np.testing.assert_array_equal(halves[0] + halves[1], counts)
    strengths = magnitude[elements != NO_DIRECTION]
    kept = (strengths > threshold_from_histogram(counts, share=0.25)).mean()
    assert kept == pytest.approx(0.25, abs=0.02)
    corner = threshold_from_histogram(counts)
    assert (strengths > corner).sum() == pytest.approx(86, abs=10)
    with pytest.raises(ValueError, match="no edge element was counted"):
        threshold_from_histogram(np.zeros_like(counts))
    with pytest.raises(ValueError, match="share is 2"):
        threshold_from_histogram(counts, share=2)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 9999), st.sampled_from([0.0, 0.5, 1.0, 3.0]), st.booleans())
def test_no_vertex_is_farther_from_its_straight_line_than_the_tolerance(seed: int, limit: float, closed: bool) -> None:
    random = np.random.default_rng(seed)
    line = np.stack([random.integers(-2, 3, 40).cumsum(), np.arange(40)], axis=1)[: random.integers(4, 40)]
    line = np.concatenate([line, line[:1]]) if closed else line
    (vertices,) = fit_polylines(Polylines(np.array([0, len(line)]), line), limit)
    np.testing.assert_array_equal(vertices[[0, -1]], line[[0, -1]])
    # All vertices differ but the two ends of a ring: each is found where it was.
    places = [int(np.flatnonzero((line == vertex).all(axis=1))[0]) for vertex in vertices[:-1]] + [len(line) - 1]
    assert places == sorted(set(places))
    farthest = [
        shapely.distance(shapely.LineString(line[[one, other]]), shapely.points(line[one : other + 1])).max()
        for one, other in pairwise(places)
    ]
    assert max(farthest) <= limit + 1e-12
    assert limit > 0 or len(vertices) == len(line)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: edge_responses(np.zeros(3)), "block has shape"),
        (lambda: thin_edges(np.zeros((3, 3), np.float32), np.zeros((3, 4), np.uint8)), "equal shape"),
        (lambda: thin_edges(np.zeros((3, 3)), np.zeros((3, 3), np.uint8)), "must be float32"),  # type: ignore[arg-type]
        (lambda: thin_edges(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.uint8), -1), "threshold is -1"),
        (lambda: find_elements(np.zeros((9, 9)), 0, core=(0, 10, 0, 9)), "not a window"),
        (lambda: find_elements(np.zeros((9, 9)), 0, origin=(-1, 0)), "outside a raster"),
        (lambda: join_elements([]), "no edge elements to join"),
        (lambda: join_elements([find_elements(half_plane(0), 0)] * 2), "stands in two tables"),
        (lambda: join_elements([find_elements(np.eye(k), 0) for k in (5, 6)]), "different width"),
        (lambda: fit_polylines(Polylines(np.array([0, 1]), np.zeros((1, 2))), 1), "fewer than two vertices"),
        (lambda: fit_polylines(Polylines(np.array([0, 2]), np.zeros((2, 2))), -1), "tolerance"),
    ],
)
def test_bad_input_is_named(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
