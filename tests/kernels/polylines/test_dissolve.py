"""Arcs of dissolved regions against polygons of the dissolved labels."""

from __future__ import annotations

import numpy as np
import pytest

from tilepipe.io.vectors.geometries import region_polygons
from tilepipe_kernels.polylines.arcs import trace_arcs
from tilepipe_kernels.polylines.dissolve import dissolved
from tilepipe_kernels.polylines.join import join_arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons
from tilepipe_kernels.polylines.simplify import simplify_polylines

shapely = pytest.importorskip("shapely")


def labels_and_groups() -> tuple[np.ndarray, np.ndarray]:
    """Squares of 3 pixels with nodata; half of the regions belong to no group."""
    random = np.random.default_rng(1)
    labels = np.kron(1 + np.arange(120).reshape(10, 12), np.ones((3, 3))).astype(np.uint32)
    labels[random.random(labels.shape) < 0.03] = 0
    return labels, np.append(0, random.integers(0, 3, 120) * random.integers(1, 4, 120)).astype(np.uint32)


def test_groups_are_those_of_dissolved_labels() -> None:
    labels, group = labels_and_groups()
    arcs = dissolved(join_arcs([trace_arcs(labels)]), group)
    expected = join_arcs([trace_arcs(group[labels])])
    ids, found = region_polygons(assemble_polygons(arcs), arcs)
    wanted, polygons = region_polygons(assemble_polygons(expected), expected)
    np.testing.assert_array_equal(ids, wanted)
    assert 0 < len(ids) < group.max() + 1
    assert all(shapely.equals(found, polygons))


def test_simplified_arcs_keep_the_borders_of_the_regions() -> None:
    labels, group = labels_and_groups()
    exact = join_arcs([trace_arcs(labels)])
    simple = simplify_polylines(exact, 1.2)
    rings = assemble_polygons(dissolved(exact, group))
    _, found = region_polygons(rings, dissolved(simple, group))
    assert shapely.is_valid(found).all()
    regions, parts = region_polygons(assemble_polygons(exact), simple)
    for polygon, number in zip(found, np.unique(group[1:][group[1:] > 0]), strict=True):
        assert shapely.equals(polygon, shapely.union_all(parts[group[regions] == number]))


def test_no_group_leaves_no_arcs() -> None:
    labels, group = labels_and_groups()
    arcs = dissolved(join_arcs([trace_arcs(labels)]), 0 * group)
    assert len(arcs) == 0
    ids, polygons = region_polygons(assemble_polygons(arcs), arcs)
    assert len(ids) == len(polygons) == 0
