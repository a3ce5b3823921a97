"""Line points, links and Gaussian derivatives on the device have the bits of the CPU; widths agree closely."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tests.naive.ridges import ridges as naive
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.image.device import gaussian as grids
from tilepipe_kernels.image.gaussian import fill_nodata, gaussian_derivatives, gaussian_smooth
from tilepipe_kernels.ridges.bar_profile import position_standard_error
from tilepipe_kernels.ridges.device import points as point_grids
from tilepipe_kernels.ridges.device import width as width_grids
from tilepipe_kernels.ridges.links import link_points, neighbour_table
from tilepipe_kernels.ridges.points import LinePoints, line_points
from tilepipe_kernels.ridges.width import line_widths


def texture(shape: tuple[int, int], seed: int = 0) -> NDArray[np.float32]:
    noise = np.random.default_rng(seed).standard_normal(shape)
    return (100 + 120 * ndimage.gaussian_filter(noise, 1)).astype(np.float32)


def with_holes(image: NDArray[np.float32]) -> NDArray[np.float32]:
    holed = image.copy()
    holed[np.random.default_rng(1).random(image.shape) < 0.1] = np.nan
    holed[:5, :6] = np.inf
    return holed


def moved(points: LinePoints) -> LinePoints:
    return LinePoints(**{name: to_device(column) for name, column in vars(points).items()})


def assert_same(found: Any, expected: Any) -> None:
    for name, column in vars(expected).items():
        assert on_device(getattr(found, name)), name
        assert getattr(found, name).dtype == column.dtype, name
        np.testing.assert_array_equal(to_host(getattr(found, name)), column, err_msg=name)


def wide_sigma() -> float:
    """A scale whose kernels are too wide for tiles."""
    return (grids.LARGEST_RADIUS + 1) / 4


@pytest.mark.parametrize("shape", [(9, 22), (17, 3), (1, 1)])
@pytest.mark.parametrize("sigma", [0.5, 1.0, None])
def test_derivatives_have_the_bits_of_the_cpu(shape: tuple[int, int], sigma: float | None) -> None:
    block, sigma = texture(shape), sigma or wide_sigma()
    found, oracle = gaussian_derivatives(to_device(block), sigma), naive.gaussian_derivatives(block, sigma)
    for ours, theirs, direct in zip(found, gaussian_derivatives(block, sigma), oracle, strict=True):
        assert on_device(ours)
        np.testing.assert_array_equal(to_host(ours), theirs)
        np.testing.assert_allclose(theirs, direct, rtol=0, atol=1e-3)


@pytest.mark.parametrize("sigma", [0.6, 1.5])
def test_smoothed_image_has_the_bits_of_the_cpu(sigma: float) -> None:
    block = texture((13, 11))
    found = gaussian_smooth(to_device(block), sigma)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), gaussian_smooth(block, sigma))


def test_missing_pixels_are_filled_alike() -> None:
    block = with_holes(texture((16, 14)))
    block[:9, :9] = np.nan
    filled, valid = fill_nodata(to_device(block), 0.7)
    expected, expected_valid = fill_nodata(block, 0.7)
    assert on_device(filled, valid) and np.isnan(expected).any()
    np.testing.assert_array_equal(to_host(valid), expected_valid)
    # the CPU's compiler may fuse products here, which rounds doubles otherwise
    np.testing.assert_allclose(to_host(filled), expected, rtol=2e-7)
    assert fill_nodata(to_device(texture((3, 3))), 0.7)[1] is None


@pytest.mark.parametrize("sigma", [0.8, None])
@pytest.mark.parametrize("dark", [True, False])
def test_points_have_the_bits_of_the_cpu(sigma: float | None, dark: bool) -> None:
    block, sigma = texture((17, 19)), sigma or wide_sigma()
    mask = np.ones(block.shape, bool)
    mask[:9, 3:15] = False
    for chosen in (None, mask):
        found = line_points(
            to_device(block), sigma, low=0.5, mask=None if chosen is None else to_device(chosen), dark=dark
        )
        expected = line_points(block, sigma, low=0.5, mask=chosen, dark=dark)
        assert len(expected) > 5
        assert_same(found, expected)


def test_points_are_those_of_the_oracle() -> None:
    block = texture((14, 15), seed=3)
    found, expected = line_points(to_device(block), 0.8, low=0.5), naive.line_points(block, 0.8, 0.5, True)
    sites = set(zip(to_host(found.row).tolist(), to_host(found.col).tolist(), strict=True))
    assert len(expected) > 20
    assert len(sites ^ expected.keys()) <= 1


def test_points_beside_missing_pixels() -> None:
    block = with_holes(texture((15, 16)))
    expected = line_points(block, 0.6, low=0.3)
    found = line_points(to_device(block), 0.6, low=0.3)
    assert_same(LinePoints(found.row, found.col, *(found.dx,) * 5), LinePoints(
        expected.row, expected.col, *(to_host(found.dx),) * 5
    ))  # fmt: skip
    np.testing.assert_allclose(to_host(found.response), expected.response, rtol=1e-4)


def test_more_points_than_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    block = texture((12, 12))
    monkeypatch.setattr(point_grids, "EXPECTED_SHARE", 0.01)
    assert_same(line_points(to_device(block), 0.6, low=0.1), line_points(block, 0.6, low=0.1))


def test_no_points() -> None:
    found = line_points(to_device(np.ones((8, 8), np.float32)), 1.0, low=0.1)
    assert len(found) == 0 and on_device(found.row)
    assert link_points(found).shape == (0,)
    widths = line_widths(to_device(np.ones((8, 8), np.float32)), found, 1.0, maximum_width=4.0)
    assert on_device(widths.valid) and widths.valid.shape == (0,)


def test_standard_error_stays_on_the_device() -> None:
    response = np.array([0.5, 2.0, 40.0], np.float32)
    found = position_standard_error(to_device(response), 1.5, 3.0)
    assert on_device(found)
    np.testing.assert_array_equal(to_host(found), position_standard_error(response, 1.5, 3.0))


def test_block_and_mask_do_not_mix() -> None:
    with pytest.raises(TypeError, match="mixed"):
        line_points(to_device(texture((8, 8))), 1.0, low=0.1, mask=np.ones((8, 8), bool))


@pytest.mark.parametrize("seed", range(4))
def test_links_are_those_of_the_cpu(seed: int) -> None:
    points = line_points(texture((24, 23), seed), 0.6, low=0.02)
    neighbours, links = neighbour_table(moved(points)), link_points(moved(points))
    assert on_device(neighbours, links)
    np.testing.assert_array_equal(to_host(neighbours), neighbour_table(points))
    np.testing.assert_array_equal(to_host(links), link_points(points))
    assert links.dtype == np.uint8 and naive.is_symmetric(points, to_host(links))


def test_small_loops_are_cut_alike() -> None:
    """A full square of points, all of one direction, has every kind of loop."""
    random = np.random.default_rng(5)
    row, col = (index.ravel().astype(np.int32) for index in np.indices((6, 7)))
    dx, dy = random.uniform(-0.6, 0.6, (2, row.size)).astype(np.float32)
    angle = random.uniform(-1.5, 1.5, row.size)
    points = LinePoints(
        row, col, dx, dy, np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32), np.ones_like(dx)
    )
    links = link_points(points)
    np.testing.assert_array_equal(to_host(link_points(moved(points))), links)
    assert not naive.has_loop_of_three_or_four(naive.graph(points, links))


@pytest.mark.parametrize("dark", [True, False])
def test_widths_agree_with_the_cpu(dark: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    block = texture((18, 17))
    points = line_points(block, 1.0, low=0.1, dark=dark)
    monkeypatch.setattr(width_grids, "MOST_SAMPLES", 300)
    found = line_widths(to_device(block), moved(points), 1.0, maximum_width=5.0, dark=dark)
    expected = line_widths(block, points, 1.0, maximum_width=5.0, dark=dark)
    assert on_device(found.left, found.contrast, found.valid)
    np.testing.assert_array_equal(to_host(found.valid), expected.valid)
    assert expected.valid.any() and not expected.valid.all()
    for name in ("left", "right", "shift", "contrast"):
        np.testing.assert_allclose(to_host(getattr(found, name)), getattr(expected, name), rtol=1e-5, atol=1e-5)
