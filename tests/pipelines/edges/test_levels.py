"""Photographs of any bands become grey, and the grey levels of the whole follow from counts, however they are tiled."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from tests.parameters import edge_parameters
from tilepipe.errors import InputError
from tilepipe.pipelines.edges.pass_bands import LUMINANCE, open_photograph, principal_weights, sample_bands
from tilepipe.pipelines.edges.pass_levels import CountContext, count_greys, edge_threshold, level_scale
from tilepipe.tiling.grid import TileGrid, Window
from tilepipe.tiling.histograms import added
from tilepipe_kernels.image.grey_levels import LEVEL_STEPS, to_levels
from tilepipe_kernels.image.histogram import class_means
from tilepipe_kernels.nevatia_babu import elements as edge_elements

WHOLE = Window(0, 0, 40, 60)


@pytest.fixture
def write(tmp_path):
    def image(bands, colours=None, nodata=None, name="photo.tif"):
        bands = np.asarray(bands)
        path = tmp_path / name
        profile = {"driver": "GTiff", "count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
        profile |= {"dtype": bands.dtype, "crs": "EPSG:32633", "transform": from_origin(0, 40, 1, 1), "nodata": nodata}
        with rasterio.open(path, "w", photometric="MINISBLACK", **profile) as file:
            file.write(bands)
            file.colorinterp = colours or [ColorInterp.gray] + [ColorInterp.undefined] * (len(bands) - 1)
        return path

    return image


def bands(count: int) -> np.ndarray:
    return np.random.default_rng(count).integers(1, 256, (count, 40, 60), dtype=np.uint8)


def opened(path, band=None, grey="automatic"):
    return open_photograph([str(path)], crs=None, band=band, grey=grey)


def test_three_bands_are_red_green_and_blue(write):
    values = bands(3)
    photograph = opened(write(values))
    assert photograph.conversion == "luminance"
    expected = np.tensordot(LUMINANCE, values.astype(float), 1)
    assert np.allclose(photograph.read(WHOLE), expected, atol=1e-3)


def test_colours_are_found_by_their_names_and_alpha_is_no_colour(write):
    values = bands(4)
    colours = [ColorInterp.blue, ColorInterp.green, ColorInterp.red, ColorInterp.alpha]
    values[3] = 255
    values[3, :5] = 0
    photograph = opened(write(values, colours))
    grey = photograph.read(WHOLE)
    assert photograph.conversion == "luminance"
    assert np.isnan(grey[:5]).all()
    assert np.allclose(grey[5:], np.tensordot(LUMINANCE, values[[2, 1, 0]].astype(float), 1)[5:], atol=1e-3)


def test_one_band_is_taken_as_it_is(write):
    values = bands(4)
    assert np.array_equal(opened(write(values), band=3).read(WHOLE), values[2])
    assert np.array_equal(opened(write(values[:1], name="one.tif")).read(WHOLE), values[0])


def test_what_does_not_suit_is_refused(write):
    with pytest.raises(InputError, match="none tagged as red"):
        opened(write(bands(5)), grey="luminance")
    with pytest.raises(InputError, match="one band"):
        opened(write(bands(1), name="one.tif"), grey="principal")


@pytest.mark.parametrize("tile", [(40, 60), (7, 16), (13, 60)])
def test_the_principal_component_does_not_depend_on_the_tiling(write, tile):
    rng = np.random.default_rng(0)
    ground = rng.normal(100, 20, (40, 60))
    values = np.stack([ground * share + rng.normal(0, 1, ground.shape) for share in (0.2, 0.5, 1.0, 0.1)])
    values[1, 3, 4] = -9999
    photograph = opened(write(values.astype(np.float32), nodata=-9999))
    assert photograph.conversion == "first principal component"
    grid = TileGrid((40, 60), tile)
    found = photograph.with_principal_component(sample_bands(photograph, t) for t in reversed(list(grid.tiles())))
    assert np.isnan(found.read(WHOLE)[3, 4])
    flat = values.reshape(4, -1)[:, np.arange(2400) != 3 * 60 + 4].T.astype(np.float32)
    assert found.weights == principal_weights(flat.astype(float))
    expected = np.array([0.2, 0.5, 1.0, 0.1]) / 1.8
    assert np.allclose(found.weights, expected, atol=0.01)


@given(st.lists(st.integers(0, 9), min_size=4, max_size=9), st.integers(2, 4))
def test_classes_have_the_least_variance_within_them(counts, classes):
    counts = np.array(counts)
    filled = np.flatnonzero(counts)
    if filled.size < classes:
        with pytest.raises(ValueError, match="different values"):
            class_means(counts, classes)
        return

    def spread(means):
        return sum(counts[i] * min((i - mean) ** 2 for mean in means) for i in filled)

    costs = []
    for cuts in itertools.combinations(range(1, filled.size), classes - 1):
        parts = np.split(filled, cuts)
        costs.append(spread([np.average(part, weights=counts[part]) for part in parts]))
    found = class_means(counts, classes)
    assert (np.diff(found) > 0).all()
    assert spread(found) == pytest.approx(min(costs))


@given(st.lists(st.floats(0, 255, width=32), min_size=3, max_size=3), st.integers(0, 2**32))
def test_levels_are_linear_between_the_means(means, seed):
    means = np.unique(np.round(means)).astype(float)
    if means.size < 2:
        with pytest.raises(ValueError, match="ascend"):
            to_levels(np.zeros((1, 1), np.float32), means)
        return
    grey = np.random.default_rng(seed).uniform(means[0], means[-1], (5, 7)).astype(np.float32)
    found = to_levels(grey, means)
    assert np.allclose(found, np.interp(grey, means, np.arange(means.size)), atol=1 / LEVEL_STEPS)
    assert np.array_equal(found * LEVEL_STEPS, np.rint(found * LEVEL_STEPS))
    assert np.isnan(to_levels(np.full((1, 1), np.nan, np.float32), means)).all()


def found(photograph, size):
    context = CountContext(photograph, nevatia_babu=True)
    facts = [count_greys(context, tile) for tile in TileGrid((40, 60), size).tiles(edge_elements.halo())]
    scale = level_scale(added(facts, "grey"), added(facts, "difference"), edge_parameters({"levels": 2}), "photo.tif")
    return scale, edge_threshold(added(facts, "edge"), None)


def test_the_scale_does_not_depend_on_the_tiling(write):
    photograph = opened(write(bands(3)))
    scales = {found(photograph, size) for size in ((40, 60), (11, 9))}
    ((scale, threshold),) = scales
    assert 0 < threshold < 255 * 1000
    # the luminance of uniform noise in three bands deviates by 49
    gap = (scale.means[1] - scale.means[0]) * (scale.brightest - scale.darkest) / 255
    assert scale.noise == pytest.approx(49 / gap, rel=0.1)
    assert 40 < scale.means[0] < 110 < 150 < scale.means[1] < 220


def test_images_without_so_many_values_are_refused(write):
    flat = opened(write(np.full((1, 40, 60), 7, np.uint8)))
    with pytest.raises(InputError, match="1 grey values, fewer than the 2 levels"):
        found(flat, (40, 60))
    with pytest.raises(InputError, match="nothing but nodata"):
        level_scale(added([], "grey"), added([], "difference"), edge_parameters({"levels": 2}), "photo.tif")


def test_an_image_without_edges_has_no_threshold():
    assert edge_threshold(added([], "edge"), None) == np.inf
