"""The street graph: the same for any tiling, against brute force, and rule by rule on drawn cases."""

from __future__ import annotations

from itertools import pairwise, product

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kernels.network.one_array import prune_skeleton, trace_lines
from tests.kernels.network.test_tracing import drawing, pixel_graphs
from tests.naive.network import tracing as naive
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.network.build import LineBatch, Network, build_network, iterate_lines
from tilepipe_kernels.network.cleaning import Cleaning, raster_border
from tilepipe_kernels.network.fragment_table import summarise
from tilepipe_kernels.network.skeleton import skeleton_links
from tilepipe_kernels.network.tracing import trace

NETWORK_FIELDS = ("start", "end", "length", "node_pixel", "node_xy", "node_degree")
BATCH_FIELDS = ("line", "start", "end", "pixel")


def tiled(
    links: np.ndarray,
    row_cuts: list[int],
    column_cuts: list[int],
    cleaning: Cleaning,
    seed: int = 0,
    batch_points: int = 10**6,
) -> tuple[Network, list[LineBatch]]:
    """Network of a raster cut into tiles, which are given in a random order."""
    values = np.random.default_rng(0).random((3, *links.shape)).astype(np.float32)
    named = {"dx": values[0] - 0.5, "dy": values[1] - 0.5, "response": values[2]}
    spans = [list(pairwise([0, *cuts, size])) for cuts, size in zip((row_cuts, column_cuts), links.shape, strict=True)]
    tiles = []
    for (top, bottom), (left, right) in product(*spans):
        block = links[max(top - 1, 0) : bottom + 1, max(left - 1, 0) : right + 1]
        origin = max(top - 1, 0), max(left - 1, 0)
        core = top - origin[0], left - origin[1], bottom - origin[0], right - origin[1]
        fragments = trace(block, core, origin, links.shape[1])
        tiles.append((fragments, {name: array.ravel()[fragments.pixels] for name, array in named.items()}))
    tiles = [tiles[i] for i in np.random.default_rng(seed).permutation(len(tiles))]
    tables = [summarise(fragments, links.shape[1], values["response"]) for fragments, values in tiles]
    border = raster_border(links.shape)
    network = build_network(tables, links.shape[1], tiles.__getitem__, cleaning, border)
    return network, list(iterate_lines(network, tiles.__getitem__, batch_points))


