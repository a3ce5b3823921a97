"""Quadtree, adjacency and polygons of `objects`: the cases of `surfaces`, beside higra too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.kernels import surfaces
from benchmarks.kernels.scene import Scene
from benchmarks.measure.contest import Call, Case, Contestant, Unsuitable

TOLERANCE = 1.5
"""Of the simplified borders in pixels: 0.75 m at half a metre, the default of `tilepipe objects`."""


def kernel_cases(size: int) -> Sequence[Callable[[], Case]]:
    """Each kernel on a city of ``size`` pixels a side, its input made when called."""
    scene = Scene(size)
    higra = Contestant("higra", lambda: _higra_contacts(scene), serial=True, note="the pixels' graph is there already")
    return (
        lambda: _beside(surfaces.quadtree_case(scene), Contestant("higra", _no_quadtree)),
        lambda: _beside(surfaces.contacts_case(scene), higra),
        lambda: surfaces.polygons_case(scene),
        lambda: surfaces.polygons_case(scene, TOLERANCE),
    )


def _beside(case: Case, peer: Contestant) -> Case:
    return replace(case, contestants=[*case.contestants, peer])


def _no_quadtree() -> Call:
    import higra  # noqa: F401 - where it is missing, that is the reason

    raise Unsuitable("has trees of regions, no quadtree")


def _higra_contacts(scene: Scene) -> Call:
    import higra as hg

    labels = surfaces.city_leaves(scene.size)[0]
    pixels = hg.get_4_adjacency_graph(labels.shape)

    def run(workers: int) -> Any:
        regions = hg.make_region_adjacency_graph_from_labelisation(pixels, labels)
        edge = hg.CptRegionAdjacencyGraph.get_edge_map(regions)
        # -1 is an edge of pixels within a region
        return regions.edge_list(), np.bincount(edge[edge >= 0], minlength=regions.num_edges())

    return run
