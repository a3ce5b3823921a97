"""Where pixels lie, and from which deviation on a raster is none that can be used."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio.transform

from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.io.crs.degrees import utm_zone
from tilepipe.io.rasters.georeference import Geometry, check_geometry
from tilepipe.io.rasters.raster import open_raster

LEFT, TOP = 500000.0, 5000000.0
SHAPE = (40, 50)


def geometry(*transform: float, shape: tuple[int, int] = SHAPE) -> Geometry:
    return check_geometry("it", "EPSG:32633", transform, shape, None)


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        ((2, 0, LEFT, 0, -2, TOP), ""),
        # a corner may move by a hundredth of a pixel: 40 rows by b, 50 columns by d
        ((2, 0.02 / 40 * 0.99, LEFT, 0, -2, TOP), ""),
        ((2, -0.02 / 40 * 1.01, LEFT, 0, -2, TOP), "is rotated"),
        ((2, 0, LEFT, -0.02 / 50 * 0.99, -2, TOP), ""),
        ((2, 0, LEFT, 0.02 / 50 * 1.01, -2, TOP), "is rotated"),
        ((-2, 0, LEFT, 0, -2, TOP), "is not north-up"),
        ((2, 0, LEFT, 0, 2, TOP), "is not north-up"),
        ((0, 0, LEFT, 0, -2, TOP), "is not north-up"),
        ((2, 0, LEFT, 0, 0, TOP), "is not north-up"),
        ((2, 0, LEFT, 0, -2 * (1 + 0.99e-6), TOP), ""),
        ((2, 0, LEFT, 0, -2 * (1 + 1.01e-6), TOP), "are not square"),
        ((2, 0, LEFT, 0, -2 * (1 - 1.01e-6), TOP), "are not square"),
    ],
)
def test_north_up_and_square(transform, message):
    if message:
        with pytest.raises(InputError, match=f"^it: .*{message}"):
            geometry(*transform)
    else:
        found = geometry(*transform)
        assert (found.left, found.top, found.pixel, found.shape) == (LEFT, TOP, 2, SHAPE)
        assert (found.resolution, found.height_metres) == (2, 1)


@pytest.mark.parametrize(("shape", "right"), [((3, 3), True), ((2, 3), False), ((3, 2), False)])
def test_the_least_raster(shape, right):
    if right:
        assert geometry(1, 0, LEFT, 0, -1, TOP, shape=shape).shape == shape
    else:
        with pytest.raises(InputError, match=f"is {shape[1]} × {shape[0]} pixels; at least 3 × 3"):
            geometry(1, 0, LEFT, 0, -1, TOP, shape=shape)


def test_places_are_those_of_rasterio():
    found = geometry(0.5, 0, LEFT, 0, -0.5, TOP)
    transform = rasterio.Affine(*found.transform)
    assert found.bounds == rasterio.transform.array_bounds(*SHAPE, transform)
    vertices = np.array([[0, 0], [0, 7], [3, 0], [40, 50]])
    expected = [transform * (column, row) for row, column in vertices]
    assert found.coordinates(vertices).tolist() == [list(place) for place in expected]


@pytest.mark.parametrize(
    ("right", "down", "wider", "message"),
    [
        (0.0099, -0.0099, 0, ""),
        (0.0101, 0, 0, "do not line up"),
        (0, 0.0101, 0, "do not line up"),
        (0, -0.5, 0, "do not line up"),
        (0, 0, 0.99e-6, ""),
        (0, 0, 1.01e-6, "pixel size"),
        (0, 0, -1.01e-6, "pixel size"),
    ],
)
def test_from_which_deviation_on_two_rasters_make_no_mosaic(tmp_path, right, down, wider, message):
    pixel = 2.0
    first = write_raster(
        tmp_path / "a.tif", np.ones(SHAPE, np.float32), transform=rasterio.Affine(pixel, 0, 0, 0, -pixel, 0)
    )
    moved = rasterio.Affine(pixel * (1 + wider), 0, (60 + right) * pixel, 0, -pixel * (1 + wider), (-20 - down) * pixel)
    second = write_raster(tmp_path / "b.tif", np.ones(SHAPE, np.float32), transform=moved)
    if message:
        with pytest.raises(InputError, match=message):
            open_raster([first, second])
    else:
        assert open_raster([first, second]).geometry.shape == (60, 110)


def test_zones_are_six_degrees_wide_and_begin_at_the_date_line():
    for zone in range(1, 61):
        middle = zone * 6 - 183
        for longitude in (middle - 3, middle - 2.9, middle, middle + 2.9):
            assert utm_zone(longitude, 0) == utm_zone(longitude, 1) == f"EPSG:{32600 + zone}"
            assert utm_zone(longitude, -1e-9) == f"EPSG:{32700 + zone}"
    assert utm_zone(180, 1) == "EPSG:32601"
