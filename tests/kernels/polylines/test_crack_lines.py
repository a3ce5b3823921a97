"""Lines along the edges of a line field: against brute force, and the same for any tiling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.polylines.arcs import STEPS, turns
from tilepipe.tiling.grid import TileGrid
from tilepipe_kernels.polylines.crack_lines import TICKS, CrackLineFragments, halo, trace_crack_lines
from tilepipe_kernels.polylines.join import CrackLines, join_crack_lines

Fields = tuple[np.ndarray, np.ndarray, np.ndarray]
Corner = tuple[int, int]


def naive_lines(h: np.ndarray, v: np.ndarray, y: np.ndarray) -> list[tuple]:
    """Each line as its turning corners and its sums of absolute and of signed ticks; canonical direction, sorted."""
    cracks = {frozenset([(i + 1, j), (i + 1, j + 1)]) for i, j in np.argwhere(h == 1).tolist()}
    cracks |= {frozenset([(i, j + 1), (i + 1, j + 1)]) for i, j in np.argwhere(v == 1).tolist()}

    def ticks(corner: Corner, after: Corner) -> int:
        left_of = ((0, 0), (-1, 0), (-1, -1), (0, -1))
        heading = STEPS.index((after[0] - corner[0], after[1] - corner[1]))
        left, right = (y[corner[0] + i, corner[1] + j] for i, j in (left_of[heading], left_of[heading - 1]))
        difference = (float(left) - float(right)) * TICKS
        return int(np.copysign(np.floor(abs(difference) + 0.5), difference))

    def onward(corner: Corner) -> list[int]:
        return [k for k in range(4) if frozenset([corner, step(corner, k)]) in cracks]

    def step(corner: Corner, heading: int) -> Corner:
        return corner[0] + STEPS[heading][0], corner[1] + STEPS[heading][1]

    found, walked = {}, set()
    corners = sorted({corner for crack in cracks for corner in crack})
    for rings in (False, True):
        for start in corners:
            if (len(onward(start)) == 2) != rings or (rings and start in walked):
                continue
            for first in onward(start)[:1] if rings else onward(start):
                chain, heading = [start, step(start, first)], first
                while len(onward(chain[-1])) == 2 and chain[-1] != start:
                    (heading,) = (k for k in onward(chain[-1]) if k != (heading + 2) % 4)
                    chain.append(step(chain[-1], heading))
                walked.update(chain)
                if rings or (start, first) <= (chain[-1], (heading + 2) % 4):
                    across = [ticks(*pair) for pair in pairwise(chain)]
                    found[start, first] = (turns(chain), sum(map(abs, across)), sum(across))
    return [found[key] for key in sorted(found)]


@st.composite
def line_fields(draw: st.DrawFn) -> Fields:
    """Elements from a few to nearly all, so that there are loose ends, junctions and rings."""
    shape = draw(st.integers(1, 11)), draw(st.integers(1, 11))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    share = draw(st.sampled_from([0.1, 0.4, 0.7, 1.0]))
    if draw(st.booleans()):
        x = random.integers(0, 2, shape).repeat(2, 0)[: shape[0]]
        h, v = np.zeros((2, *shape), np.uint8)
        h[:-1], v[:, :-1] = x[1:] != x[:-1], x[:, 1:] != x[:, :-1]
    else:
        h, v = (random.random((2, *shape)) < share).astype(np.uint8)
        h[-1], v[:, -1] = 0, 0
    return h, v, random.normal(0, 3, shape).astype(np.float32)


def tiled_fragments(fields: Fields, tile: tuple[int, int]) -> list[CrackLineFragments]:
    fragments = []
    for one in TileGrid(fields[0].shape, tile).tiles(halo=halo()):
        blocks = (field[one.padded.slices] for field in fields)
        fragments.append(trace_crack_lines(*blocks, one.core_in_padded.as_tuple(), one.padded.origin))
    return fragments


def tuples(lines: CrackLines | CrackLineFragments) -> list[tuple]:
    points = [tuple(map(tuple, vertices.tolist())) for vertices in lines]
    return list(zip(points, lines.contrast.tolist(), lines.step.tolist(), strict=True))


@settings(max_examples=80, deadline=None)
@given(line_fields())
def test_whole_raster_gives_the_lines_of_brute_force(fields: Fields) -> None:
    fragments = trace_crack_lines(*fields)
    assert not fragments.cut.any()
    assert sorted(tuples(fragments)) == sorted(naive_lines(*fields))
    assert tuples(join_crack_lines([fragments])) == naive_lines(*fields)


@settings(max_examples=80, deadline=None)
@given(line_fields(), st.integers(1, 6), st.integers(1, 6), st.randoms())
def test_tiling_does_not_show(fields: Fields, rows: int, columns: int, random: object) -> None:
    fragments = tiled_fragments(fields, (rows, columns))
    random.shuffle(fragments)  # type: ignore[attr-defined]
    tiled, whole = join_crack_lines(fragments), join_crack_lines([trace_crack_lines(*fields)])
    for name in ("offsets", "vertices", "contrast", "step"):
        one, other = getattr(tiled, name), getattr(whole, name)
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes()
    assert whole.lengths().sum() == fields[0].sum() + fields[1].sum()


def test_junctions_and_loose_ends_part_lines() -> None:
    h, v = np.zeros((2, 4, 6), np.uint8)
    h[1, :5] = 1
    v[2, 2] = 1
    y = np.where(np.arange(4)[:, None] < 2, 0, 1.5).repeat(6, 1)
    lines = tuples(trace_crack_lines(h, v, y, origin=(10, 20)))
    junction = (12, 23)
    expected = [((12, 20), junction), (junction, (13, 23)), (junction, (12, 25))]
    assert [points for points, _, _ in lines] == expected
    assert [contrast / TICKS for _, contrast, _ in lines] == [4.5, 0.0, 3.0]
    assert [step / TICKS for _, _, step in lines] == [-4.5, 0.0, -3.0]


def test_the_step_is_of_the_left_side_over_the_right() -> None:
    h, v = np.zeros((2, 3, 3), np.uint8)
    h[0, 1] = h[1, 1] = v[1, 0] = v[1, 1] = 1
    y = np.zeros((3, 3))
    y[1, 1] = 2.5
    (ring,) = [join_crack_lines([trace_crack_lines(h, v, y)])]
    assert len(ring) == 1 and ring.step[0] == ring.contrast[0] == 4 * 2.5 * TICKS  # what a ring surrounds is left
    (dark,) = [join_crack_lines([trace_crack_lines(h, v, -y)])]
    assert dark.step[0] == -dark.contrast[0]
    below = join_crack_lines(
        [trace_crack_lines(np.eye(1, 3, 1, dtype=np.uint8), np.zeros((1, 3), np.uint8), np.zeros((1, 3)))]
    )
    assert below.step[0] == 0


def test_no_edges_make_no_lines() -> None:
    lines = join_crack_lines(tiled_fragments((*np.zeros((2, 5, 5), np.uint8), np.zeros((5, 5))), (2, 3)))
    assert len(lines) == 0 and lines.contrast.dtype == np.int64 and lines.lengths().size == 0


def test_bad_input_is_named() -> None:
    h, v = np.ones((2, 4, 4), np.uint8)
    y = np.zeros((4, 4))
    with pytest.raises(ValueError, match="vertical must be uint8 of the shape"):
        trace_crack_lines(h, v[:2], y)
    with pytest.raises(ValueError, match="horizontal must be uint8"):
        trace_crack_lines(h.astype(int), v, y)
    with pytest.raises(ValueError, match="not a window"):
        trace_crack_lines(h, v, y, core=(0, 5, 0, 1))
    h[:], v[:] = 0, np.arange(4) == 1
    fragments = tiled_fragments((h, v, y), (2, 2))[2:]
    with pytest.raises(ValueError, match="every tile once"):
        join_crack_lines(fragments)
