"""Ragged arrays and polylines against lists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import offsets_of, reduce_runs, run_of_rows, take_runs


@dataclass(frozen=True)
class Named(Polylines):
    """Polylines with a column."""

    name: np.ndarray


def some(count: int, seed: int) -> Named:
    random = np.random.default_rng(seed)
    offsets = offsets_of(random.integers(2, 6, count))
    return Named(offsets, random.integers(0, 3, (offsets[-1], 2)), random.permutation(count))


def listed(polylines: Polylines) -> list[list[list[int]]]:
    return [vertices.tolist() for vertices in polylines]


@given(st.integers(0, 9), st.integers(0, 99))
def test_operations_are_those_of_lists(count: int, seed: int) -> None:
    polylines, random = some(count, seed), np.random.default_rng(seed)
    lists = listed(polylines)
    assert len(polylines) == len(lists) == count and polylines.sizes.tolist() == [*map(len, lists)]
    assert polylines.first.tolist() == [one[0] for one in lists]
    assert polylines.last.tolist() == [one[-1] for one in lists]
    assert polylines.ends.tolist() == [end for one in lists for end in (one[0], one[-1])]
    assert polylines.closed.tolist() == [one[0] == one[-1] for one in lists]
    expected = [np.hypot(*(np.diff(one, axis=0) * (2, 3)).T).sum() for one in lists]
    assert np.allclose(polylines.lengths(2, 3), expected)

    marked, order = random.random(count) < 0.5, random.permutation(count)[: count // 2]
    for which, numbers in ((marked, np.flatnonzero(marked)), (order, order)):
        taken = polylines.taken(which)
        assert listed(taken) == [lists[number] for number in numbers]
        assert np.array_equal(taken.name, polylines.name[numbers])

    together = Named.concatenated([polylines, polylines.taken(order)])
    assert listed(together) == lists + [lists[number] for number in order]
    assert together.offsets.dtype == np.int64 and together.name[:count].tolist() == polylines.name.tolist()

    kept = random.random(len(polylines.vertices)) < 0.7
    part = polylines.with_vertices(kept)
    number = run_of_rows(polylines.offsets)
    assert listed(part) == [polylines.vertices[kept & (number == one)].tolist() for one in range(count)]


@given(st.lists(st.integers(1, 4), max_size=6))
def test_runs(sizes: list[int]) -> None:
    offsets, values = offsets_of(sizes), np.arange(sum(sizes), dtype=np.float32)
    assert offsets.tolist() == [sum(sizes[:run]) for run in range(len(sizes) + 1)]
    assert run_of_rows(offsets).tolist() == [run for run, size in enumerate(sizes) for _ in range(size)]
    lowest = reduce_runs(np.minimum, values, offsets)
    assert lowest.dtype == np.float32 and lowest.tolist() == offsets[:-1].tolist()
    assert reduce_runs(np.add, values, offsets, dtype=np.float64).dtype == np.float64
    bounds, rows = take_runs(np.arange(len(sizes))[::-1], offsets, values)
    assert bounds.tolist() == offsets_of(sizes[::-1]).tolist() and sorted(rows) == values.tolist()


def test_marks_are_counted() -> None:
    assert offsets_of(np.array([True, False, True])).tolist() == [0, 1, 1, 2]
