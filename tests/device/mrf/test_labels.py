"""Optimisers of labels on the device give the very labels, rounds and unresolved sites of the CPU and of the oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.kernels.mrf.test_labels import costs
from tests.naive.mrf.labels import Problem
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.mrf.annealing import Annealing, boltzmann_factor
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.labels.energy import label_energy
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.minimise import minimise
from tilepipe_kernels.mrf.labels.problem import Labels
from tilepipe_kernels.mrf.search import Search

SCHEDULE = Annealing(2, hot=2.0, cold=0.4, seed=2**63)
CORE = (slice(1, 7), slice(2, 8))


def uploaded(problem: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {name: to_device(array) for name, array in problem.items()}


def assert_same(found: Labels, expected: Labels) -> None:
    assert on_device(found.labels) and found.labels.dtype == np.uint8
    np.testing.assert_array_equal(to_host(found.labels), expected.labels)
    assert (found.rounds, found.unresolved) == (expected.rounds, expected.unresolved)


PROBLEMS = st.builds(
    costs,
    st.integers(0, 9999),
    st.tuples(st.integers(1, 6), st.integers(1, 6)),
    st.integers(2, 4),
    st.sampled_from([1, 3]),
    st.just(0.1),
    st.booleans(),
)
ORIGINS = st.tuples(st.integers(0, 70000), st.integers(0, 70000))


@settings(max_examples=8)
@given(PROBLEMS, ORIGINS, st.sampled_from([1, 5, 40]))
def test_rounds_are_those_of_the_oracle(problem: dict[str, Any], origin: tuple[int, int], cap: int) -> None:
    tables = {"tables" if name == "pairwise" else name: array for name, array in problem.items()}
    naive = Problem(origin=origin, **tables)
    expected, rounds, unresolved = naive.parallel(cap)
    options: dict[str, Any] = {"origin": origin, "search": Search(rounds=cap)}
    found = minimise(**uploaded(problem), **options)
    assert_same(found, Labels(naive.as_array(expected), rounds, unresolved))
    assert_same(found, minimise(**problem, **options))


@settings(max_examples=10)
@given(PROBLEMS, ORIGINS, st.sampled_from(["icm", "annealing", "messages"]), st.sampled_from([1, 3, 40]))
def test_labels_are_those_of_the_cpu(problem: dict[str, Any], origin: tuple[int, int], method: Any, cap: int) -> None:
    search = Search(method, cap, SCHEDULE, messages=2, scales=origin[0] % 2)
    options: dict[str, Any] = {"origin": origin, "search": search, "core": CORE}
    expected = minimise(**problem, **options)
    assert_same(minimise(**uploaded(problem), **options), expected)
    energy = label_energy(to_device(expected.labels), **uploaded(problem))
    assert energy == label_energy(expected.labels, **problem)


@pytest.mark.parametrize(
    ("method", "levels", "shape"),
    [
        ("parallel", 2, (9, 11)),
        ("parallel", 5, (5, 7)),
        ("icm", 3, (7, 6)),
        ("annealing", 3, (5, 6)),
        ("messages", 17, (3, 5)),
    ],
)
def test_labels_of_an_image_are_those_of_the_cpu(method: Any, levels: int, shape: tuple[int, int]) -> None:
    random = np.random.default_rng(levels)
    y = random.uniform(-0.5, levels - 0.5, shape).astype(np.float32)
    y[1, 3:5] = np.nan
    h, v = random.choice(np.array([0, 1, 255], np.uint8), (2, *shape))
    model = EdgeModel(levels, "quadratic" if levels == 5 else "reciprocal", beta=0.37, sigma=0.83)
    options: dict[str, Any] = {"search": Search(method, annealing=SCHEDULE, messages=2), "origin": (3, 8)}
    expected = intensity_field(y, model, horizontal=h, vertical=v, **options)
    found = intensity_field(to_device(y), model, horizontal=to_device(h), vertical=to_device(v), **options)
    assert_same(found, expected)


def test_descent_from_a_start_is_that_of_the_cpu() -> None:
    random = np.random.default_rng(0)
    y = random.uniform(-0.5, 2.5, (6, 7)).astype(np.float32)
    start = random.integers(0, 3, y.shape).astype(np.uint8)
    expected = intensity_field(y, EdgeModel(3), start=start)
    assert expected.rounds > 2
    assert_same(intensity_field(to_device(y), EdgeModel(3), start=to_device(start)), expected)
    done = intensity_field(to_device(y), EdgeModel(3), start=to_device(expected.labels))
    assert_same(done, Labels(expected.labels, 0, 0))


def test_boltzmann_factor_is_the_exponential() -> None:
    excess = np.concatenate([np.linspace(0, 3, 999), np.geomspace(3, 345, 999)])
    found = [boltzmann_factor(e, 0.5) for e in excess]
    np.testing.assert_allclose(found, np.exp(-2 * excess), rtol=1e-15)
    assert boltzmann_factor(351.0, 0.5) == boltzmann_factor(np.inf, 0.5) == 0


def test_bad_input_is_refused() -> None:
    y, model = to_device(np.zeros((3, 4), np.float32)), EdgeModel()
    with pytest.raises(ValueError, match="serial HCF is for arrays of the host"):
        intensity_field(y, model, search=Search("serial"))
    with pytest.raises(ValueError, match="finite"):
        intensity_field(to_device(np.full((3, 4), np.inf)), model)
    with pytest.raises(ValueError, match="start must be from 0 to 1"):
        intensity_field(y, model, start=to_device(np.full((3, 4), 2)))
    with pytest.raises(TypeError, match="mixed"):
        intensity_field(y, model, start=np.zeros((3, 4), np.uint8))
    costs = {"unary": to_device(np.zeros((3, 4, 2))), "pairwise": to_device(np.zeros((2, 2)))}
    with pytest.raises(ValueError, match="down_weight must be finite and not negative"):
        minimise(**costs, down_weight=to_device(-np.ones((3, 4))))
    with pytest.raises(ValueError, match="symmetric"):
        minimise(costs["unary"], to_device(np.triu(np.ones((2, 2)))))
    with pytest.raises(TypeError, match="mixed"):
        minimise(costs["unary"], np.zeros((2, 2)))