def walks(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """A mask of blocks with streets around them, and of random walks with gaps that keep their heading."""
    random = np.random.default_rng(seed)
    mask = np.zeros(shape, bool)
    for _ in range(random.integers(0, 4)):
        (top, left), (bottom, right) = random.integers(0, np.array(shape) - 2), random.integers(2, shape)
        mask[[top, bottom], min(left, right) : max(left, right) + 1] = True
        mask[min(top, bottom) : max(top, bottom) + 1, [left, right]] = True
    for _ in range(random.integers(0, 8)):
        row, column, heading = *random.integers(shape), random.integers(8)
        for _ in range(random.integers(3, 40)):
            heading = (heading + random.choice([-1, 0, 0, 0, 0, 1])) % 8
            row, column = row + naive.STEPS[heading][0], column + naive.STEPS[heading][1]
            if not (0 <= row < shape[0] and 0 <= column < shape[1]):
                break
            mask[row, column] = random.random() < 0.97
    return mask


@st.composite
def cleanings(draw: st.DrawFn) -> Cleaning:
    return Cleaning(
        high=draw(st.sampled_from([None, 0.6, 0.95])),
        through_junctions=draw(st.booleans()),
        contraction=draw(st.sampled_from([0.0, 1.0, 2.0, 3.5])),
        maximum_gap=draw(st.sampled_from([0.0, 3.0, 6.5, 12.0])),
        maximum_angle=draw(st.sampled_from([20.0, 50.0, 80.0])),
        direction_steps=draw(st.integers(1, 6)),
        minimum_branch=draw(st.sampled_from([0.0, 3.0, 6.0])),
        minimum_length=draw(st.sampled_from([0.0, 4.0, 9.0])),
    )


@st.composite
def street_links(draw: st.DrawFn) -> np.ndarray:
    shape = draw(st.integers(8, 30)), draw(st.integers(8, 30))
    return skeleton_links(walks(draw(st.integers(0, 2**32 - 1)), shape))


def cuts(size: int) -> st.SearchStrategy[list[int]]:
    some = st.lists(st.integers(1, max(size - 1, 1)), unique=True, max_size=5).map(sorted)
    some = some if size > 1 else st.just([])
    return some | st.just(list(range(1, size)))


@settings(max_examples=150, deadline=None)
@given(pixel_graphs() | street_links(), cleanings(), st.data())
def test_the_tiling_is_invisible(links: np.ndarray, cleaning: Cleaning, data: st.DataObject) -> None:
    whole, (*batches,) = tiled(links, [], [], cleaning)
    row_cuts, column_cuts = data.draw(cuts(links.shape[0])), data.draw(cuts(links.shape[1]))
    other, pieces = tiled(links, row_cuts, column_cuts, cleaning, seed=1, batch_points=data.draw(st.integers(1, 60)))
    for name in NETWORK_FIELDS:
        np.testing.assert_array_equal(getattr(whole, name), getattr(other, name), err_msg=name)
    assert sum(map(len, (b.line for b in pieces))) == len(whole)
    for batch in batches:
        for name in BATCH_FIELDS:
            found = np.concatenate([getattr(piece, name) for piece in pieces])
            np.testing.assert_array_equal(getattr(batch, name), found, err_msg=name)
        polylines = Polylines.concatenated([piece.polylines for piece in pieces])
        np.testing.assert_array_equal(batch.polylines.offsets, polylines.offsets)
        np.testing.assert_array_equal(batch.polylines.vertices, polylines.vertices)
        response = np.concatenate([piece.attributes["response"] for piece in pieces])
        np.testing.assert_array_equal(batch.attributes["response"], response)


LOOPS = {
    "lasso": ".####.. .#..#.. .#..### .####..",
    "lasso with a spur on its loop": "...#... .####.. .#..#.. .#..### .####..",
    "ring with two spurs": "....#.. .#####. .#...#. ##...#. .#####.",
    "ring": ".####. .#..#. .#..#. .####.",
}


@pytest.mark.parametrize("text", LOOPS.values(), ids=LOOPS)
@pytest.mark.parametrize("minimum", [0.0, 1.5])
def test_loops_have_one_start_and_direction_wherever_they_are_cut(text: str, minimum: float) -> None:
    links, cleaning = skeleton_links(drawing(text)), Cleaning(minimum_branch=minimum)
    whole, (lines,) = tiled(links, [], [], cleaning)
    for row, column, seed in product(range(1, links.shape[0]), range(1, links.shape[1]), range(3)):
        cut, (others,) = tiled(links, [row], [column], cleaning, seed)
        np.testing.assert_array_equal(cut.node_pixel, whole.node_pixel)
        np.testing.assert_array_equal(others.pixel, lines.pixel)


def test_a_ring_of_dissolved_nodes_starts_at_the_lowest_of_them() -> None:
    network, _ = network_of(LOOPS["ring with two spurs"], minimum_branch=1.5)
    assert network.node_pixel.tolist() == [7 + 4]


@settings(max_examples=150, deadline=None)
@given(street_links(), cleanings())
def test_every_network_is_a_valid_graph(links: np.ndarray, cleaning: Cleaning) -> None:
    network, batches = tiled(links, [5], [7], cleaning)
    ends = np.concatenate([network.start, network.end])
    np.testing.assert_array_equal(np.bincount(ends, minlength=len(network.node_pixel) + 1)[1:], network.node_degree)
    assert np.all(network.start <= network.end)
    assert np.all(np.diff(network.node_pixel) > 0)
    assert np.all(network.node_degree > 0)
    for node in np.flatnonzero(network.node_degree == 2) + 1:
        (line,) = np.flatnonzero((network.start == node) | (network.end == node))
        assert network.start[line] == network.end[line]
    for batch in batches:
        assert np.all(batch.polylines.sizes >= 2)
        np.testing.assert_array_equal(batch.polylines.first, network.node_xy[batch.start - 1])
        np.testing.assert_array_equal(batch.polylines.last, network.node_xy[batch.end - 1])
    degree = network.node_degree
    free = (degree == 1) & ~raster_border(links.shape)(network.node_pixel)
    for one, other in ((network.start, network.end), (network.end, network.start)):
        hanging = free[one - 1] & (degree[other - 1] >= 3)
        assert np.all(network.length[hanging] >= cleaning.minimum_branch)
    graph = networkx.MultiGraph()
    graph.add_weighted_edges_from(zip(network.start, network.end, network.length, strict=True))
    for component in networkx.connected_components(graph):
        assert graph.subgraph(component).size("weight") >= cleaning.minimum_length - 1e-9


@settings(max_examples=150, deadline=None)
@given(pixel_graphs() | street_links())
def test_unchanged_lines_are_those_of_brute_force(links: np.ndarray) -> None:
    network, lines = trace_lines(links)
    expected = naive.lines(naive.neighbours(links))
    assert points(lines) == expected
    np.testing.assert_array_equal(network.length, [naive.length(line, links.shape[1]) for line in expected])
    assert sorted({line[i] for line in expected for i in (0, -1)}) == network.node_pixel.tolist()


@settings(max_examples=150, deadline=None)
@given(pixel_graphs() | street_links(), st.sampled_from([2.0, 3.0, 5.0, 8.0, 15.0]))
def test_pruned_lines_are_those_of_brute_force(links: np.ndarray, minimum: float) -> None:
    _, lines = trace_lines(links, Cleaning(minimum_branch=minimum))
    expected = naive.prune(naive.lines(naive.neighbours(links)), minimum, links.shape[1])
    assert {naive.lowest_form(line) for line in points(lines)} == expected


def points(lines: LineBatch) -> list[tuple[int, ...]]:
    return [tuple(chain.tolist()) for chain in np.split(lines.pixel, lines.polylines.offsets[1:-1])][: len(lines.line)]


def network_of(
    text: str, response: np.ndarray | None = None, **cleaning: float
) -> tuple[Network, list[tuple[int, ...]]]:
    network, lines = trace_lines(skeleton_links(drawing(text)), Cleaning(**cleaning), response)
    return network, points(lines)


def test_hysteresis_keeps_what_a_strong_point_reaches() -> None:
    text = "######## ....#... ....#... ........ ########"
    response = np.ones((5, 8), np.float32)
    response[0, 0] = 3
    assert len(network_of(text, response, high=3.0)[0]) == 3
    assert len(network_of(text, response, high=3.5)[0]) == 0
    alone, _ = trace_lines(skeleton_links(drawing(text)), Cleaning(high=3, through_junctions=False), response)
    assert alone.node_pixel.tolist() == [0, 4]


def test_junctions_two_pixels_apart_become_one_crossing() -> None:
    text = "...#..... ...#..... ######### .....#... .....#..."
    apart, _ = network_of(text)
    one, _ = network_of(text, contraction=2.0)
    assert len(apart) == 5
    assert sorted(apart.node_degree) == [1, 1, 1, 1, 3, 3]
    assert len(one) == 4
    assert sorted(one.node_degree) == [1, 1, 1, 1, 4]
    crossing = int(np.argmax(one.node_degree))
    assert one.node_pixel[crossing] == 2 * 9 + 3
    assert one.node_xy[crossing].tolist() == [4.5, 2.5]


def test_facing_ends_are_joined_to_one_line() -> None:
    network, lines = network_of("#####...#####", maximum_gap=4.0)
    assert lines == [(0, 1, 2, 3, 4, 8, 9, 10, 11, 12)]
    assert network.length.tolist() == [12.0]
    assert len(network_of("#####...#####", maximum_gap=3.0)[0]) == 2


def test_ends_beside_each_other_are_not_joined() -> None:
    assert len(network_of("#####... ........ ........ ...#####", maximum_gap=5.0)[0]) == 2


def test_a_paired_end_makes_no_second_bridge() -> None:
    text = "#####....##### ......#....... ......#....... ......#......."
    network, _ = network_of(text, maximum_gap=5.0)
    assert network.node_degree.tolist() == [1, 1, 1, 1]


def test_an_end_that_points_to_a_line_makes_a_junction_there() -> None:
    network, lines = network_of("....... #####.. ....... ....... ...#... ...#... ...#...", maximum_gap=4.0)
    assert sorted(network.node_degree) == [1, 1, 1, 3]
    assert (10, 31, 38, 45) in lines
    assert network.length.sum() == 4 + 2 + 3


def test_a_line_between_two_facing_ends_gets_one_crossing() -> None:
    text = "....#.... ....#.... ###.#.### ....#.... ....#...."
    network, _ = network_of(text, maximum_gap=5.0)
    assert sorted(network.node_degree) == [1, 1, 1, 1, 4]
    assert network.node_pixel[network.node_degree == 4].tolist() == [2 * 9 + 4]


def test_a_ring_reached_by_a_line_is_cut_only_there() -> None:
    network, lines = network_of(".##.... #..#.## .##....", maximum_gap=3.0)
    assert sorted(network.node_degree) == [1, 3]
    assert lines == [(10, 2, 1, 7, 15, 16, 10), (10, 12, 13)]


def test_the_longest_of_short_branches_stays() -> None:
    network, lines = network_of("....... ######. ..#.... ..#....", minimum_branch=10.0)
    assert lines == [(9, 10, 11, 12)]
    assert network.length.tolist() == [3.0]


def test_lines_cut_off_by_the_border_do_not_dangle() -> None:
    text = "..#.... ..#.... ..#.... #######"
    links = skeleton_links(drawing(text))
    inside, _ = trace_lines(links, Cleaning(minimum_branch=5.0))
    border, _ = trace_lines(links, Cleaning(minimum_branch=5.0), on_border=raster_border(links.shape))
    assert (len(inside), len(border)) == (1, 3)


def test_short_components_are_dropped_whole() -> None:
    text = "####.... ........ ######## ...#.... ...#...."
    assert len(network_of(text, minimum_length=9.0)[0]) == 3
    assert len(network_of(text, minimum_length=9.1)[0]) == 0


def test_pruned_skeleton() -> None:
    skeleton = drawing("............ ############ .....#...... .....#...... .........#..")
    expected = skeleton.copy()
    expected[2:4] = False
    np.testing.assert_array_equal(prune_skeleton(skeleton, 4), expected)


def test_a_raster_without_lines_gives_an_empty_network() -> None:
    every = Cleaning(0.5, True, 2.0, 5.0, 30.0, 10, 5.0, 5.0)
    network, batches = tiled(np.zeros((4, 5), np.uint8), [2], [], every)
    assert (len(network), batches, network.node_xy.shape) == (0, [], (0, 2))


def test_a_missing_tile_and_senseless_rules_are_refused() -> None:
    links = skeleton_links(drawing("#### ...."))
    half = trace(links, core=(0, 0, 2, 2))
    with pytest.raises(ValueError, match="crosses a seam"):
        build_network([summarise(half, 4)], 4, lambda tile: (half, {}))
    with pytest.raises(ValueError, match="maximum_angle"):
        Cleaning(maximum_angle=90.0)
    with pytest.raises(ValueError, match="minimum_branch"):
        Cleaning(minimum_branch=-1.0)
