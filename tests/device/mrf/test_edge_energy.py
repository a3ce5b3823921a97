"""Terms of the energy counted on the device are those of the CPU and of the definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naive.mrf import edge_model as naive
from tilepipe_kernels.core.arrays import to_device
from tilepipe_kernels.mrf.edge_energy import EnergyTerms, energy, energy_terms
from tilepipe_kernels.mrf.edge_model import EdgeModel


def assert_same(found: EnergyTerms, expected: EnergyTerms) -> None:
    for name, value in expected._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), value, err_msg=name)


@settings(max_examples=10)
@given(
    st.integers(0, 999), st.tuples(st.integers(1, 9), st.integers(1, 11)), st.sampled_from([2, 5]),
    st.sampled_from([0.0, 0.2]), st.tuples(*[st.integers(0, 9)] * 4),
)  # fmt: skip
def test_terms_are_those_of_the_cpu(
    seed: int, shape: tuple[int, int], levels: int, missing: float, bounds: tuple[int, int, int, int]
) -> None:
    random = np.random.default_rng(seed)
    y = random.uniform(-0.5, levels - 0.5, shape).astype(np.float32)
    y[random.random(shape) < missing] = np.nan
    x, h, v = (random.integers(0, k, shape).astype(np.uint8) for k in (levels, 2, 2))
    for field in (x, h, v):
        field[random.random(shape) < missing] = 255
    there = [to_device(array) for array in (y, x, h, v)]
    core = slice(*bounds[:2]), slice(*bounds[2:])
    assert_same(energy_terms(*there, levels, core=core), energy_terms(y, x, h, v, levels, core=core))
    assert_same(energy_terms(*there[:2], None, None, levels), energy_terms(y, x, None, None, levels))
    model = EdgeModel(levels, gamma=3.0, zeta=7.0)
    assert energy(*there, model) == pytest.approx(naive.energy(y, x, h, v, model), abs=1e-9)


def test_rows_of_several_pieces_are_summed_alike() -> None:
    random = np.random.default_rng(0)
    y = random.normal(1, 1, (3, 150)).astype(np.float32)
    x = random.integers(0, 3, y.shape).astype(np.uint8)
    fields = y, x, x % 2, (x + 1) % 2
    expected = energy_terms(*fields, 3)
    assert_same(energy_terms(*map(to_device, fields), 3), expected)
    assert expected.squares == pytest.approx(float(((y.astype(float) - x) ** 2).sum()), rel=1e-12)


def test_values_out_of_range_are_refused() -> None:
    y, x = to_device(np.zeros((2, 3), np.float32)), to_device(np.full((2, 3), 2, np.uint8))
    with pytest.raises(ValueError, match="labels must be from 0 to 1"):
        energy_terms(y, x, None, None, 2)
    with pytest.raises(ValueError, match="horizontal must be from 0 to 1"):
        energy_terms(y, x, x, None, 3)
    with pytest.raises(TypeError, match="mixed"):
        energy_terms(y, np.zeros((2, 3), np.uint8), None, None, 2)
