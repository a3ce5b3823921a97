"""The energy of the edge model, against its definition, and the local energies against it."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.mrf import edge_model as naive
from tilepipe_kernels.mrf.edge_energy import energy, energy_terms
from tilepipe_kernels.mrf.edge_model import EdgeModel, element_energy, label_energy

Field = NDArray[np.uint8]


class Scene(NamedTuple):
    y: NDArray[np.float32]
    x: Field
    h: Field
    v: Field


def scene(rows: int, columns: int, levels: int, seed: int, missing: float, uncommitted: float) -> Scene:
    random = np.random.default_rng(seed)
    shape = (rows, columns)
    y = random.uniform(-0.5, levels - 0.5, shape).astype(np.float32)
    y[random.random(shape) < missing] = np.nan
    fields = [random.integers(0, k, shape).astype(np.uint8) for k in (levels, 2, 2)]
    for field in fields:
        field[random.random(shape) < uncommitted] = 255
    return Scene(y, *fields)


SHARES = st.sampled_from([0.0, 0.1, 0.4])
SCENES = st.builds(
    scene, st.integers(1, 8), st.integers(1, 9), st.sampled_from([2, 3, 16]), st.integers(0, 999), SHARES, SHARES
)
WEIGHTS = {"alpha": 0.25, "gamma": 3.0, "xi": 0.625, "zeta": 7.0, "beta": 1.5, "sigma": 0.5}
POTENTIALS = st.sampled_from(["quadratic", "reciprocal"])


def model_of(potential: str, levels: int = 16) -> EdgeModel:
    return EdgeModel(levels, potential, **WEIGHTS)  # type: ignore[arg-type]


@settings(max_examples=80, deadline=None)
@given(SCENES, POTENTIALS)
def test_energy_is_its_definition(scene: Scene, potential: str) -> None:
    model = model_of(potential)
    assert energy(*scene, model) == pytest.approx(naive.energy(*scene, model), abs=1e-9)
    y, x = scene.y, scene.x
    assert energy(y, x, None, None, model) == pytest.approx(naive.energy(y, x, None, None, model), abs=1e-9)


@pytest.mark.parametrize("name", ["alpha", "gamma", "xi", "zeta", "beta", "sigma"])
def test_every_parameter_weighs_its_own_term(name: str) -> None:
    drawn = scene(12, 13, 4, 3, 0.05, 0.05)
    nothing = {"alpha": 0.0, "gamma": 0.0, "xi": 0.0, "zeta": 0.0, "beta": 0.0, "sigma": 1e9}
    model = EdgeModel(4, **nothing | {name: WEIGHTS[name]})  # type: ignore[arg-type]
    assert abs(energy(*drawn, model)) > 1
    assert energy(*drawn, model) == pytest.approx(naive.energy(*drawn, model))


@settings(max_examples=40, deadline=None)
@given(SCENES, POTENTIALS, st.integers(0, 999))
def test_change_of_a_label_changes_the_energy_by_its_local_energy(scene: Scene, potential: str, seed: int) -> None:
    y, x, h, v = scene
    model = model_of(potential)
    random = np.random.default_rng(seed)
    i, j = random.integers(0, y.shape)
    if math.isnan(y[i, j]):
        return
    around = [
        ((i - 1, j), h, (i - 1, j)),
        ((i, j - 1), v, (i, j - 1)),
        ((i, j + 1), v, (i, j)),
        ((i + 1, j), h, (i, j)),
    ]
    labels, lines = [], []
    for (k, m), field, crack in around:
        inside = 0 <= k < y.shape[0] and 0 <= m < y.shape[1] and not math.isnan(y[k, m])
        labels.append(int(x[k, m]) if inside else 255)
        lines.append(int(field[crack]) if inside else 255)
    x[i, j] = 255
    rest = energy(*scene, model)
    for label in random.integers(0, 16, 3):
        x[i, j] = label
        local = label_energy(
            float(y[i, j]), int(label), *labels, *lines, model.beta, model.sigma, model.alpha, model.reciprocal
        )
        assert local == pytest.approx(energy(*scene, model) - rest, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(SCENES, st.integers(0, 999), st.booleans())
def test_change_of_an_element_changes_the_energy_by_its_local_energy(scene: Scene, seed: int, down: bool) -> None:
    y, x, h, v = scene
    model = model_of("quadratic")
    rows, columns = y.shape
    random = np.random.default_rng(seed)
    i, j = (int(n) for n in random.integers(0, y.shape))

    def element(field: Field, i: int, j: int) -> int:
        k, m = (i + 1, j) if field is h else (i, j + 1)
        if not (i >= 0 and k < rows and j >= 0 and m < columns) or math.isnan(y[i, j]) or math.isnan(y[k, m]):
            return 255
        return int(field[i, j])

    field, other = (h, v) if down else (v, h)
    di, dj = (1, 0) if down else (0, 1)
    if i + di >= rows or j + dj >= columns or math.isnan(y[i, j]) or math.isnan(y[i + di, j + dj]):
        return
    known = x[i, j] != 255 and x[i + di, j + dj] != 255
    contrast = (float(x[i, j]) - float(x[i + di, j + dj])) ** 2 if known else 0.0
    along = [element(field, i + n * dj, j + n * di) for n in (-2, -1, 1, 2)]
    across = [element(field, i + n * di, j + n * dj) for n in (-2, -1, 1, 2)]
    corners = [element(other, i + k * di - n * dj, j + k * dj - n * di) for k in (0, 1) for n in (0, 1)]
    field[i, j] = 255
    rest = energy(*scene, model)
    for value in (0, 1):
        field[i, j] = value
        local = element_energy(
            value, contrast, *along, *across, *corners, model.alpha, model.gamma, model.xi, model.zeta
        )
        assert local == pytest.approx(energy(*scene, model) - rest, abs=1e-9)


def test_terms_of_tiles_add_up() -> None:
    drawn = scene(23, 31, 4, 8, 0.1, 0.1)
    whole = energy_terms(*drawn, 4)
    parts = []
    for rows, columns in ((slice(0, 9), slice(0, 31)), (slice(9, 23), slice(0, 14)), (slice(9, 23), slice(14, 31))):
        block = tuple(slice(max(s.start - 2, 0), s.stop + 2) for s in (rows, columns))
        core = tuple(slice(s.start - b.start, s.stop - b.start) for s, b in zip((rows, columns), block, strict=True))
        parts.append(energy_terms(*(field[block] for field in drawn), 4, core=core))  # type: ignore[arg-type]
    for name, value in (parts[0] + parts[1] + parts[2])._asdict().items():
        np.testing.assert_allclose(value, getattr(whole, name), rtol=1e-12, err_msg=name)


def test_what_does_not_exist_counts_for_nothing() -> None:
    y, x, h, v = scene(9, 9, 4, 1, 0.2, 0.1)
    model = model_of("reciprocal", 4)
    before = energy(y, x, h, v, model)
    gone = np.isnan(y)
    x[gone] = 3 - x[gone] % 4
    h[-1], v[:, -1] = 1 - h[-1] % 2, 1 - v[:, -1] % 2
    h[gone] = v[gone] = 1
    assert energy(y, x, h, v, model) == before
    assert energy(np.full((2, 2), np.nan), np.zeros((2, 2)).astype(int), None, None, model) == 0.0


def test_pairwise_table() -> None:
    np.testing.assert_allclose(EdgeModel(3, beta=2.0).pairwise(), [[-2, -1, -2 / 3], [-1, -2, -1], [-2 / 3, -1, -2]])
    np.testing.assert_array_equal(EdgeModel(3, "quadratic").pairwise(), [[0, 1, 4], [1, 0, 1], [4, 1, 0]])


def test_bad_input_is_refused() -> None:
    for parameters in ({"levels": 1}, {"levels": 255}, {"alpha": -1.0}, {"beta": math.nan}, {"sigma": 0.0}):
        with pytest.raises(ValueError, match=next(iter(parameters))):
            EdgeModel(**parameters)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="potential"):
        EdgeModel(potential="linear")  # type: ignore[arg-type]
    with pytest.raises(dataclasses.FrozenInstanceError):
        EdgeModel().beta = 2.0  # type: ignore[misc]
    y, x, h, v = scene(4, 5, 2, 0, 0.0, 0.0)
    model = EdgeModel()
    with pytest.raises(ValueError, match="shape"):
        energy(y, x[1:], h, v, model)
    with pytest.raises(ValueError, match="labels must be from 0 to 1"):
        energy(y, x + 2, h, v, model)
    with pytest.raises(ValueError, match="vertical must be from 0 to 1"):
        energy(y, x, h, v + 2, model)
    with pytest.raises(ValueError, match="integers"):
        energy(y, x.astype(float), h, v, model)
    with pytest.raises(ValueError, match="observed"):
        energy(y[0], x, h, v, model)
