"""Shape of polylines on drawn cases."""

from __future__ import annotations

import math

import numpy as np

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.polylines.shape import shape_of


def test_shapes_of_polylines() -> None:
    offsets = np.array([0, 2, 5, 10])
    square = [(0, 0), (0, 2), (2, 2), (2, 0), (0, 0)]
    vertices = np.array([(0, 0), (3, 4), (0, 0), (0, 2), (2, 2), *square], float)
    shape = shape_of(Polylines(offsets, vertices))
    assert shape.length.tolist() == [5, 4, 8]
    assert np.allclose(shape.straightness, [1, 0, 0])
    assert np.allclose(shape.sinuosity, [1, math.sqrt(2), np.nan], equal_nan=True)
    assert shape_of(Polylines(np.array([0]), np.empty((0, 2)))).length.size == 0
