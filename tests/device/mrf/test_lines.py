"""Line elements and coupled fields on the device are the very ones of the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kernels.mrf.test_lines import TERMS, model_of, naive_state, scene
from tests.naive.mrf import lines as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.lines.minimise import CoupledFields, LineField, coupled_fields, line_field
from tilepipe_kernels.mrf.search import Method, Search


def assert_same(found: LineField | CoupledFields, expected: LineField | CoupledFields) -> None:
    assert on_device(*found[:-2])
    for there, here in zip(found[:-2], expected[:-2], strict=True):
        assert to_host(there).dtype == np.uint8
        np.testing.assert_array_equal(to_host(there), here)
    assert found[-2:] == expected[-2:]


@settings(max_examples=14, deadline=None)
@given(
    st.tuples(st.integers(1, 11), st.integers(1, 11)),
    st.integers(0, 999),
    st.sampled_from(["parallel", "parallel", "icm", "annealing"]),
    st.sampled_from([None, *TERMS]),
    st.sampled_from([1, 3, 99]),
    st.booleans(),
)
def test_lines_are_those_of_the_cpu(
    shape: tuple[int, int], seed: int, method: Method, only: str | None, rounds: int, sure: bool
) -> None:
    _, x = scene(*shape, 3, seed)
    search = Search(method, rounds, Annealing(sweeps=2, seed=seed), sure=sure)
    options: dict[str, Any] = {"search": search, "origin": (seed % 7, 1000), "core": np.s_[1:9, 2:]}
    model = model_of(only=only)
    assert_same(line_field(to_device(x), model, **options), line_field(x, model, **options))


@settings(max_examples=14, deadline=None)
@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.integers(0, 999),
    st.sampled_from(["parallel", "parallel", "icm", "annealing"]),
    st.sampled_from([2, 4]),
    st.sampled_from([1, 3, 99]),
    st.booleans(),
    st.booleans(),
)
def test_coupled_fields_are_those_of_the_cpu(
    shape: tuple[int, int], seed: int, method: Method, levels: int, rounds: int, started: bool, sure: bool
) -> None:
    y, x = scene(*shape, levels, seed)
    x[:, 5:] = 255
    # other labels than the data speak for, of which the host looks at none before something changes beside it
    x[:3] = np.where(x[:3] == 255, 255, levels - 1)
    potential = "reciprocal" if seed % 2 else "quadratic"
    model = model_of(levels, potential=potential)
    search = Search(method, rounds, Annealing(sweeps=2, seed=seed), sure=sure)
    options: dict[str, Any] = {"search": search, "origin": (5, seed), "core": np.s_[:-1, 1:]}
    start = (x, to_device(x)) if started else (None, None)
    expected = coupled_fields(y, model, start=start[0], **options)
    assert_same(coupled_fields(to_device(y), model, start=start[1], **options), expected)


@pytest.mark.parametrize("integrated", [False, True])
def test_rounds_are_those_of_brute_force(integrated: bool) -> None:
    y, x = scene(4, 4, 3, seed=21)
    model, origin = model_of(3), (3, 1000)
    state = naive_state(y, None if integrated else x)
    expected = naive.parallel_hcf(state, model, 99, origin, integrated=integrated, sure=True)
    if integrated:
        found: LineField | CoupledFields = coupled_fields(to_device(y), model, search=Search(rounds=99), origin=origin)
    else:
        found = line_field(to_device(x), model, search=Search(rounds=99), origin=origin)
    for mine, theirs in zip(found[-4:-2], state.fields[1:], strict=True):
        np.testing.assert_array_equal(to_host(mine), np.where(theirs == 255, 0, theirs))
    assert found[-2:] == expected


def test_a_photograph_like_block_is_that_of_the_cpu() -> None:
    y, x = scene(16, 14, 3, seed=4)
    model = EdgeModel(3)
    assert_same(line_field(to_device(x), model), line_field(x, model))
    assert_same(coupled_fields(to_device(y), model), coupled_fields(y, model))


def test_the_serial_form_is_refused() -> None:
    y, x = scene(4, 4, 2, seed=0)
    with pytest.raises(ValueError, match="serial HCF runs on the host alone"):
        line_field(to_device(x), EdgeModel(2), search=Search("serial"))
    with pytest.raises(ValueError, match="serial HCF runs on the host alone"):
        coupled_fields(to_device(y), EdgeModel(2), search=Search("serial"))
    with pytest.raises(TypeError, match="mixed"):
        coupled_fields(to_device(y), EdgeModel(2), start=x)


def test_without_contrast_elements_wait_for_labels_all_the_same() -> None:
    y, _ = scene(7, 8, 3, seed=2)
    model = EdgeModel(3, alpha=0)
    expected = coupled_fields(y, model)
    assert expected.horizontal.max() <= 1 and expected.vertical.max() <= 1
    assert_same(coupled_fields(to_device(y), model), expected)
