"""Shape of polylines: how long, how straight, how winding."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import reduce_runs


class Shape(NamedTuple):
    """Shape of polylines, float64 each.

    Attributes
    ----------
    length
        In the unit of the vertices.
    straightness
        1 where all parts point the same way or the opposite one, 0 where they point everywhere.
    sinuosity
        Length over the distance of the ends; NaN of closed polylines.
    """

    length: NDArray[np.float64]
    straightness: NDArray[np.float64]
    sinuosity: NDArray[np.float64]


def shape_of(polylines: Polylines) -> Shape:
    """Shape of polylines with vertices (row, column), of length > 0.

    Examples
    --------
    A straight line, and a right angle of two equal sides.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> from tilepipe_kernels.polylines.shape import shape_of
    >>> vertices = np.array([[0, 0], [3, 4], [0, 0], [0, 2], [2, 2]])
    >>> shape = shape_of(Polylines(np.array([0, 2, 5]), vertices))
    >>> shape.length.tolist(), shape.straightness.round(6).tolist(), shape.sinuosity.round(2).tolist()
    ([5.0, 4.0], [1.0, 0.0], [1.0, 1.41])
    """
    vertices = polylines.vertices.astype(np.float64, copy=False)
    steps = np.diff(vertices, axis=0, prepend=vertices[:1])
    steps[polylines.offsets[:-1]] = 0
    lengths = np.hypot(*steps.T)
    # the doubled angle of a part has the cosine (x² - y²) / l² and the sine 2 x y / l²
    per_length = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    cosine, sine = (steps[:, 1] ** 2 - steps[:, 0] ** 2) * per_length, 2 * steps[:, 0] * steps[:, 1] * per_length
    length, cosine, sine = (reduce_runs(np.add, values, polylines.offsets) for values in (lengths, cosine, sine))
    ends = np.hypot(*(polylines.last - polylines.first).T)
    sinuosity = np.divide(length, ends, out=np.full_like(length, np.nan), where=ends > 0)
    return Shape(length, np.hypot(cosine, sine) / length, np.maximum(sinuosity, 1.0))
