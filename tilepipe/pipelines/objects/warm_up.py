"""The kernels that a run of `objects` calls last, called once on a drawn scene, so that they lie compiled on disk."""

from __future__ import annotations

import numpy as np

from tilepipe.engine.parameters import checked_parameters
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.reconcile_regions import merge_regions
from tilepipe_kernels.heights.mixture import fit_mixture
from tilepipe_kernels.polylines.arcs import trace_arcs
from tilepipe_kernels.polylines.join import join_arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons
from tilepipe_kernels.polylines.simplify import simplify_polylines
from tilepipe_kernels.regions.contraction import RegionGraph, Statistics
from tilepipe_kernels.regions.ising import field_marginals


def warm_up() -> None:
    """Trace and simplify the borders of squares, merge a chain of leaves, and sample a field on it."""
    from tilepipe.pipelines.objects.reconcile_buildings import CROWN, ROOF

    parameters = checked_parameters(ObjectParameters, {})
    random = np.random.default_rng(0)
    row, column = np.indices((40, 40)) // 10
    fragments = trace_arcs((4 * row + column + 1).astype(np.uint32), core=(0, 0, 40, 40), origin=(0, 0))
    arcs = join_arcs([fragments])
    assemble_polygons(arcs).coordinates(simplify_polylines(arcs, 0.75, 0.5, 0.5), (0.5, 0, 0, 0, -0.5, 0))
    leaves = 40
    edges = np.stack([np.arange(leaves - 1), np.arange(1, leaves)], axis=1).astype(np.int32)
    length = np.full(leaves - 1, 4, np.int32)
    statistics = Statistics(
        np.full(leaves, 16.0), (np.arange(leaves) // 5 * 3).astype(np.float64), random.random(leaves)
    )
    sites = np.arange(leaves, dtype=np.int64)
    merge_regions(RegionGraph(statistics, edges, length), sites, parameters, resolution=0.5, workers=2)
    features, area = random.normal(-1, 1, (leaves, 2)), np.full(leaves, 50.0)
    evidence = fit_mixture(features, area, (ROOF, CROWN)).evidence(features)
    field_marginals(edges, np.full(leaves - 1, 0.5), evidence, sites=sites, seed=0)
