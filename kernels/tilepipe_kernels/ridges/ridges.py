"""Steger's line detector: sub-pixel line points, their links to lines and junctions, widths and uncertainty.

`line_points` finds, `link_points` joins, `line_widths` measures; thresholds come from `response_of_bar` or
from `thresholds_from_histogram`.  Steger, "An Unbiased Detector of Curvilinear Structures", IEEE PAMI 20(2),
1998.
"""

from __future__ import annotations

from tilepipe_kernels.image.gaussian import gaussian_derivatives
from tilepipe_kernels.ridges import points as _points
from tilepipe_kernels.ridges import width
from tilepipe_kernels.ridges.bar_profile import (
    position_standard_error,
    response_bins,
    response_of_bar,
    sigma_for_width,
    thresholds_from_histogram,
)
from tilepipe_kernels.ridges.links import LINK_RADIUS, NEIGHBOUR_OFFSETS, link_points, neighbour_table
from tilepipe_kernels.ridges.points import LinePoints, line_points
from tilepipe_kernels.ridges.width import Widths, line_widths

__all__ = [
    "LINK_RADIUS",
    "NEIGHBOUR_OFFSETS",
    "LinePoints",
    "Widths",
    "gaussian_derivatives",
    "halo",
    "line_points",
    "line_widths",
    "link_points",
    "neighbour_table",
    "position_standard_error",
    "response_bins",
    "response_of_bar",
    "sigma_for_width",
    "thresholds_from_histogram",
]


def halo(sigma: float, maximum_width: float | None = None) -> int:
    """Pixels around a tile's core that make its points, links and (given ``maximum_width``) widths exact.

    Parameters
    ----------
    sigma
        Gaussian scale in pixels.
    maximum_width
        As for `line_widths`, in pixels; None when widths are not wanted.

    Examples
    --------
    >>> from tilepipe_kernels.ridges.ridges import halo
    >>> halo(3.5), halo(3.5, maximum_width=20)  # widths are looked for farther away
    (35, 48)
    """
    linked = _points.halo(sigma) + LINK_RADIUS
    return linked if maximum_width is None else max(linked, width.halo(sigma, maximum_width))
