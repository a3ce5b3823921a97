"""Steger's line detector: sub-pixel line points, their links to lines and junctions, widths and uncertainty.

`line_points` finds, `link_points` joins, `line_widths` measures; thresholds come from `response_of_bar` or
from `thresholds_from_histogram`.  Steger, "An Unbiased Detector of Curvilinear Structures", IEEE PAMI 20(2),
1998.
"""

from __future__ import annotations

from tilepipe_kernels.ridges import points as _points
from tilepipe_kernels.ridges import width
from tilepipe_kernels.ridges.links import LINK_RADIUS


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
