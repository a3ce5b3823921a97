"""Nonlinear diffusion: the equations, the laws of tiling and of nodata, and stability."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naive.image import diffusion as naive
from tilepipe_kernels.image import diffusion
from tilepipe_kernels.image.diffusion import diffuse, halo, largest_stable_time_step

MODELS = ["curvature", "perona-malik-exponential", "perona-malik-rational"]
MODEL = pytest.mark.parametrize("model", MODELS)


def options(model: str, **changes: Any) -> dict[str, Any]:
    conductance = 1.0 if model == "curvature" else 20.0
    given = {
        "steps": 3,
        "time_step": largest_stable_time_step(model),  # type: ignore[arg-type]
        "conductance": conductance,
        "gradient_sigma": 1.0,
        "fidelity": 0.3,
        "model": model,
    }
    return given | changes


def scene(shape: tuple[int, int], seed: int = 0, missing: float = 0.0) -> NDArray[np.float32]:
    """A bright and a dark half with noise, and some nodata."""
    random = np.random.default_rng(seed)
    image = random.normal(120, 15, shape)
    image[:, shape[1] // 2 :] -= 90
    image[random.random(shape) < missing] = np.nan
    return image.astype(np.float32)


@MODEL
@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0, 1.7])
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_follows_the_equation(model: str, sigma: float, missing: float) -> None:
    image = scene((17, 23), missing=missing)
    chosen = options(model, gradient_sigma=sigma, steps=4, time_step=0.2)
    expected = naive.diffuse(image.astype(float), 4, 0.2, chosen["conductance"], sigma, 0.3, model)
    result = diffuse(image, **chosen)
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, expected, atol=1e-3, rtol=0)
    assert np.nanmax(np.abs(result - image)) > 1


@MODEL
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_tiling_is_invisible(model: str, data: st.DataObject) -> None:
    rows, columns = data.draw(st.integers(1, 60)), data.draw(st.integers(1, 60))
    sigma, steps = data.draw(st.sampled_from([0.0, 0.6, 1.0])), data.draw(st.integers(0, 11))
    image = scene((rows, columns), seed=data.draw(st.integers(0, 9)), missing=data.draw(st.sampled_from([0, 0.02])))
    chosen = options(model, steps=steps, gradient_sigma=sigma)
    r0, c0 = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    r1, c1 = data.draw(st.integers(r0 + 1, rows)), data.draw(st.integers(c0 + 1, columns))
    width = halo(steps, sigma, model)  # type: ignore[arg-type]
    top, left = max(0, r0 - width), max(0, c0 - width)
    tile = image[top : r1 + width, left : c1 + width]
    core = (r0 - top, r1 - top, c0 - left, c1 - left)
    expected = diffuse(image, **chosen)[r0:r1, c0:c1]
    np.testing.assert_array_equal(diffuse(tile, core=core, **chosen), expected)
    np.testing.assert_array_equal(diffuse(tile, **chosen)[core[0] : core[1], core[2] : core[3]], expected)


@MODEL
@pytest.mark.parametrize("sigma", [0.0, 1.0])
def test_halo_is_exact(model: str, sigma: float) -> None:
    width = halo(2, sigma, model)  # type: ignore[arg-type]
    image = scene((2 * width + 3, 2 * width + 3))
    conductance = 0.01 if model == "curvature" else 1e6
    chosen = options(model, steps=2, gradient_sigma=sigma, conductance=conductance, fidelity=1.0)
    within, outside = image.copy(), image.copy()
    within[width + 1, 1] += 1e5
    outside[[0, -1]] += 1e5
    outside[:, [0, -1]] += 1e5
    centre = diffuse(image, **chosen)[width + 1, width + 1]
    assert diffuse(within, **chosen)[width + 1, width + 1] != centre
    assert diffuse(outside, **chosen)[width + 1, width + 1] == centre


@MODEL
def test_steps_in_flight_change_no_bit(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    image = scene((40, 300), missing=0.001)
    several = diffuse(image, **options(model, steps=19))
    monkeypatch.setattr(diffusion, "_MOST_STEPS_AT_ONCE", 1)
    np.testing.assert_array_equal(diffuse(image, **options(model, steps=19)), several)


@MODEL
def test_nodata_stays_and_does_not_leak(model: str) -> None:
    image = scene((40, 50), missing=0.2)
    image[5, 5], image[20, 20] = np.inf, -np.inf
    image[:, 30] = np.nan
    chosen = options(model, steps=9)
    result = diffuse(image, **chosen)
    np.testing.assert_array_equal(np.isnan(result), ~np.isfinite(image))
    # A wall of nodata wider than one step's reach parts the image for good.
    image[:, 25:35] = np.nan
    changed = image.copy()
    changed[:, 35:] = 7
    np.testing.assert_array_equal(diffuse(image, **chosen)[:, :25], diffuse(changed, **chosen)[:, :25])


@MODEL
def test_far_nodata_changes_no_bit(model: str) -> None:
    image = scene((80, 90))
    chosen = options(model, steps=3)
    width = halo(3, 1.0, model)  # type: ignore[arg-type]
    broken = image.copy()
    broken[40, 45] = np.nan
    far = np.ones(image.shape, bool)
    far[40 - width : 41 + width, 45 - width : 46 + width] = False
    np.testing.assert_array_equal(diffuse(image, **chosen)[far], diffuse(broken, **chosen)[far])


@MODEL
@pytest.mark.parametrize("value", [0.0, 77.3, 255.0])
def test_constant_image_stays(model: str, value: float) -> None:
    image = np.full((30, 40), value, np.float32)
    np.testing.assert_array_equal(diffuse(image, **options(model, steps=9)), image)
    image[np.random.default_rng(0).random(image.shape) < 0.3] = np.nan
    np.testing.assert_array_equal(diffuse(image, **options(model, steps=9)), image)


@MODEL
@pytest.mark.parametrize("pattern", ["noise", "checkerboard", "impulses", "stripes", "diagonals", "salt"])
def test_no_new_extrema_at_the_bound(model: str, pattern: str) -> None:
    random = np.random.default_rng(3)
    i, j = np.indices((40, 41))
    image = {
        "noise": random.normal(128, 60, i.shape).clip(0, 255),
        "checkerboard": (i + j) % 2 * 255,
        "impulses": (i % 7 == 0) * (j % 5 == 0) * 255,
        "stripes": (j // 2) % 2 * 255,
        "diagonals": (i + 2 * j) % 5 * 63,
        "salt": random.integers(0, 2, i.shape) * 255,
    }[pattern].astype(np.float32)
    for conductance in (1e-6, 1.0) if model == "curvature" else (1.0, 1e6):
        before = image
        for _ in range(12):
            after = diffuse(before, **options(model, steps=1, conductance=conductance, fidelity=0.0))
            low, high = around(before, np.minimum), around(before, np.maximum)
            assert (after >= low - 1e-4).all() and (after <= high + 1e-4).all()
            before = after
        result = diffuse(image, **options(model, steps=30, conductance=conductance, fidelity=1.0))
        assert result.min() >= image.min() - 1e-4 and result.max() <= image.max() + 1e-4


def around(image: NDArray[np.float32], best: Any) -> NDArray[np.float32]:
    """Extremum of the 3 x 3 neighbourhood."""
    padded = np.pad(image, 1, mode="edge")
    rows, columns = image.shape
    return np.asarray(best.reduce([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]))


@pytest.mark.parametrize("model", MODELS[1:])
def test_perona_malik_keeps_the_mean(model: str) -> None:
    image = scene((50, 60), missing=0.1)
    result = diffuse(image, **options(model, steps=20))
    assert np.nanmean(result, dtype=float) == pytest.approx(np.nanmean(image, dtype=float), abs=1e-4)
    assert np.nanstd(result[:, :25]) < 0.5 * np.nanstd(image[:, :25])


@MODEL
def test_mirrored_image_gives_mirrored_result(model: str) -> None:
    image = scene((33, 44), missing=0.05)
    result = diffuse(image, **options(model))
    np.testing.assert_array_equal(diffuse(image[::-1], **options(model)), result[::-1])
    np.testing.assert_array_equal(diffuse(image[:, ::-1], **options(model)), result[:, ::-1])


def test_smooths_within_and_keeps_edges_between() -> None:
    image = scene((60, 60))
    result = diffuse(image, **options("curvature", steps=60, conductance=0.01, fidelity=0.0))
    assert result[:, :26].std() < 0.3 * image[:, :26].std()
    step = result[:, 33].mean() - result[:, 26].mean()
    assert step == pytest.approx(-90, abs=12)


def test_isolated_impulse_is_removed() -> None:
    image = np.zeros((9, 9), np.float32)
    image[4, 4] = 100
    assert diffuse(image, **options("curvature", steps=20, conductance=0.0, fidelity=0.0)).max() < 30


def test_where_the_gradient_vanishes_all_directions_count() -> None:
    line = np.zeros((9, 9), np.float32)
    line[:, 4] = 100
    for image in (line, line.T):
        result = diffuse(image, **options("curvature", steps=1, conductance=0.0, fidelity=0.0))
        np.testing.assert_allclose(result, image / 2, atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_step": 0.51}, "time_step <= 0.5"),
        ({"time_step": 0.0}, "not stable"),
        ({"model": "perona-malik-rational", "time_step": 0.26}, "time_step <= 0.25"),
        ({"model": "perona-malik-rational", "time_step": 0.1, "conductance": 0.0}, "conductance"),
        ({"model": "heat"}, "choose one of"),
        ({"steps": -1}, "steps"),
        ({"conductance": -1.0}, "conductance"),
        ({"gradient_sigma": -1.0}, "gradient_sigma"),
        ({"fidelity": 1.5}, "fidelity"),
        ({"core": (0, 9, 0, 99)}, "core"),
    ],
)
def test_bad_parameters_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        diffuse(scene((9, 9)), **(options("curvature") | changes))


@pytest.mark.parametrize("conductance", [1e-200, 1e-6, 1e200])
@MODEL
def test_extreme_conductance_gives_numbers(model: str, conductance: float) -> None:
    image = scene((9, 9))
    image[:, :4] = 50
    result = diffuse(image, **options(model, conductance=conductance))
    assert np.isfinite(result).all()
    assert (result[:, 0] == 50).all()


def test_bad_blocks_are_refused() -> None:
    for block in (np.zeros(5), np.zeros((4, 4), complex)):
        with pytest.raises(ValueError, match="two-dimensional real"):
            diffuse(block, **options("curvature"))
