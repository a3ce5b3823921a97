"""The line detector against direct sums, synthetic bars with known truth, and its own tiles."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tests.naive.ridges import ridges as naive
from tilepipe_kernels.image.gaussian import gaussian_derivatives
from tilepipe_kernels.ridges import bar_profile, ridges
from tilepipe_kernels.ridges.bar_profile import (
    position_standard_error,
    response_bins,
    response_of_bar,
    sigma_for_width,
    thresholds_from_histogram,
)
from tilepipe_kernels.ridges.links import LINK_RADIUS, NEIGHBOUR_OFFSETS, link_points, neighbour_table
from tilepipe_kernels.ridges.points import line_points
from tilepipe_kernels.ridges.width import line_widths

LENIENT = settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))


def texture(shape, seed=0, scale=2.0):
    rng = np.random.default_rng(seed)
    return (100 + 60 * ndimage.gaussian_filter(rng.standard_normal(shape), scale) * scale).astype(np.float32)


def fields(points):
    return [getattr(points, field.name) for field in dataclasses.fields(points)]


def central(points, shape, margin):
    rows, columns = shape
    return (
        (points.row >= margin) & (points.row < rows - margin) & (points.col >= margin) & (points.col < columns - margin)
    )


@pytest.mark.parametrize("sigma", [0.8, 1.5, 4.0])
@pytest.mark.parametrize("shape", [(21, 83), (67, 9)])
def test_derivatives_equal_direct_sums(sigma, shape):
    block = texture(shape)
    for ours, theirs in zip(gaussian_derivatives(block, sigma), naive.gaussian_derivatives(block, sigma), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=4e-5)


def test_derivatives_agree_with_scipy():
    block = texture((80, 90), scale=4.0).astype(np.float64)
    for ours, order in zip(gaussian_derivatives(block, 3.0), [(0, 1), (1, 0), (0, 2), (1, 1), (2, 0)], strict=True):
        theirs = ndimage.gaussian_filter(block, 3.0, order=order, mode="nearest")
        assert abs(ours - theirs).max() < 0.01 * abs(theirs).max()


def test_derivatives_keep_the_sum_rules():
    for image in gaussian_derivatives(np.full((40, 70), 60001.7, np.float32), 2.3):
        assert (image == 0).all()
    row, col = np.mgrid[:60, :80].astype(np.float32)
    core = np.s_[15:-15, 15:-15]
    r_x, r_y, r_xx, r_xy, r_yy = gaussian_derivatives(2 * col - row + col * col / 2, 3.0)
    np.testing.assert_allclose(r_x[core], (2 + col)[core], rtol=1e-4)
    np.testing.assert_allclose(r_y[core], -1, rtol=3e-3)
    np.testing.assert_allclose(r_xx[core], 1, rtol=1e-3)
    assert abs(r_xy[core]).max() < 1e-3
    assert abs(r_yy[core]).max() < 1e-3


@pytest.mark.parametrize("dark", [True, False])
def test_points_equal_the_eigenvector_oracle(dark):
    block = texture((45, 77), seed=3)
    points = line_points(block, 1.5, low=0.5, dark=dark)
    expected = naive.line_points(block, 1.5, 0.5, dark)
    found = {(int(r), int(c)): values for r, c, *values in zip(*fields(points), strict=True)}
    assert len(expected) > 100
    # Sites on a threshold may fall to either side by rounding.
    assert len(found.keys() ^ expected.keys()) <= 2
    for site in found.keys() & expected.keys():
        np.testing.assert_allclose(found[site], expected[site], rtol=0, atol=2e-3)
    key = points.row.astype(np.int64) * 77 + points.col
    assert (np.diff(key) > 0).all()


def test_dark_lines_are_bright_lines_of_the_negative():
    block = texture((60, 70))
    for dark, bright in zip(
        fields(line_points(block, 2.0, low=0.2)),
        fields(line_points(-block, 2.0, low=0.2, dark=False)),
        strict=True,
    ):
        np.testing.assert_array_equal(dark, bright)


@pytest.mark.parametrize("angle", np.linspace(0, math.pi, 7))
def test_points_lie_on_a_bar_at_any_angle(angle):
    block, across = naive.bar((90, 100), angle, 0.37, 4.0)
    points = line_points(block, 4.0, low=1.0)
    inner = points.take(central(points, block.shape, 20))
    error = across[inner.row, inner.col] + inner.dx * math.cos(angle) + inner.dy * math.sin(angle)
    assert len(inner) >= 50
    assert abs(error).max() < 0.02
    assert abs(abs(inner.nx * math.cos(angle) + inner.ny * math.sin(angle)) - 1).max() < 1e-3
    expected = response_of_bar(4.0, 100.0, 4.0)
    assert abs(np.median(inner.response) / expected - 1) < 0.01


@LENIENT
@given(seed=st.integers(0, 99), share=st.floats(0, 1))
def test_masking_only_removes_points(seed, share):
    rng = np.random.default_rng(seed)
    block = texture((70, 150), seed)
    mask = np.kron(rng.random((7, 5)) < share, np.ones((10, 30))).astype(bool)
    every = line_points(block, 1.5, low=0.2)
    masked = line_points(block, 1.5, low=0.2, mask=mask)
    for ours, theirs in zip(fields(masked), fields(every.take(mask[every.row, every.col])), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@LENIENT
@given(
    top=st.integers(0, 70),
    left=st.integers(0, 100),
    height=st.integers(1, 40),
    width=st.integers(1, 90),
    holes=st.booleans(),
    seed=st.integers(0, 5),
)
def test_tiles_are_invisible(top, left, height, width, holes, seed):
    sigma, maximum_width = 1.2, 6.0
    block = texture((110, 190), seed)
    mask = texture((110, 190), seed + 50, scale=8.0) > 95
    if holes:
        block[np.random.default_rng(seed).random(block.shape) < 0.02] = np.nan
        block[50:90, 60:100] = np.nan

    def lines(view):
        points = line_points(block[view], sigma, low=0.3, mask=mask[view])
        widths = line_widths(block[view], points, sigma, maximum_width=maximum_width)
        return points, [*fields(points)[2:], link_points(points), *fields(widths)]

    halo = ridges.halo(sigma, maximum_width)
    bottom, right = min(top + height, 110), min(left + width, 190)
    row, col = max(top - halo, 0), max(left - halo, 0)
    whole, whole_values = lines(np.s_[:, :])
    tile, tile_values = lines(np.s_[row : bottom + halo, col : right + halo])

    def inside(points, row, col):
        r, c = points.row + row, points.col + col
        return (r >= top) & (r < bottom) & (c >= left) & (c < right)

    chosen, expected = inside(tile, row, col), inside(whole, 0, 0)
    np.testing.assert_array_equal(tile.row[chosen] + row, whole.row[expected])
    np.testing.assert_array_equal(tile.col[chosen] + col, whole.col[expected])
    for ours, theirs in zip(tile_values, whole_values, strict=True):
        np.testing.assert_array_equal(ours[chosen], theirs[expected])


def test_nodata_holds_no_points_and_makes_none():
    block, _ = naive.bar((80, 80), 0.3, 0.2, 3.0)
    rng = np.random.default_rng(1)
    missing = rng.random(block.shape) < 0.1
    missing[:30, :30] = True
    holed = np.where(missing, np.nan, block)
    points = line_points(holed, 3.0, low=1.0)
    assert len(points) > 30
    assert not missing[points.row, points.col].any()
    whole = line_points(block, 3.0, low=0.7)
    away = ndimage.binary_dilation(
        np.isin(np.arange(block.size), whole.row * 80 + whole.col).reshape(block.shape), np.ones((3, 3)), 2
    )
    assert away[points.row, points.col].all()
    assert len(line_points(np.full((20, 20), np.nan), 2.0, low=0.1)) == 0


@pytest.mark.parametrize("noise", [0.0, 10.0])
@pytest.mark.parametrize("angle", np.linspace(0, math.pi, 9))
def test_a_bar_becomes_one_path(angle, noise):
    block, _ = naive.bar((96, 96), angle, 0.37, 4.0)
    block = block + noise * np.random.default_rng(7).standard_normal(block.shape)
    points = line_points(block, 4.0, low=1.0)
    links = link_points(points)
    adjacency = naive.graph(points, links)
    assert naive.is_symmetric(points, links)
    assert len(naive.components(adjacency)) == 1
    assert sorted(len(nearby) for nearby in adjacency.values() if nearby)[-1] == 2


def test_a_ring_is_closed():
    row, col = np.mgrid[:90, :90]
    block = 200 - 100 * (abs(np.hypot(col - 44.3, row - 45.8) - 30) < 4)
    points = line_points(block, 4.0, low=1.0)
    adjacency = naive.graph(points, link_points(points))
    assert len(naive.components(adjacency)) == 1
    assert {len(nearby) for nearby in adjacency.values() if nearby} == {2}


@pytest.mark.parametrize("turn", [0.0, 0.2, 0.4, 1.1])
def test_a_t_has_one_junction(turn):
    bar, _ = naive.bar((96, 96), 0.1 + turn, 0.3, 4.0)
    stem, _ = naive.bar((96, 96), 1.67 + turn, 0.3, 4.0)
    _, side = naive.bar((96, 96), 0.1 + turn, 0.3, 4.0)
    block = np.minimum(bar, np.where(side < 0, stem, 200))
    points = line_points(block, 4.0, low=1.0)
    degree = np.bitwise_count(link_points(points))
    adjacency = naive.graph(points, link_points(points))
    assert len(naive.components(adjacency)) == 1
    assert (degree == 3).sum() == 1
    assert (degree > 3).sum() == 0
    assert (degree == 1).sum() == 3


def test_parallel_lines_stay_apart():
    block = np.minimum(naive.bar((90, 90), 0.4, -7.0, 3.0)[0], naive.bar((90, 90), 0.4, 7.0, 3.0)[0])
    points = line_points(block, 3.0, low=1.0)
    assert len(naive.components(naive.graph(points, link_points(points)))) == 2


@pytest.mark.parametrize("seed", range(4))
def test_links_of_noise_are_symmetric_and_without_small_loops(seed):
    points = line_points(texture((120, 130), seed, scale=1.0), 1.3, low=0.05)
    links = link_points(points)
    adjacency = naive.graph(points, links)
    assert len(points) > 1000
    assert naive.is_symmetric(points, links)
    assert not naive.has_loop_of_three_or_four(adjacency)


@LENIENT
@given(top=st.integers(0, 90), left=st.integers(0, 90), size=st.integers(1, 30), seed=st.integers(0, 9))
def test_links_depend_on_their_stated_radius_only(top, left, size, seed):
    points = line_points(texture((120, 120), seed, scale=1.0), 1.0, low=0.02)
    links = link_points(points)

    def window(margin):
        row, col = points.row - top, points.col - left
        return (row >= -margin) & (row < size + margin) & (col >= -margin) & (col < size + margin)

    padded = window(LINK_RADIUS)
    np.testing.assert_array_equal(link_points(points.take(padded))[window(0)[padded]], links[window(0)])


def test_neighbour_table_equals_search():
    points = line_points(texture((40, 50), 2, scale=1.0), 1.0, low=0.05)
    at = {(int(r), int(c)): i for i, (r, c) in enumerate(zip(points.row, points.col, strict=True))}
    expected = [[at.get((r + down, c + right), -1) for down, right in NEIGHBOUR_OFFSETS] for r, c in at]
    np.testing.assert_array_equal(neighbour_table(points), expected)


@pytest.mark.parametrize("half_width", [3.0, 4.0, 6.0])
@pytest.mark.parametrize("asymmetry", [0.0, 0.5])
@pytest.mark.parametrize("dark", [True, False])
def test_width_position_and_contrast_are_unbiased(half_width, asymmetry, dark):
    angle, sign = 0.6, -1.0 if dark else 1.0
    block, across = naive.bar((110, 110), angle, 0.3, half_width, sign * 100, asymmetry)
    points = line_points(block, 4.0, low=0.2, dark=dark)
    near = central(points, block.shape, 30) & (abs(across[points.row, points.col]) < 5)
    points = points.take(near)
    widths = line_widths(block, points, 4.0, maximum_width=18, dark=dark)
    side = np.sign(points.nx * math.cos(angle) + points.ny * math.sin(angle))
    position = across[points.row, points.col] + points.dx * math.cos(angle) + points.dy * math.sin(angle)
    assert len(points) > 30
    assert widths.valid.all()
    assert (asymmetry == 0) or abs(position).max() > 0.8
    assert abs(position + side * widths.shift).max() < 0.05
    assert abs(widths.left - half_width).max() < 0.25
    assert (widths.left == widths.right).all()
    assert abs(widths.contrast - 100).max() < 5


@pytest.mark.parametrize("half_width", [0.2, 0.5, 1.0, 1.73, 2.5, 4.0])
@pytest.mark.parametrize("asymmetry", [0.0, 1e-6, 0.05, 0.5, 0.9])
def test_bar_inversion_equals_root_search(half_width, asymmetry):
    x = np.linspace(1e-9, 14, 500_001)
    gaussian = np.exp(-0.5 * (x - half_width) ** 2), np.exp(-0.5 * (x + half_width) ** 2)
    rest = 1 - asymmetry
    weak, strong = rest * gaussian[0] - gaussian[1], gaussian[0] - rest * gaussian[1]
    outside = x > half_width
    far, near = (x[outside][np.argmax(side[outside])] for side in (weak, strong))
    log_ratio = min(math.log(weak[outside].max() / strong[outside].max()), 0.0)
    if log_ratio < bar_profile.FAINTEST_EDGE:
        pytest.skip("no edge on the weak side")
    width, offset, distance = bar_profile.bar_from_edges(far + near, log_ratio)
    assert abs(width - half_width) < 2e-3
    assert abs(distance - near) < 2e-3
    assert abs(offset + math.log(rest) / (2 * half_width)) < 4e-3


def test_bar_inversion_refuses_what_no_bar_shows():
    assert math.isnan(bar_profile.bar_from_edges(1.9, -0.1)[0])
    assert math.isnan(bar_profile.bar_from_edges(2.1, -3.0)[0])


def test_widths_are_missing_where_there_is_no_edge():
    _row, col = np.mgrid[:60, :60].astype(float)
    block = (col - 30) ** 2
    points = line_points(block, 2.0, low=0.5)
    widths = line_widths(block, points, 2.0, maximum_width=8)
    assert len(points)
    assert not widths.valid.any()
    assert np.isnan(widths.contrast).all()
    inner = central(points, block.shape, 15)
    assert np.isnan(widths.left[inner]).all()
    assert (widths.shift == 0).all()


def test_position_standard_error_by_monte_carlo():
    sigma, noise, rng = 3.0, 6.0, np.random.default_rng(11)
    clean, _ = naive.bar((1200, 40), 0.0, 0.0, 3.0)
    points = line_points(clean + noise * rng.standard_normal(clean.shape), sigma, low=1.0)
    near = abs(points.col - 20) <= 1
    position = (points.col + points.dx - 20)[near]
    expected = position_standard_error(response_of_bar(3.0, 100.0, sigma), sigma, noise)
    assert abs(position.std() / expected - 1) < 0.15


def test_thresholds_part_three_classes():
    rng = np.random.default_rng(5)
    responses = np.exp(np.concatenate([rng.normal(m, 0.2, 4000) for m in (-2, 0, 2)]))
    edges = response_bins(0.01, 100)
    low, high = thresholds_from_histogram(np.histogram(responses, edges)[0], edges)
    assert math.exp(-1.5) < low < math.exp(-0.5)
    assert math.exp(0.5) < high < math.exp(1.5)


def test_scale_rule():
    assert sigma_for_width(2 * math.sqrt(3)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: line_points(np.zeros(4), 1.0, low=1), "shape"),
        (lambda: line_points(np.zeros((4, 4), complex), 1.0, low=1), "dtype"),
        (lambda: line_points(np.zeros((4, 4)), 0.0, low=1), "sigma"),
        (lambda: line_points(np.zeros((4, 4)), 1.0, low=0), "low"),
        (lambda: line_points(np.zeros((4, 4)), 1.0, low=1, mask=np.ones((3, 4))), "mask"),
        (lambda: ridges.halo(1.0, -1.0), "maximum_width"),
        (lambda: thresholds_from_histogram(np.array([0, 5, 0]), np.array([1.0, 2, 3, 4])), "bins"),
        (lambda: sigma_for_width(0), "width"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_empty_and_tiny_blocks():
    for shape in ((1, 1), (1, 200), (200, 1)):
        points = line_points(np.ones(shape), 2.0, low=0.1)
        assert len(points) == 0
        assert link_points(points).size == 0
        assert len(line_widths(np.ones(shape), points, 2.0, maximum_width=5).left) == 0
