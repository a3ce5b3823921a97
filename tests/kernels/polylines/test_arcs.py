"""Arcs of a raster: against brute force, and the same for any tiling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.polylines.arcs import arcs as naive_arcs
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.polylines.arcs import ArcFragments, halo, trace_arcs
from tilepipe_kernels.polylines.join import Arcs, join_arcs


def drawing(text: str) -> np.ndarray:
    return np.array([[0 if mark == "." else ord(mark) - 64 for mark in line] for line in text.split()], np.int32)


@st.composite
def label_images(draw: st.DrawFn) -> np.ndarray:
    """From lone pixels and saddles everywhere to a few regions with holes in holes; any label may be nodata."""
    shape = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    labels = random.integers(0, draw(st.sampled_from([2, 3, 5, 60])), shape)
    coarse = draw(st.sampled_from([1, 2, 3]))
    return labels.repeat(coarse, 0).repeat(coarse, 1)[: shape[0], : shape[1]].astype(np.int32)


def tiled_fragments(labels: np.ndarray, tile: tuple[int, int]) -> list[ArcFragments]:
    fragments = []
    for one in TileGrid(labels.shape, tile).tiles(halo=halo()):
        block = labels[one.padded.slices]
        fragments.append(trace_arcs(block, one.core_in_padded.as_tuple(), one.padded.origin))
    return fragments


def tuples(arcs: Arcs | ArcFragments) -> list[tuple]:
    points = [tuple(map(tuple, vertices.tolist())) for vertices in arcs]
    return list(zip(points, arcs.left.tolist(), arcs.right.tolist(), strict=True))


@settings(max_examples=100, deadline=None)
@given(label_images())
def test_whole_raster_gives_the_arcs_of_brute_force(labels: np.ndarray) -> None:
    fragments = trace_arcs(labels)
    assert sorted(tuples(fragments)) == sorted(naive_arcs(labels))
    assert not fragments.cut.any()
    assert tuples(join_arcs([fragments])) == naive_arcs(labels)


@settings(max_examples=100, deadline=None)
@given(label_images(), st.integers(1, 6), st.integers(1, 6), st.randoms())
def test_tiling_does_not_show(labels: np.ndarray, rows: int, columns: int, random: object) -> None:
    fragments = tiled_fragments(labels, (rows, columns))
    random.shuffle(fragments)  # type: ignore[attr-defined]
    tiled, whole = join_arcs(fragments), join_arcs([trace_arcs(labels)])
    for name in ("offsets", "vertices", "left", "right"):
        one, other = getattr(tiled, name), getattr(whole, name)
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes()


def test_ring_over_four_tiles_starts_at_its_lowest_corner() -> None:
    labels = drawing("....  .AA.  .AA.  ....")
    assert tuples(join_arcs(tiled_fragments(labels, (2, 2)))) == [(((1, 1), (3, 1), (3, 3), (1, 3), (1, 1)), 1, 0)]


def test_ids_beyond_int32_and_lengths_of_arcs() -> None:
    labels = np.array([[2**32 - 1, 7]], np.uint32)
    arcs = join_arcs([trace_arcs(labels, origin=(10, 20))])
    assert arcs.left.dtype == np.uint32 and set(arcs.left.tolist()) | set(arcs.right.tolist()) == {0, 7, 2**32 - 1}
    assert arcs.lengths().tolist() == [1, 3, 3] and arcs.lengths(2, 0.5).tolist() == [2, 3, 3]
    assert arcs.vertices.min(axis=0).tolist() == [10, 20]


def test_raster_without_regions_has_no_arcs() -> None:
    arcs = join_arcs(tiled_fragments(np.zeros((4, 4), np.int32), (2, 2)))
    assert len(arcs) == 0 and arcs.vertices.shape == (0, 2) and arcs.lengths().size == 0


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="int32 or uint32"):
        trace_arcs(np.zeros((2, 2)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="not a window"):
        trace_arcs(np.zeros((2, 2), np.int32), core=(0, 3, 0, 2))
    with pytest.raises(ValueError, match="every tile once"):
        join_arcs(tiled_fragments(np.ones((4, 4), np.int32), (2, 2))[1:])
    with pytest.raises(ValueError, match="at least one tile"):
        join_arcs([])
