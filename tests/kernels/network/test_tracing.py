"""Fragments of a tile: against brute force on the whole raster, and on drawn cases."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.network.tracing import lines, links_of, neighbours
from tilepipe_kernels.network.skeleton import skeleton_links
from tilepipe_kernels.network.tracing import CROSSING, NODE, RING, trace


def drawing(text: str) -> np.ndarray:
    return np.array([[mark != "." for mark in line] for line in text.split()])


@st.composite
def pixel_graphs(draw: st.DrawFn) -> np.ndarray:
    """Random subsets of the links of a small raster: from lone dots to thick tangles."""
    shape = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mask = random.random(shape) < draw(st.sampled_from([0.2, 0.4, 0.6, 1.0]))
    if draw(st.booleans()):
        return skeleton_links(mask)
    graph = set()
    for row, column in np.argwhere(mask):
        for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
            r, c = row + down, column + right
            if r < shape[0] and 0 <= c < shape[1] and random.random() < 0.4:
                graph.add((int(row * shape[1] + column), int(r * shape[1] + c)))
    return links_of(graph, shape)


def chains(links: np.ndarray, **window: object) -> list[tuple[int, ...]]:
    fragments = trace(links, **window)
    return [tuple(chain.tolist()) for chain in np.split(fragments.pixels, fragments.offsets[1:-1])][: len(fragments)]


@settings(max_examples=150, deadline=None)
@given(pixel_graphs())
def test_whole_raster_gives_the_lines_of_brute_force(links: np.ndarray) -> None:
    fragments = trace(links)
    found = chains(links)
    kinds = fragments.end_kind[:, 0]
    found = [c + c[:1] if k == RING else min(c, c[::-1]) for c, k in zip(found, kinds, strict=True)]
    assert sorted(found) == sorted(lines(neighbours(links)))


@settings(max_examples=150, deadline=None)
@given(pixel_graphs(), st.data())
def test_fragments_of_a_core_hold_each_link_once_and_say_where_they_end(links: np.ndarray, data: st.DataObject) -> None:
    rows, columns = links.shape
    top, left = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    bottom, right = data.draw(st.integers(top + 1, rows)), data.draw(st.integers(left + 1, columns))
    graph = neighbours(links)
    core = {r * columns + c for r in range(top, bottom) for c in range(left, right)}
    block = links[max(top - 1, 0) :, max(left - 1, 0) :]
    origin = rows - block.shape[0], columns - block.shape[1]
    window = top - origin[0], left - origin[1], bottom - origin[0], right - origin[1]
    fragments = trace(block, window, origin, columns)
    seen = []
    found = chains(block, core=window, origin=origin, width=columns)
    ends = fragments.end_kind.tolist(), fragments.end_pixel.tolist()
    for chain, kinds, beyond in zip(found, *ends, strict=True):
        assert set(chain) <= core
        assert all(len(graph[pixel]) == 2 for pixel in chain[1:-1])
        seen += [frozenset(link) for link in pairwise(chain)]
        for own, kind, pixel in zip((chain[0], chain[-1]), kinds, beyond, strict=True):
            assert (kind == NODE) == (own == pixel and len(graph[own]) != 2)
            if kind == CROSSING:
                assert pixel not in core
                seen.append(frozenset((own, pixel)))
        if RING in kinds:
            assert chain[0] == min(chain)
            assert len(graph[chain[0]]) == 2
            assert chain[1] < chain[-1]
            seen.append(frozenset((chain[-1], chain[0])))
    assert len(seen) == len(set(seen))
    assert set(seen) == {frozenset((one, other)) for one in core & graph.keys() for other in graph[one]}


def test_a_passing_pixel_alone_in_its_core_has_two_crossings() -> None:
    links = skeleton_links(drawing("... ### ..."))
    fragments = trace(links, core=(1, 1, 2, 2))
    assert fragments.pixels.tolist() == [4]
    assert fragments.end_kind.tolist() == [[CROSSING, CROSSING]]
    assert sorted(fragments.end_pixel[0].tolist()) == [3, 5]


def test_a_node_at_the_edge_of_its_core_is_a_fragment_by_itself() -> None:
    fragments = trace(skeleton_links(drawing("### .#. ...")), core=(0, 0, 1, 3))
    assert sorted(np.diff(fragments.offsets).tolist()) == [1, 2, 2]


def test_staircases_are_chains_and_corners_no_triangles() -> None:
    assert chains(skeleton_links(drawing("##.. .##. ..##"))) == [(0, 1, 5, 6, 10, 11)]


def test_links_must_be_symmetric_two_dimensional_bytes() -> None:
    links = np.zeros((3, 3), np.uint8)
    links[1, 1] = 1 << 3
    with pytest.raises(ValueError, match="not symmetric"):
        trace(links)
    with pytest.raises(ValueError, match="2-D uint8"):
        trace(np.zeros(3, np.uint8))
    with pytest.raises(ValueError, match="not a window"):
        trace(links, core=(0, 0, 4, 3))
    with pytest.raises(ValueError, match="outside a raster"):
        trace(links, origin=(0, 1), width=3)
