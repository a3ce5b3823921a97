"""Diffusion on the device gives the very bits of the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.naive.image import diffusion as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.image.diffusion import diffuse, halo

MODELS = ["curvature", "perona-malik-exponential", "perona-malik-rational"]
MODEL = pytest.mark.parametrize("model", MODELS)


def options(model: str, **changes: Any) -> dict[str, Any]:
    conductance = 1.0 if model == "curvature" else 20.0
    return {"steps": 2, "time_step": 0.2, "conductance": conductance, "fidelity": 0.3, "model": model} | changes


def scene(shape: tuple[int, int], missing: float) -> NDArray[np.float32]:
    """A bright and a dark half with noise, and some nodata."""
    random = np.random.default_rng(0)
    image = random.normal(120, 15, shape)
    image[:, shape[1] // 2 :] -= 90
    image[random.random(shape) < missing] = np.nan
    return image.astype(np.float32)


@MODEL
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_bits_are_those_of_the_cpu(model: str, missing: float) -> None:
    image = scene((19, 17), missing)
    image[3, 4], image[15, 9] = np.inf, -np.inf
    found = diffuse(to_device(image), **options(model, steps=3 if model != "curvature" else 2))
    assert on_device(found)
    np.testing.assert_array_equal(
        to_host(found), diffuse(image, **options(model, steps=3 if model != "curvature" else 2))
    )
    assert np.nanmax(abs(to_host(found) - image)[np.isfinite(image)]) > 1


def test_follows_the_equation() -> None:
    image = scene((9, 11), 0.1)
    expected = naive.diffuse(image.astype(float), 1, 0.2, 1.0, 1.0, 0.3, "curvature")
    found = diffuse(to_device(image), **options("curvature", steps=1))
    np.testing.assert_allclose(to_host(found), expected, atol=1e-3, rtol=0)


# 5.0 has a reach for which tiles are too small, so that the sums go through the memory
@pytest.mark.parametrize("sigma", [0.0, 0.5, 5.0])
def test_every_scale_gives_the_bits_of_the_cpu(sigma: float) -> None:
    image = scene((11, 13), 0.1)
    chosen = options("curvature", gradient_sigma=sigma, steps=1)
    np.testing.assert_array_equal(to_host(diffuse(to_device(image), **chosen)), diffuse(image, **chosen))


def test_tiles_without_gaps_give_the_bits_of_the_cpu() -> None:
    image = scene((24, 24), 0.0)
    chosen = options("curvature", steps=1, core=(5, 19, 4, 20))
    np.testing.assert_array_equal(to_host(diffuse(to_device(image), **chosen)), diffuse(image, **chosen))


@MODEL
def test_core_is_what_the_whole_has_there(model: str) -> None:
    chosen = options(model, gradient_sigma=0.3)
    width = halo(2, 0.3, model)  # type: ignore[arg-type]
    image = scene((18, 17), 0.05)
    tile, core = image[3 : 13 + width, 5 : 11 + width], (width, 10, width, 6)
    whole = diffuse(image, **chosen)[3 : 13 + width, 5 : 11 + width]
    found = diffuse(to_device(tile), core=core, **chosen)
    np.testing.assert_array_equal(to_host(found), whole[core[0] : core[1], core[2] : core[3]])


def test_no_steps_and_no_pixels() -> None:
    image = scene((6, 5), 0.2)
    image[2, 2] = np.inf
    np.testing.assert_array_equal(
        to_host(diffuse(to_device(image), **options("curvature", steps=0))),
        diffuse(image, **options("curvature", steps=0)),
    )
    nothing = diffuse(to_device(image), **options("curvature", core=(2, 2, 0, 5)))
    assert on_device(nothing) and nothing.shape == (0, 5)
