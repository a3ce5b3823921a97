"""The kernels that a run of `streets` calls last, called once on a drawn scene, so that they lie compiled on disk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.image.borders import with_borders
from tilepipe_kernels.image.grey_levels import store
from tilepipe_kernels.network.build import build_network, iterate_lines
from tilepipe_kernels.network.cleaning import Cleaning, raster_border
from tilepipe_kernels.network.fragment_table import summarise
from tilepipe_kernels.network.skeleton import medial_axis_and_distance, skeleton_links
from tilepipe_kernels.network.tracing import trace
from tilepipe_kernels.ridges.links import link_points
from tilepipe_kernels.ridges.points import line_points
from tilepipe_kernels.ridges.width import line_widths

_SIDE = 256
_ATTRIBUTES = ("dx", "dy", "response", "width", "contrast", "region")


def drawn_streets() -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """A small drawn cross of streets and its intensity."""
    row, column = np.mgrid[:_SIDE, :_SIDE].astype(np.float32)
    street = (np.abs(row - column) < 12) | (np.abs(row - 128) < 10)
    grey = np.where(street, 40, 160) + np.random.default_rng(0).normal(0, 5, street.shape)
    return street, grey.astype(np.float32)


def warm_up() -> None:
    """Find lines and the skeleton of the cross, and join them to a graph."""
    street, grey = drawn_streets()
    points = line_points(grey, 5.0, low=0.1, mask=street)
    links = np.zeros(street.shape, np.uint8)
    links[points.row, points.col] = link_points(points)
    fragments = trace(links, core=(0, _SIDE, 0, _SIDE), origin=(0, 0), width=_SIDE)
    axis, _ = medial_axis_and_distance(street, cap=20, separation=8.0, origin=(0, 0))
    skeleton_links(axis)
    packed = store(grey, np.zeros(street.shape, np.bool_))
    with_borders(street, grey, street.astype(np.uint32), packed, dark=40.0, bright=160.0, reach=4, noise=5.0)
    line_widths(grey, points, 5.0, maximum_width=40.0)
    attributes = {name: np.ones(fragments.pixels.size, np.float32) for name in _ATTRIBUTES}
    table = summarise(fragments, _SIDE, attributes["response"])
    cleaning = Cleaning(
        contraction=8.0, maximum_gap=15.0, maximum_angle=30.0, minimum_branch=15.0, minimum_length=30.0, high=0.1
    )
    network = build_network([table], _SIDE, lambda _: (fragments, attributes), cleaning, raster_border(street.shape, 2))
    list(iterate_lines(network, lambda _: (fragments, attributes)))
